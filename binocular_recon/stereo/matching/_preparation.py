# SPDX-License-Identifier: Apache-2.0
"""Check an image pair, and prepare it for the matching kernels."""

from __future__ import annotations

import math
from typing import Any

import cv2
import numpy as np

from binocular_recon._jit import over_strips
from binocular_recon._simd import LANES
from binocular_recon.config import MatchConfig
from binocular_recon.errors import ImageError
from binocular_recon.images import ByteImage, FloatImage
from binocular_recon.stereo.matching._ncc_kernels import PaddedPair
from binocular_recon.stereo.matching._preparation_kernels import (
    is_whole,
    level_range,
    prepare_strip,
)
from binocular_recon.stereo.matching._selection_kernels import Selection

# Grey levels farther outside 0..255 are not interpolation overshoot, they are in another unit.
_OVERSHOOT = 128.0
# Standard deviation of `normalised_levels`.
CONTRAST = 50.0
_FINE_STEPS = 257  # per grey level: the steps of a 16-bit image
_EXACT = 2.0**24  # float32 holds every integer up to this one
# Fewest steps per standard deviation: of the texture threshold (rounding is a third of a step),
# and of the image (in a dark image, texture has few grey levels).
_STEPS_OF_TEXTURE = 1
_STEPS_OF_IMAGE = 24


def check_pair(left: FloatImage, right: FloatImage) -> tuple[FloatImage, FloatImage]:
    """Return the images as float32, or raise an ImageError that says what is wrong."""
    left, right = np.ascontiguousarray(left, np.float32), np.ascontiguousarray(right, np.float32)
    if left.ndim != 2 or left.shape != right.shape:
        raise ImageError(
            f'left is {left.shape} and right {right.shape}; both must be grey images of the'
            ' same (rows, columns)'
        )
    for name, image in (('left', left), ('right', right)):
        low, high = level_range(image)
        if low < -_OVERSHOOT or high > 255 + _OVERSHOOT:
            raise ImageError(
                f'{name} has grey levels from {low:g} to {high:g}; they must be within 0..255'
                ' (images.to_grey scales 16-bit images, and floating-point images within 0..1)'
            )
    return left, right


def exposure_gain(left: FloatImage) -> float:
    """Return the factor that brings the standard deviation of an image to `CONTRAST`."""
    return _mean_and_gain(left)[1]


def normalised_levels(left: FloatImage) -> ByteImage:
    """Return bytes of mean 128 and standard deviation `CONTRAST`; 0 = no data."""
    mean, gain = _mean_and_gain(left)
    levels = cv2.addWeighted(left, gain, left, 0, 128 - mean * gain, dtype=cv2.CV_8U)
    return np.asarray(levels, np.uint8)


def _mean_and_gain(left: FloatImage) -> tuple[float, float]:
    mean, deviation = (float(value.item()) for value in cv2.meanStdDev(left))
    if not math.isfinite(mean):  # some pixels have no data
        known = np.isfinite(left).astype(np.uint8)
        mean, deviation = (float(value.item()) for value in cv2.meanStdDev(left, mask=known))
    return mean, CONTRAST / deviation if deviation > 0 else 1.0


def padded_range(config: MatchConfig) -> int:
    """Return the number of disparities, rounded up to whole vectors."""
    return -(-config.disparity_range // LANES) * LANES


def selection_of(config: MatchConfig, *, ends: bool = False) -> Selection:
    """Return the options that the selection kernels need; see `Selection` for ``ends``."""
    return Selection(
        config.disparity_range,
        config.min_disparity,
        config.disp12_max_diff,
        config.uniqueness_ratio,
        config.subpixel,
        ends,
    )


def prepare_pair(
    left: FloatImage,
    right: FloatImage,
    config: MatchConfig,
    border: int,
    contrasts: tuple[float, float] = (1.0, 1.0),
) -> tuple[PaddedPair, int]:
    """Return checked images as the kernels need them, and their steps per grey level.

    Each image is first extended by ``border`` mirrored rows and columns on each side.
    ``contrasts`` are factors on the texture threshold of each image.
    """
    size = config.correlation_window_size
    steps, kind = _resolution(left, right, config)
    if border:
        left = cv2.copyMakeBorder(left, *4 * [border], cv2.BORDER_REFLECT_101)
        right = cv2.copyMakeBorder(right, *4 * [border], cv2.BORDER_REFLECT_101)
    height, width = left.shape
    length = width + padded_range(config) - 1
    threshold = (config.texture_threshold * steps) ** 2 * size * size
    pair = PaddedPair(
        np.empty((height + 1, width), kind),
        np.empty((height + 1, length), kind),
        np.empty((height + 1, width), np.uint8),
        np.empty((height + 1, length), np.uint8),
        size,
        (threshold * contrasts[0] ** 2, threshold * contrasts[1] ** 2),
    )
    over_strips(prepare_strip, height + 1, left, right, steps, config.min_disparity, pair)
    return pair, steps


def _resolution(left: FloatImage, right: FloatImage, config: MatchConfig) -> tuple[int, Any]:
    """Choose the steps per grey level, and a dtype in which sums of their products are exact."""
    if is_whole(left) and is_whole(right):
        return 1, np.float32
    steps = 1
    while (config.correlation_window_size * 128 * 2 * steps) ** 2 <= _EXACT:
        steps *= 2
    coarse = CONTRAST / exposure_gain(left) * steps < _STEPS_OF_IMAGE
    if config.texture_threshold * steps >= _STEPS_OF_TEXTURE and not coarse:
        return steps, np.float32
    return _FINE_STEPS, np.float64
