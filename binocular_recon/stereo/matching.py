# SPDX-License-Identifier: Apache-2.0
"""Matching: rectified rows become disparities by zero-mean NCC (eq. 10)."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from binocular_recon._jit import over_strips
from binocular_recon.config import MatchConfig
from binocular_recon.errors import ImageError
from binocular_recon.stereo._ncc_kernels import Pair, Selection, score_strip, select_strip

FloatImage = npt.NDArray[np.float32]

# Disparities are rounded to this step, `delta_d` of a DisparityImage; without sub-pixel it is 1.
SUBPIXEL_STEP_PX = 1 / 64
# The standard deviation whose confidence is one half.
SIGMA_UNIT_PX = 0.25
# Grey levels farther than this outside 0..255 are no interpolation overshoot but another unit.
_OVERSHOOT = 128.0
_FINE_STEPS = 257  # per grey level: the steps of a 16-bit picture


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

    """

    disparity_px: FloatImage
    confidence: FloatImage


def disparity_step_px(config: MatchConfig) -> float:
    """Return the smallest step between disparities, `delta_d` of a DisparityImage."""
    return SUBPIXEL_STEP_PX if config.subpixel else 1.0


def confidence_from_sigma(sigma_px: FloatImage) -> FloatImage:
    """Return 1 / (1 + (sigma / SIGMA_UNIT_PX)^2), 0 where sigma is NaN or infinite."""
    ratio = np.asarray(sigma_px, np.float32) / np.float32(SIGMA_UNIT_PX)
    confidence: FloatImage = np.nan_to_num(1 / (1 + ratio * ratio), nan=0.0)
    return confidence


def sigma_from_confidence(confidence: FloatImage) -> FloatImage:
    """Return the standard deviation of the disparity, px; infinite where confidence is 0."""
    level = np.asarray(confidence, np.float32)
    with np.errstate(divide='ignore', invalid='ignore'):
        variance = np.where(level > 0, 1 / level - 1, np.inf).astype(np.float32)
    sigma: FloatImage = np.float32(SIGMA_UNIT_PX) * np.sqrt(variance)
    return sigma


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
        Disparity of each pixel whose match passes every check.

    Raises
    ------
    ImageError
        If the pictures differ in size, are smaller than the window, or are not grey levels
        of 255.

    Notes
    -----
    Eq. 10 with both windows sampled at x - d in the right picture; winner takes all.

    """
    pair = _prepare(left, right, config)
    height, width = np.shape(left)
    disparity = np.full((height, width), np.nan, np.float32)
    sigma = np.full((height, width), np.nan, np.float32)
    selection = Selection(
        config.min_disparity, config.disp12_max_diff, config.uniqueness_ratio, config.subpixel
    )
    over_strips(
        lambda start, stop: select_strip(pair, selection, disparity, sigma, start, stop),
        height,
        strip=48,
    )
    _drop_speckles(disparity, config)
    sigma[np.isnan(disparity)] = np.nan
    return Match(disparity, confidence_from_sigma(sigma))


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
    pair = _prepare(left, right, config)
    scores = np.full((*np.shape(left), config.disparity_range), np.nan, np.float32)
    over_strips(
        lambda start, stop: score_strip(pair, scores, start, stop), scores.shape[0], strip=48
    )
    return scores


def _prepare(left: FloatImage, right: FloatImage, config: MatchConfig) -> Pair:
    """Check the pictures and lay them out for the kernels."""
    left, right = np.asarray(left, np.float32), np.asarray(right, np.float32)
    size = config.correlation_window_size
    if left.ndim != 2 or left.shape != right.shape:
        raise ImageError(
            f'left is {left.shape} and right {right.shape}; both must be grey pictures of the'
            ' same (rows, columns)'
        )
    if min(left.shape) < size:
        raise ImageError(
            f'pictures of {left.shape[1]}x{left.shape[0]} px are smaller than the correlation'
            f' window of {size} px; choose a smaller correlation_window_size'
        )
    _check_levels(left, 'left')
    _check_levels(right, 'right')
    integers = _is_integer(left) and _is_integer(right)
    steps = 1 if integers else _FINE_STEPS
    kind = np.float32 if integers else np.float64
    height, width = left.shape
    padded = width + config.disparity_range - 1
    left_levels = np.zeros((height + 1, width), kind)
    left_bad = np.zeros((height + 1, width), np.uint8)
    left_levels[:-1], left_bad[:-1] = _centred(left, steps)
    right_levels = np.zeros((height + 1, padded), kind)
    right_bad = np.ones((height + 1, padded), np.uint8)
    right_bad[-1] = 0
    # place i of the mirrored row is column width - 1 - min_disparity - i of the picture
    first, last = max(0, -config.min_disparity), min(padded, width - config.min_disparity)
    if first < last:
        columns = slice(width - config.min_disparity - last, width - config.min_disparity - first)
        levels, bad = _centred(right[:, columns], steps)
        right_levels[:-1, first:last] = levels[:, ::-1]
        right_bad[:-1, first:last] = bad[:, ::-1]
    least = (config.texture_threshold * steps) ** 2 * size * size
    return Pair(left_levels, right_levels, left_bad, right_bad, size, least)


def _check_levels(image: FloatImage, name: str) -> None:
    low, high = np.fmin.reduce(image, axis=None), np.fmax.reduce(image, axis=None)
    if low < -_OVERSHOOT or high > 255 + _OVERSHOOT:
        raise ImageError(
            f'{name} has grey levels from {low:g} to {high:g}; they must be within 0..255'
            ' (io.images.to_grey converts other pictures)'
        )


def _is_integer(image: FloatImage) -> bool:
    """Whether every level is a whole number from 0 to 255 (or there is no data)."""
    return bool(
        np.all((image == np.rint(image)) & (image >= 0) & (image <= 255) | (image != image))
    )


def _centred(
    image: FloatImage, steps: int
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.bool_]]:
    """Return whole steps from mid grey, 0 where there is no data, and where that is."""
    bad = np.isnan(image)
    levels = np.rint(np.where(bad, 128, image).astype(np.float64) * steps) - 128 * steps
    return levels, bad


def _drop_speckles(disparity: FloatImage, config: MatchConfig) -> None:
    """Invalidate connected regions smaller than ``speckle_size``."""
    if config.speckle_size == 0:
        return
    # steps per px such that every disparity fits 16 bits
    steps = min(16, 32000 // config.disparity_range)
    whole = np.full(disparity.shape, -1, np.int16)
    valid = np.isfinite(disparity)
    whole[valid] = np.rint((disparity[valid] - config.min_disparity + 1) * steps)
    cv2.filterSpeckles(whole, -1, config.speckle_size, config.speckle_range * steps)
    disparity[whole < 0] = np.nan
