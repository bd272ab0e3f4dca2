# SPDX-License-Identifier: Apache-2.0
"""Matching: rectified rows become disparities by zero-mean NCC (eq. 10)."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from binocular_recon._jit import over_strips
from binocular_recon.config import MatchConfig
from binocular_recon.images import ByteImage, FloatImage
from binocular_recon.stereo.confidence import confidence_from_sigma
from binocular_recon.stereo.matching import _semi_global
from binocular_recon.stereo.matching._layout import check_pair, lay_out
from binocular_recon.stereo.matching._ncc_kernels import score_strip
from binocular_recon.stereo.matching._refinement_kernels import drop_negative, to_steps
from binocular_recon.stereo.matching._selection_kernels import Selection, select_strip
from binocular_recon.stereo.matching.consensus import agree, carry_over, members
from binocular_recon.stereo.matching.half_resolution import (
    fill_from_half,
    half_config,
    halve,
    has_weak_texture,
)
from binocular_recon.stereo.matching.refinement import smooth
from binocular_recon.stereo.validity import Validity

# Disparity, its standard deviation (both float32, NaN = none) and validity (uint8), all (H, W).
Measured = tuple[FloatImage, FloatImage, ByteImage]

# Disparities are rounded to this step, `delta_d` of a DisparityImage; without sub-pixel it is 1.
SUBPIXEL_STEP_PX = 1 / 64


@dataclass(frozen=True, eq=False)
class Match:
    """Measured disparities.

    Attributes
    ----------
    disparity_px : (H, W) float32
        Raw disparity x_left - x_right; NaN = none.
    confidence : (H, W) float32
        In [0, 1], 0 where there is no disparity; carries the standard deviation of the
        disparity, see `sigma_from_confidence`.
    validity : (H, W) uint8
        `Validity.MEASURED`, or why there is no disparity.

    """

    disparity_px: FloatImage
    confidence: FloatImage
    validity: ByteImage


def disparity_step_px(config: MatchConfig) -> float:
    """Return the smallest step between disparities, `delta_d` of a DisparityImage."""
    return SUBPIXEL_STEP_PX if config.subpixel else 1.0


def match(left: FloatImage, right: FloatImage, config: MatchConfig) -> Match:
    """Match a rectified pair.

    Parameters
    ----------
    left, right : (H, W) float32
        Grey levels of 255, any precision; NaN = no data.
    config : MatchConfig
        Search range, window and checks.

    Returns
    -------
    Match
        Disparity of each pixel whose match passes every check; none in pictures smaller than the
        window.

    Raises
    ------
    ImageError
        If the pictures differ in size or are not grey levels of 255.

    Notes
    -----
    Eq. 10 with both windows sampled at x - d in the right picture; winner takes all.

    """
    left, right = check_pair(left, right)
    measure = _measure_by_consensus if config.consensus else _measure
    disparity, sigma, validity = measure(left, right, config)
    confidence = np.empty_like(disparity)
    low, high = config.limits_px

    def finish(start: int, stop: int) -> None:
        rows, levels = disparity[start:stop], confidence[start:stop]
        if config.subpixel:
            rows /= np.float32(SUBPIXEL_STEP_PX)
            np.rint(rows, out=rows)
            rows *= np.float32(SUBPIXEL_STEP_PX)
        levels[:] = confidence_from_sigma(sigma[start:stop]) if config.subpixel else 1
        # planes and half resolution may leave the range
        outside = ~((rows >= low) & (rows <= high))
        rows[outside], levels[outside] = np.nan, 0
        _agree_with(rows, validity[start:stop])

    over_strips(finish, len(disparity))
    _mark_missing(left, right, validity, config)
    return Match(disparity, confidence, validity)


def _agree_with(disparity: FloatImage, validity: ByteImage) -> None:
    """Let validity say what the disparity shows, in place; later steps add and drop matches."""
    measured = np.isfinite(disparity)
    said = (validity & Validity.MEASURED) > 0
    validity[measured] = Validity.MEASURED
    validity[~measured & said] = Validity.AMBIGUOUS


def _mark_missing(
    left: FloatImage, right: FloatImage, validity: ByteImage, config: MatchConfig
) -> None:
    """Say, in place, where one of the images has no data within the window."""
    missing = np.isnan(left)
    missing = missing | np.asarray(np.isnan(right).all(axis=1))[:, None]
    if missing.any():
        side = config.correlation_window_size
        near = cv2.dilate(missing.view(np.uint8), np.ones((side, side), np.uint8)) > 0
        validity[near & (validity != Validity.MEASURED)] = Validity.NO_DATA


def _measure_by_consensus(left: FloatImage, right: FloatImage, config: MatchConfig) -> Measured:
    """Return what matches with several windows, seen from either camera, agree on."""
    mirrored = right[:, ::-1].copy(), left[:, ::-1].copy()
    found, reasons = [], np.zeros(left.shape, np.uint8)
    for member in members(config):
        disparity, sigma, validity = _measure(left, right, member)
        found.append((disparity, sigma))
        np.bitwise_or(reasons, validity, out=reasons)
        disparity, sigma = (image[:, ::-1].copy() for image in _measure(*mirrored, member)[:2])
        found.append(carry_over(disparity, sigma))
    disparity, sigma = agree(*zip(*found, strict=True))
    return (disparity if config.subpixel else np.rint(disparity)), sigma, reasons


def _measure(left: FloatImage, right: FloatImage, config: MatchConfig) -> Measured:
    """Return the disparity, its standard deviation and the validity."""
    disparity, sigma, validity = _measure_once(left, right, config)
    if config.half_resolution and has_weak_texture(disparity):
        # what a check took away for another reason than noise is not given back
        taken = (validity & (Validity.AMBIGUOUS | Validity.AT_LIMIT)) > 0
        half = _measure_once(halve(left), halve(right), half_config(config))[:2]
        fill_from_half(disparity, sigma, *half, config.speckle_size)
        disparity[taken], sigma[taken] = np.nan, np.nan
    return disparity, sigma, validity


def _measure_once(left: FloatImage, right: FloatImage, config: MatchConfig) -> Measured:
    """Return the same at one resolution."""
    if min(left.shape) < config.correlation_window_size:
        nothing = np.full(left.shape, np.nan, np.float32)
        return nothing, nothing.copy(), np.full(left.shape, Validity.LOW_TEXTURE, np.uint8)
    choose = _semi_global.select_disparities if config.semi_global else _select_local
    disparity, validity = choose(left, right, config)
    _drop_speckles(disparity, config)
    if config.subpixel:
        disparity, sigma = smooth(disparity, left)
    else:
        sigma = np.zeros_like(disparity)
    return disparity, sigma, validity


def _select_local(
    left: FloatImage, right: FloatImage, config: MatchConfig
) -> tuple[FloatImage, ByteImage]:
    """Choose each pixel's best score by itself; NaN = none."""
    pair, _ = lay_out(left, right, config, 0)
    disparity = np.full(left.shape, np.nan, np.float32)
    validity = np.full(left.shape, Validity.LOW_TEXTURE, np.uint8)
    selection = Selection(
        config.disparity_range,
        config.min_disparity,
        config.disp12_max_diff,
        config.uniqueness_ratio,
        config.subpixel,
    )
    over_strips(
        lambda start, stop: select_strip(pair, selection, disparity, validity, start, stop),
        len(left),
        strip=48,
    )
    return disparity, validity


