# SPDX-License-Identifier: Apache-2.0
"""The built-in matcher 'ncc', step by step: rectified rows become disparities (eq. 10)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

from binocular_recon._jit import over_strips
from binocular_recon.config import MatchConfig
from binocular_recon.images import ByteImage, FloatImage
from binocular_recon.stereo.confidence import SIGMA_UNIT_PX
from binocular_recon.stereo.matching import _semi_global
from binocular_recon.stereo.matching._finishing_kernels import finish_strip
from binocular_recon.stereo.matching._ncc_kernels import score_strip
from binocular_recon.stereo.matching._preparation import check_pair, prepare_pair, selection_of
from binocular_recon.stereo.matching._selection_kernels import select_strip
from binocular_recon.stereo.matching.coarse_to_fine import coarse_config, is_noise, refine_coarse
from binocular_recon.stereo.matching.consensus import to_left_image, vote, voter_configs
from binocular_recon.stereo.matching.half_resolution import (
    fill_from_half,
    half_config,
    halve,
    has_low_texture,
)
from binocular_recon.stereo.matching.refinement import drop_flying, drop_speckles, smooth
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
        In [0, 1], 0 where there is no disparity; it encodes the standard deviation of the
        disparity, see `sigma_from_confidence`.
    validity : (H, W) uint8
        `Validity.MEASURED`, or why there is no disparity.

    """

    disparity_px: FloatImage
    confidence: FloatImage
    validity: ByteImage

    @cached_property
    def matched_share(self) -> float:
        """Share of the pixels that have a disparity."""
        return float(np.isfinite(self.disparity_px).mean())


def disparity_step_px(config: MatchConfig) -> float:
    """Return the smallest step between disparities, `delta_d` of a DisparityImage."""
    return SUBPIXEL_STEP_PX if config.subpixel else 1.0


def match_ncc(left: FloatImage, right: FloatImage, config: MatchConfig) -> Match:
    """Match a checked pair by zero-mean normalised cross-correlation.

    Parameters
    ----------
    left, right : (H, W) float32
        Rectified images, grey levels 0..255, any precision; NaN = no data.
    config : MatchConfig
        Search range, window and checks.

    Returns
    -------
    Match
        Disparity of each pixel whose match passes every check; none in images smaller than the
        window.

    Notes
    -----
    Eq. 10 with both windows sampled at x - d in the right image. The disparity of a pixel is
    chosen by winner takes all or by semi-global matching (``config.semi_global``), once or by
    vote of several matches (``config.consensus``).

    """
    measure = _measure_by_consensus if config.consensus else _measure
    disparity, sigma, validity = measure(left, right, config)
    drop_flying(disparity, sigma, config)
    matched = _rounded(disparity, sigma, validity, config)
    _mark_missing(left, right, validity, config)
    return matched


def _measure_by_consensus(left: FloatImage, right: FloatImage, config: MatchConfig) -> Measured:
    """Return the disparities on which matches with several windows, from both cameras, agree."""
    mirrored = right[:, ::-1].copy(), left[:, ::-1].copy()
    found, reasons = [], np.zeros(left.shape, np.uint8)
    for voter in voter_configs(config):
        disparity, sigma, validity = _measure(left, right, voter)
        found.append((disparity, sigma))
        np.bitwise_or(reasons, validity, out=reasons)
        disparity, sigma = (image[:, ::-1].copy() for image in _measure(*mirrored, voter)[:2])
        found.append(to_left_image(disparity, sigma))
    disparity, sigma = vote(*zip(*found, strict=True))
    return (disparity if config.subpixel else np.rint(disparity)), sigma, reasons


def _measure(left: FloatImage, right: FloatImage, config: MatchConfig) -> Measured:
    """Return the measurements of one match, in regions of low texture at half resolution."""
    disparity, sigma, validity = _measure_once(left, right, config)
    if config.half_resolution and has_low_texture(disparity):
        # half resolution remedies noise, not the other reasons of the checks
        rejected = (validity & (Validity.AMBIGUOUS | Validity.AT_LIMIT)) > 0
        half = _measure_once(halve(left), halve(right), half_config(config))[:2]
        fill_from_half(disparity, sigma, *half, config.speckle_size)
        disparity[rejected], sigma[rejected] = np.nan, np.nan
    return disparity, sigma, validity


