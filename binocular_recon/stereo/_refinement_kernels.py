# SPDX-License-Identifier: Apache-2.0
"""Kernels that complete and smooth a disparity map."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from binocular_recon._jit import kernel
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

Array = npt.NDArray[Any]

REACH = 2  # samples on each side of the pixel ...
SPACING = 3  # ... every so many pixels: neighbours repeat the same error
BORDER = REACH * SPACING
MEDIAN_REACH = 3
MEDIAN_SPACING = 2
MEDIAN_BORDER = MEDIAN_REACH * MEDIAN_SPACING
MEDIAN_ERROR_PX = np.float32(0.1)  # bisection ends
FEW = np.float32(5)  # samples that a plane needs
FLAT = np.float32(1e-2)  # least spread of the samples: a plane needs two directions


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
            end = x
            while end < width and np.isnan(disparity[y, end]):
                end += 1
            after = disparity[y, end] if end < width else before
            if np.isnan(before):
                before = after
            filled[y, x:end] = min(before, after)
            x = end


@kernel
def mark_unexplained(disparity: Array, slack: int, marks: Array, start: int, stop: int) -> None:
    """Mark runs of NaN wider than what the step between their ends hides, by ``slack`` px."""
    width = disparity.shape[1]
    for y in range(start, stop):
        x = 0
        before = np.float32(0)  # columns left of the picture's disparity are out of sight
        while x < width:
            marks[y, x] = False
            if not np.isnan(disparity[y, x]):
                before = disparity[y, x]
                x += 1
                continue
            end = x
            while end < width and np.isnan(disparity[y, end]):
                end += 1
            hidden = disparity[y, end] - before if end < width else np.float32(0)
            marks[y, x:end] = end - x > hidden + slack
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
def to_steps(
    disparity: Array, first: float, steps: float, whole: Array, start: int, stop: int
) -> None:
    """Write disparities from ``first`` on in whole steps to ``whole``, int16; -1 = none."""
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
def put_inside(
    values: Array, shown: Array, border: int, bordered: Array, start: int, stop: int
) -> None:
    """Put ``values`` (H, W), NaN where ``shown`` is, inside a border of NaN.

    ``bordered`` (H + 2 border, W + 2 border + LANES); the first and the last rows are filled with
    their neighbours.
    """
    height, width = values.shape
    if start == 0:
        bordered[:border] = np.nan
    if stop == height:
        bordered[border + height :] = np.nan
    for y in range(start, stop):
        row = bordered[y + border]
        row[:border] = np.nan
        row[border + width :] = np.nan
        for x in range(width):
            row[border + x] = values[y, x] if shown[y, x] == shown[y, x] else np.float32(np.nan)


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


@kernel
def weighted_median_strip(
    values: Array, levels: Array, softness: float, keep: float, out: Array, start: int, stop: int
) -> None:
    """Replace values that are no weighted median of those around, by it.

    ``values`` and ``levels`` (H + 2 MEDIAN_BORDER, W + 2 MEDIAN_BORDER + LANES) have borders of
    NaN; ``out`` (H, W + LANES). Weights fall with the step of grey level, to a half at
    ``softness``; a value within ``keep`` of its median stays.
    """
    width = values.shape[1] - 2 * MEDIAN_BORDER - LANES
    count = (2 * MEDIAN_REACH + 1) ** 2
    samples, weights = np.empty(count * LANES, np.float32), np.empty(count * LANES, np.float32)
    zero, one, half = splat(np.float32(0)), splat(np.float32(1)), splat(np.float32(0.5))
    scale, near, most = (
        splat(np.float32(1 / softness)),
        splat(np.float32(keep)),
        splat(np.float32(1e9)),
    )
    surely = splat(np.float32(keep) - MEDIAN_ERROR_PX)
    for y in range(start, stop):
        for x in range(0, width, LANES):
            here = load(values[y + MEDIAN_BORDER], x + MEDIAN_BORDER)
            low = high = here
            at = 0
            for j in range(-MEDIAN_BORDER, MEDIAN_BORDER + 1, MEDIAN_SPACING):
                row = values[y + MEDIAN_BORDER + j]
                for i in range(0, 2 * MEDIAN_BORDER + 1, MEDIAN_SPACING):
                    value = load(row, x + i)
                    store(samples, at, value)
                    low, high = smaller(low, value), larger(high, value)
                    at += LANES
            error = np.float32(largest(to_int32(at_most(high - low, most, high - low, zero))) + 1)
            if error <= keep:
                store(out[y], x, here)
                continue
            level = load(levels[y + MEDIAN_BORDER], x + MEDIAN_BORDER)
            total = zero
            at = 0
            for j in range(-MEDIAN_BORDER, MEDIAN_BORDER + 1, MEDIAN_SPACING):
                row = levels[y + MEDIAN_BORDER + j]
                for i in range(0, 2 * MEDIAN_BORDER + 1, MEDIAN_SPACING):
                    step = (load(row, x + i) - level) * scale
                    weight = one / (one + step * step)
                    # NaN is not at most anything
                    weight = at_most(weight, one, weight, zero)
                    weight = at_most(load(samples, at), most, weight, zero)
                    store(weights, at, weight)
                    total = total + weight
                    at += LANES
            enough = total * half
            # most values are near enough to their median, which shows without finding it
            below = under = zero
            for k in range(0, count * LANES, LANES):
                sample, weight = load(samples, k), load(weights, k)
                below = below + at_most(sample, here + surely, weight, zero)
                under = under + at_most(sample, here - surely, weight, zero)
            moves = at_most(below, enough, one, at_most(under, enough, zero, one))
            if largest(to_int32(moves)) == 0:
                store(out[y], x, here)
                continue
            while error > MEDIAN_ERROR_PX:
                error *= np.float32(0.5)
                middle = (low + high) * half
                below = zero
                for k in range(0, count * LANES, LANES):
                    below = below + at_most(load(samples, k), middle, load(weights, k), zero)
                low = at_most(below, enough, middle, low)
                high = at_most(below, enough, high, middle)
            median = (low + high) * half
            step = median - here
            store(out[y], x, at_most(larger(step, zero - step), near, here, median))


@kernel
def plane_strip(
    disparity: Array, reach_px: float, plane: Array, residual: Array, start: int, stop: int
) -> None:
    """Fit a plane to the samples around each pixel that differ by ``reach_px`` at most.

    ``disparity`` (H + 2 BORDER, W + 2 BORDER + LANES) has a border of NaN; ``plane`` and
    ``residual`` (H, W + LANES) get the plane's value and the mean square of what remains,
    where samples are few that of anything within ``reach_px``; NaN where there is no disparity.
    """
    width = disparity.shape[1] - 2 * BORDER - LANES
    limit = splat(np.float32(reach_px))
    zero, one = splat(np.float32(0)), splat(np.float32(1))
    for y in range(start, stop):
        centre = disparity[y + BORDER]
        for x in range(0, width, LANES):
            here = load(centre, x + BORDER)
            n = sx = sy = sxx = sxy = syy = sv = sxv = syv = svv = zero
            for j in range(-REACH, REACH + 1):
                row = disparity[y + BORDER + j * SPACING]
                v = splat(np.float32(j))
                row_n = row_x = row_v = zero
                for i in range(-REACH, REACH + 1):
                    u = splat(np.float32(i))
                    step = load(row, x + BORDER + i * SPACING) - here
                    distance = larger(step, zero - step)
                    weight = at_most(distance, limit, one, zero)
                    step = at_most(distance, limit, step, zero)
                    across = u * weight
                    row_n, row_x, row_v = row_n + weight, row_x + across, row_v + step
                    sxx, sxv, svv = sxx + u * across, sxv + u * step, svv + step * step
                n, sx, sv = n + row_n, sx + row_x, sv + row_v
                sy, sxy, syv = sy + v * row_n, sxy + v * row_x, syv + v * row_v
                syy = syy + v * v * row_n
            count = larger(n, one)
            mx, my, mv = sx / count, sy / count, sv / count
            cxx, cxy, cyy = sxx / count - mx * mx, sxy / count - mx * my, syy / count - my * my
            cxv, cyv = sxv / count - mx * mv, syv / count - my * mv
            spread = cxx * cyy - cxy * cxy
            safe = larger(spread, splat(FLAT))
            slope_x = (cxv * cyy - cyv * cxy) / safe
            slope_y = (cyv * cxx - cxv * cxy) / safe
            left = svv / count - mv * mv - slope_x * cxv - slope_y * cyv
            fitted = here + mv - slope_x * mx - slope_y * my
            fitted = at_most(splat(FEW), n, at_most(splat(FLAT), spread, fitted, here), here)
            store(plane[y], x, fitted)
            left = at_most(splat(FEW), n, larger(left, zero), limit * limit / splat(np.float32(3)))
            store(residual[y], x, left + (here - here))  # NaN where there is no disparity
