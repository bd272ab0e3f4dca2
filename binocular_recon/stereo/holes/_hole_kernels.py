# SPDX-License-Identifier: Apache-2.0
"""Kernels of holes: runs and regions of NaN in a disparity map."""

from __future__ import annotations

from typing import Any

import numpy as np

from binocular_recon._jit import Array, inline_kernel, kernel

_NAN = np.float32(np.nan)
_AT_ONCE = 16  # pixels of a row that are searched together


@inline_kernel
def _next_hole(row: Array, x: int) -> tuple[int, int]:
    """Return where the first run of NaN from column ``x`` on begins, and where it ends."""
    while x + _AT_ONCE <= len(row):
        total = np.float32(0)
        for i in range(_AT_ONCE):
            total += row[x + i]
        if total != total:
            break
        x += _AT_ONCE
    while x < len(row) and not np.isnan(row[x]):
        x += 1
    begin = x
    while x < len(row) and np.isnan(row[x]):
        x += 1
    return begin, x


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
            begin, end = _next_hole(row, x)
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
            begin, end = _next_hole(row, x)
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
            begin, end = _next_hole(row, x)
            marks[y, x:begin] = False
            # the right camera does not see the first d columns, d the disparity, or the last -d
            before = row[begin - 1] if begin > 0 else zero
            after = row[end] if end < width else max(before, zero)
            marks[y, begin:end] = end - begin > after - before + slack
            x = end


@kernel
def raise_to_columns(disparity: Array, marks: Array, filled: Array, start: int, stop: int) -> None:
    """Raise marked pixels to the smaller end of their hole along columns ``start`` to ``stop``."""
    height = len(disparity)
    above = np.empty((height, stop - start), np.float32)
    nearest = np.full(stop - start, np.float32(np.nan))
    for y in range(height):
        for i in range(nearest.size):
            here = disparity[y, start + i]
            nearest[i] = here if here == here else nearest[i]
            above[y, i] = nearest[i]
    nearest[:] = np.nan
    for y in range(height - 1, -1, -1):
        for i in range(nearest.size):
            here = disparity[y, start + i]
            nearest[i] = here if here == here else nearest[i]
        for i in range(nearest.size):
            # a comparison with NaN is false
            end = nearest[i] if not above[y, i] <= nearest[i] else above[y, i]
            end = end if end == end else above[y, i]
            if marks[y, start + i] and end > filled[y, start + i]:
                filled[y, start + i] = end


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