def _measure_once(left: FloatImage, right: FloatImage, config: MatchConfig) -> Measured:
    """Return the measurements at one resolution."""
    if min(left.shape) < config.correlation_window_size:
        none = np.full(left.shape, np.nan, np.float32)
        return none, none.copy(), np.full(left.shape, Validity.LOW_TEXTURE, np.uint8)
    near_edges = None
    if config.coarse_to_fine and (min(left.shape) + 1) // 2 >= config.correlation_window_size:
        disparity, validity, near_edges = _coarse_to_fine(left, right, config)
    else:
        disparity, validity = _choose(left, right, config)
    if config.subpixel:
        disparity, sigma = smooth(disparity, left, near_edges)
    else:
        sigma = np.zeros_like(disparity)
    return disparity, sigma, validity


def _coarse_to_fine(
    left: FloatImage, right: FloatImage, config: MatchConfig
) -> tuple[FloatImage, ByteImage, ByteImage]:
    """Return the result of `refine_coarse` after a match at half resolution."""
    half = halve(left)
    disparity, validity = _choose(half, halve(right), coarse_config(config), ends=True)
    noise = is_noise(left, half)
    disparity[noise], validity[noise] = np.nan, Validity.LOW_TEXTURE
    return refine_coarse(left, right, (disparity, validity), config)


def _choose(
    left: FloatImage, right: FloatImage, config: MatchConfig, *, ends: bool = False
) -> tuple[FloatImage, ByteImage]:
    """Return the disparity of each pixel, NaN = none, in whole regions, and the validity.

    With ``ends`` the first and the last disparity are matches.
    """
    choose = _semi_global.choose_disparities if config.semi_global else _winner_takes_all
    disparity, validity = choose(left, right, config, ends=ends)
    drop_speckles(disparity, config)
    return disparity, validity


def _winner_takes_all(
    left: FloatImage, right: FloatImage, config: MatchConfig, *, ends: bool = False
) -> tuple[FloatImage, ByteImage]:
    """Return the disparity of each pixel's best score, NaN = none, and the validity."""
    pair, _ = prepare_pair(left, right, config, border=0)
    disparity = np.full(left.shape, np.nan, np.float32)
    validity = np.full(left.shape, Validity.LOW_TEXTURE, np.uint8)
    results = disparity, validity
    selection = selection_of(config, ends=ends)
    over_strips(select_strip, len(left), pair, selection, results, strip=48)
    return results


def _rounded(
    disparity: FloatImage, sigma: FloatImage, validity: ByteImage, config: MatchConfig
) -> Match:
    """Round disparities, in place, to the step of a DisparityImage, and add the confidence."""
    confidence = np.empty_like(disparity)
    # planes and half resolution may leave the search range
    measured, limits = (disparity, sigma, validity), config.limits_px
    step = disparity_step_px(config)
    over_strips(finish_strip, len(disparity), measured, step, SIGMA_UNIT_PX, limits, confidence)
    return Match(disparity, confidence, validity)


def _mark_missing(
    left: FloatImage, right: FloatImage, validity: ByteImage, config: MatchConfig
) -> None:
    """Mark, in place, pixels without a match whose window contains pixels without data.

    In the right image only rows without any data count: without a disparity no pixel there is the
    partner.
    """
    missing = np.isnan(left)
    missing = missing | np.asarray(np.isnan(right).all(axis=1))[:, None]
    if missing.any():
        side = config.correlation_window_size
        # halving reaches 2 px farther on each side
        side = 2 * side + 5 if config.coarse_to_fine else side
        near = cv2.dilate(missing.view(np.uint8), np.ones((side, side), np.uint8)) > 0
        validity[near & (validity != Validity.MEASURED)] = Validity.NO_DATA


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
        Eq. 10 in [-1, 1]; NaN where a window leaves an image, contains a pixel without data or
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
    pair, _ = prepare_pair(left, right, config, border=0)
    over_strips(score_strip, len(left), pair, scores, strip=48)
    return scores
