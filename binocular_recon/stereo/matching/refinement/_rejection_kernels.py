# SPDX-License-Identifier: Apache-2.0
"""Kernels that reject disparities: speckles and flying pixels."""

from __future__ import annotations

import numpy as np

from binocular_recon._jit import Array, kernel
from binocular_recon._simd import (
    LANES,
    at_most,
    larger,
    largest,
    load,
    smaller,
    splat,
    store,
    to_int32,
)
from binocular_recon.stereo.matching.refinement._window_kernels import column_range


@kernel
def quantise(
    disparity: Array, first: float, steps: float, whole: Array, start: int, stop: int
) -> None:
    """Write disparities, counted from ``first``, in whole steps to ``whole``, int16; -1 = none."""
    for y in range(start, stop):
        for x in range(disparity.shape[1]):
            here = (disparity[y, x] - np.float32(first)) * np.float32(steps)
            whole[y, x] = np.int16(np.rint(here)) if here == here else np.int16(-1)


@kernel
def drop_negative(whole: Array, disparity: Array, start: int, stop: int) -> None:
    """Set disparities to NaN where ``whole`` is negative."""
    for y in range(start, stop):
        for x in range(disparity.shape[1]):
            disparity[y, x] = disparity[y, x] if whole[y, x] >= 0 else np.float32(np.nan)


@kernel
def drop_between_strip(
    padded: Array,
    limits: tuple[int, float, float, int],
    disparity: Array,
    sigma: Array,
    start: int,
    stop: int,
) -> None:
    """Drop pixels next to a step with too few like them around.

    ``limits`` are the radius of the window, the least step in it, the largest difference of pixels
    that are alike, and how many there must be in a whole window, the pixel itself included.
    ``padded`` (H + 2 radius, W + 2 radius + 2 LANES): the disparities, with a border of NaN.
    """
    radius, step, alike, least = limits
    height, width = disparity.shape
    side, none = 2 * radius + 1, np.float32(np.nan)
    whole = side * side
    columns = (-(-(width + 2 * radius) // LANES) + 1) * LANES
    lows, highs = np.empty(columns, np.float32), np.empty(columns, np.float32)
    counts, marks = np.empty(LANES, np.float32), np.empty(LANES, np.float32)
    zero, one = splat(np.float32(0)), splat(np.float32(1))
    edge, near, most = (
        splat(np.float32(step)),
        splat(np.float32(alike)),
        splat(np.float32(np.inf)),
    )
    for y in range(start, stop):
        column_range(padded, y, side, 1, lows, highs)
        rows = min(y + radius + 1, height) - max(y - radius, 0)
        for x in range(0, width, LANES):
            here = load(padded[y + radius], x + radius)
            low, high = load(lows, x), load(highs, x)
            for i in range(1, side):
                low, high = smaller(low, load(lows, x + i)), larger(high, load(highs, x + i))
            rise = larger(here - low, high - here)
            # not where there is no disparity
            mark = at_most(rise, edge, zero, at_most(rise, most, one, zero))
            if largest(to_int32(mark)) == 0:
                continue
            count = zero
            for j in range(side):
                row = padded[y + j]
                for i in range(side):
                    distance = load(row, x + i) - here
                    distance = larger(distance, zero - distance)
                    count = count + at_most(distance, near, one, zero)
            store(counts, 0, count)
            store(marks, 0, mark)
            for i in range(min(LANES, width - x)):
                # at the image border fewer suffice
                inside = rows * (min(x + i + radius + 1, width) - max(x + i - radius, 0))
                if marks[i] > 0 and np.int64(counts[i]) * whole < least * inside:
                    disparity[y, x + i] = sigma[y, x + i] = none
