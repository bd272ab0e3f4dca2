# SPDX-License-Identifier: Apache-2.0
"""Kernels that lay a pair of pictures out for matching."""

from __future__ import annotations

import numpy as np

from binocular_recon._jit import Array, kernel
from binocular_recon.stereo.matching._ncc_kernels import PaddedPair

MID_GREY = 128


@kernel
def is_whole(image: Array) -> bool:
    """Whether every level is a whole number from 0 to 255 (or there is no data)."""
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
def lay_out_strip(
    left: Array,
    right: Array,
    steps: int,
    min_disparity: int,
    pair: PaddedPair,
    start: int,
    stop: int,
) -> None:
    """Fill rows ``start`` to ``stop`` of ``pair``, the last of which is empty.

    Place i of a row of the mirrored picture is column W - 1 - min_disparity - i.
    """
    height, width = left.shape
    places = pair.right.shape[1]
    for y in range(start, stop):
        if y == height:
            pair.left[y], pair.left_bad[y] = 0, 0
            pair.right[y], pair.right_bad[y] = 0, 0
            continue
        for x in range(width):
            _put(left[y, x], steps, pair.left, pair.left_bad, y, x)
        pair.right[y] = 0
        pair.right_bad[y] = 1
        last = width - 1 - min_disparity
        for i in range(max(0, -min_disparity), min(places, last + 1)):
            _put(right[y, last - i], steps, pair.right, pair.right_bad, y, i)


@kernel
def _put(level: float, steps: int, levels: Array, bad: Array, y: int, x: int) -> None:
    """Write whole steps from mid grey; 0 where there is no data."""
    none = np.isnan(level)
    levels[y, x] = 0 if none else np.rint(level * steps) - MID_GREY * steps
    bad[y, x] = none
