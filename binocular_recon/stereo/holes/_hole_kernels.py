# SPDX-License-Identifier: Apache-2.0
"""Kernels of holes: runs and regions of NaN in a disparity map."""

from __future__ import annotations

from typing import Any

import numpy as np

from binocular_recon._jit import Array, inline_kernel, kernel
from binocular_recon._simd import LANES, at_most, first_equal, load, splat, to_int32

_NAN = np.float32(np.nan)


@inline_kernel
def is_missing(values: Any) -> Any:
    """Return a vector of 1 where ``values`` are NaN, else 0."""
    return to_int32(at_most(values, values, splat(np.float32(0)), splat(np.float32(1))))


@inline_kernel
def _first(row: Array, x: int, missing: bool) -> Any:
    """Return the first column from ``x`` on that is NaN, or that is not."""
    while x + LANES <= len(row):
        lane = first_equal(is_missing(load(row, x)), np.int32(missing))
        if lane < LANES:
            return x + lane
        x += LANES
    while x < len(row) and np.isnan(row[x]) != missing:
        x += 1
    return x


@inline_kernel
def next_hole(row: Array, x: int) -> tuple[int, int]:
    """Return where the first run of NaN from column ``x`` on begins, and where it ends."""
    begin = _first(row, x, True)
    return begin, _first(row, begin, False)


@inline_kernel
def _ends(row: Array, begin: int, end: int) -> Any:
    """Return the values before and after a run; NaN beyond the image."""
    before = row[begin - 1] if begin > 0 else _NAN
    after = row[end] if end < len(row) else _NAN
    return before, after


@kernel
def keep_confident(
    disparity: Array, confidence: Array, measured: Array, start: int, stop: int
) -> None:
    """Copy disparities whose confidence is above 0; the others become NaN."""
    for y in range(start, stop):
        for x in range(disparity.shape[1]):
            known = confidence[y, x] > 0  # false for NaN
            measured[y, x] = disparity[y, x] if known else _NAN


@kernel
def complete_strip(
    measured: Array,
    confidence: Array,
    smooth: Array,
    completed: float,
    filled: Array,
    weight: Array,
    start: int,
    stop: int,
) -> None:
    """Smooth the filled pixels of rows, and write the weight: ``completed`` in holes."""
    low, one = np.float32(completed), np.float32(1)
    for y in range(start, stop):
        for x in range(measured.shape[1]):
            hole = np.isnan(measured[y, x])
            filled[y, x] = smooth[y, x] if hole else filled[y, x]
            weight[y, x] = low if hole else min(confidence[y, x], one)


@kernel
def continue_slopes(
    rows: Array, ends: Array, values: Array, slopes: Array, limits: Array, filled: Array
) -> None:
    """Give the pixels before column ``ends`` of rows the slope of what follows, within limits."""
    low, high = float(limits[0]), float(limits[1])
    for i in range(len(rows)):
        value, slope = float(values[i]), float(slopes[i])
        for x in range(ends[i]):
            filled[rows[i], x] = min(max(value + slope * (x - ends[i]), low), high)


@kernel
def fill_background_strip(disparity: Array, filled: Array, start: int, stop: int) -> None:
    """Give each run of NaN the smaller disparity of its two ends: that of the background."""
    width = disparity.shape[1]
    for y in range(start, stop):
        row, x = disparity[y], 0
        filled[y] = row
        while x < width:
            begin, end = next_hole(row, x)
            before, after = _ends(row, begin, end)
            before = after if np.isnan(before) else before
            after = before if np.isnan(after) else after
            filled[y, begin:end] = min(before, after)
            x = end


@kernel
def fill_nearest_strip(measured: Array, filled: Array, start: int, stop: int) -> None:
    """Give each NaN the nearest value of its row; of two equally near, the left one."""
    width = measured.shape[1]
    for y in range(start, stop):
        row, x = measured[y], 0
        while x < width:
            begin, end = next_hole(row, x)
            filled[y, x:begin] = row[x:begin]
            before, after = _ends(row, begin, end)
            middle = (begin + end + 1) // 2 if end < width else end
            middle = middle if begin > 0 else 0
            filled[y, begin:middle] = before
            filled[y, max(begin, middle) : end] = after
            x = end


@kernel
def mark_unexplained(disparity: Array, slack: int, marks: Array, start: int, stop: int) -> None:
    """Mark runs of NaN that are more than ``slack`` px wider than half-occlusion explains."""
    width, zero = disparity.shape[1], np.float32(0)
    for y in range(start, stop):
        row, x = disparity[y], 0
        while x < width:
            begin, end = next_hole(row, x)
            marks[y, x:begin] = False
            # the right camera does not see the first d columns, d the disparity, or the last -d
            before = row[begin - 1] if begin > 0 else zero
            after = row[end] if end < width else max(before, zero)
            marks[y, begin:end] = end - begin > after - before + slack
            x = end


@inline_kernel
def keep_nearest(row: Array, nearest: Array) -> None:
    """Replace the nearest measured pixel of each column by that of this row, if there is one."""
    for x in range(len(row)):
        nearest[x] = nearest[x] if np.isnan(row[x]) else row[x]


@inline_kernel
def _raise_row(above: Array, below: Array, marks: Array, filled: Array) -> None:
    for x in range(len(filled)):
        # a comparison with NaN is false
        end = below[x] if not above[x] <= below[x] else above[x]
        end = end if end == end else above[x]
        filled[x] = end if marks[x] & (end > filled[x]) else filled[x]


@kernel
def raise_to_columns(disparity: Array, marks: Array, filled: Array, start: int, stop: int) -> None:
    """Raise marked pixels to the smaller end of their hole along columns ``start`` to ``stop``."""
    height, columns = len(disparity), slice(start, stop)
    above = np.empty((height, stop - start), np.float32)
    nearest = np.full(stop - start, _NAN)
    for y in range(height):
        keep_nearest(disparity[y, columns], nearest)
        above[y] = nearest
    nearest[:] = _NAN
    for y in range(height - 1, -1, -1):
        keep_nearest(disparity[y, columns], nearest)
        _raise_row(above[y], nearest, marks[y, columns], filled[y, columns])


@kernel
def count_hole_pixels(
    disparity: Array, half: Array, labels: Array, size: Array, covered: Array
) -> None:
    """Count the pixels of each labelled hole, and those that ``half`` has a disparity for."""
    for y in range(disparity.shape[0]):
        for x in range(disparity.shape[1]):
            if np.isnan(disparity[y, x]):
                size[labels[y, x]] += 1
                covered[labels[y, x]] += not np.isnan(half[y // 2, x // 2])


@kernel
def copy_from_half(
    labels: Array, fill: Array, half: tuple[Array, Array], whole: tuple[Array, Array]
) -> None:
    """Copy disparity and sigma from half resolution, doubled, into the holes to ``fill``."""
    for y in range(labels.shape[0]):
        for x in range(labels.shape[1]):
            if fill[labels[y, x]] and not np.isnan(half[0][y // 2, x // 2]):
                whole[0][y, x] = 2 * half[0][y // 2, x // 2]
                whole[1][y, x] = 2 * half[1][y // 2, x // 2]
