# SPDX-License-Identifier: Apache-2.0
"""Kernels of holes, runs and regions of NaN in a disparity map."""

from __future__ import annotations

import numpy as np

from binocular_recon._jit import Array, kernel


@kernel
def _end_of_hole(row: Array, x: int) -> int:
    """Return the first column from ``x`` on that is not NaN."""
    while x < len(row) and np.isnan(row[x]):
        x += 1
    return x


@kernel
def fill_strip(disparity: Array, filled: Array, start: int, stop: int) -> None:
    """Give each run of NaN the smaller disparity of its two ends: the background's."""
    width = disparity.shape[1]
    for y in range(start, stop):
        x = 0
        before = np.float32(np.nan)
        while x < width:
            if not np.isnan(disparity[y, x]):
                before = disparity[y, x]
                filled[y, x] = before
                x += 1
                continue
            end = _end_of_hole(disparity[y], x)
            after = disparity[y, end] if end < width else before
            if np.isnan(before):
                before = after
            filled[y, x:end] = min(before, after)
            x = end


@kernel
def fill_from_nearest(measured: Array, filled: Array, start: int, stop: int) -> None:
    """Give each NaN the nearest value of its row; the left one of two equally near."""
    width = measured.shape[1]
    for y in range(start, stop):
        row, out, x = measured[y], filled[y], 0
        while x < width:
            out[x] = row[x]
            if not np.isnan(row[x]):
                x += 1
                continue
            end = _end_of_hole(row, x)
            middle = (x + end + 1) // 2 if end < width else end
            if x == 0:
                middle = 0
            out[x:middle] = row[x - 1] if x else np.float32(np.nan)
            out[middle:end] = row[end] if end < width else np.float32(np.nan)
            x = end


@kernel
def mark_unexplained(disparity: Array, slack: int, marks: Array, start: int, stop: int) -> None:
    """Mark runs of NaN wider than what the step between their ends hides, by ``slack`` px."""
    width = disparity.shape[1]
    for y in range(start, stop):
        x = 0
        # columns left of a picture's disparity, or right of a negative one, are out of sight
        before = np.float32(0)
        while x < width:
            marks[y, x] = False
            if not np.isnan(disparity[y, x]):
                before = disparity[y, x]
                x += 1
                continue
            end = _end_of_hole(disparity[y], x)
            after = disparity[y, end] if end < width else max(before, np.float32(0))
            marks[y, x:end] = end - x > after - before + slack
            x = end


@kernel
def raise_to_columns(disparity: Array, marks: Array, filled: Array, start: int, stop: int) -> None:
    """Raise marked pixels of columns ``start`` to ``stop`` to the smaller of the column's ends."""
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
def count_holes(disparity: Array, half: Array, labels: Array, size: Array, seen: Array) -> None:
    """Count the pixels of each labelled hole, and how many of them ``half`` sees."""
    for y in range(disparity.shape[0]):
        for x in range(disparity.shape[1]):
            if np.isnan(disparity[y, x]):
                size[labels[y, x]] += 1
                seen[labels[y, x]] += not np.isnan(half[y // 2, x // 2])


@kernel
def fill_holes(
    labels: Array, fill: Array, half: tuple[Array, Array], whole: tuple[Array, Array]
) -> None:
    """Double what half resolution says, disparity and sigma, of the holes to ``fill``."""
    for y in range(labels.shape[0]):
        for x in range(labels.shape[1]):
            if fill[labels[y, x]] and not np.isnan(half[0][y // 2, x // 2]):
                whole[0][y, x] = 2 * half[0][y // 2, x // 2]
                whole[1][y, x] = 2 * half[1][y // 2, x // 2]
