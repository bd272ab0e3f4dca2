# SPDX-License-Identifier: Apache-2.0
"""Kernels that prepare an image pair for matching."""

from __future__ import annotations

import numpy as np

from binocular_recon._jit import Array, inline_kernel, kernel
from binocular_recon._simd import LANES, larger, load, smaller, splat, store
from binocular_recon.stereo.matching._ncc_kernels import PaddedPair

MID_GREY = 128
_FAR = np.float32(np.inf)


@kernel
def level_range(image: Array) -> tuple[float, float]:
    """Return the smallest and the largest level, except NaN; of none, infinity and -infinity."""
    low, high, least, most = splat(_FAR), splat(-_FAR), _FAR, -_FAR
    for y in range(image.shape[0]):
        row, x = image[y], 0
        while x + LANES <= row.size:
            low, high = smaller(low, load(row, x)), larger(high, load(row, x))
            x += LANES
        while x < row.size:
            # comparisons with NaN are false
            least = min(least, row[x])
            most = max(most, row[x])
            x += 1
    lanes = np.empty(2 * LANES, np.float32)
    store(lanes, 0, low)
    store(lanes, LANES, high)
    for i in range(LANES):
        least, most = min(least, lanes[i]), max(most, lanes[LANES + i])
    return float(least), float(most)


@kernel
def is_whole(image: Array) -> bool:
    """Return whether every level is a whole number from 0 to 255 or NaN (no data)."""
    for y in range(image.shape[0]):
        others = 0
        for x in range(image.shape[1]):
            level = image[y, x]
            whole = level == np.floor(level) and 0 <= level <= 255
            others += not (whole or np.isnan(level))
        if others:
            return False
    return True


@kernel
def prepare_strip(
    left: Array,
    right: Array,
    steps: int,
    min_disparity: int,
    pair: PaddedPair,
    start: int,
    stop: int,
) -> None:
    """Fill rows ``start`` to ``stop`` of ``pair``; its last row is the empty one.

    Number i of a row of the mirrored right image is column W - 1 - min_disparity - i.
    """
    height, width = left.shape
    length = pair.right.shape[1]
    for y in range(start, stop):
        if y == height:
            pair.left[y], pair.left_missing[y] = 0, 0
            pair.right[y], pair.right_missing[y] = 0, 0
            continue
        for x in range(width):
            _write_level(left[y, x], steps, pair.left, pair.left_missing, y, x)
        pair.right[y] = 0
        pair.right_missing[y] = 1
        last = width - 1 - min_disparity
        for i in range(max(0, -min_disparity), min(length, last + 1)):
            _write_level(right[y, last - i], steps, pair.right, pair.right_missing, y, i)


@inline_kernel
def _write_level(level: float, steps: int, levels: Array, missing: Array, y: int, x: int) -> None:
    """Write a level in whole steps from mid grey; 0 where there is no data."""
    no_data = np.isnan(level)
    levels[y, x] = 0 if no_data else np.rint(level * steps) - MID_GREY * steps
    missing[y, x] = no_data