def ncc_scores(left: FloatImage, right: FloatImage, config: MatchConfig) -> FloatImage:
    """Return the score of every pixel and disparity, for tests and analysis.

    Parameters
    ----------
    left, right : (H, W) float32
        As for `match`.
    config : MatchConfig
        Search range, window and texture threshold.

    Returns
    -------
    scores : (H, W, disparity_range) float32
        Eq. 10 in [-1, 1]; NaN where a window leaves a picture, holds a pixel without data or
        has too little texture.

    Raises
    ------
    ImageError
        As for `match`.

    """
    left, right = check_pair(left, right)
    scores = np.full((*left.shape, config.disparity_range), np.nan, np.float32)
    if min(left.shape) < config.correlation_window_size:
        return scores
    pair, _ = lay_out(left, right, config, 0)
    over_strips(lambda start, stop: score_strip(pair, scores, start, stop), len(left), strip=48)
    return scores


def _drop_speckles(disparity: FloatImage, config: MatchConfig) -> None:
    """Invalidate connected regions smaller than ``speckle_size``."""
    if config.speckle_size == 0:
        return
    # steps per px such that every disparity fits 16 bits
    steps = min(16, 32000 // config.disparity_range)
    whole = np.empty(disparity.shape, np.int16)
    first = config.min_disparity - 1.0
    over_strips(
        lambda start, stop: to_steps(disparity, first, steps, whole, start, stop), len(whole)
    )
    cv2.filterSpeckles(whole, -1, config.speckle_size, config.speckle_range * steps)
    over_strips(lambda start, stop: drop_negative(whole, disparity, start, stop), len(whole))
