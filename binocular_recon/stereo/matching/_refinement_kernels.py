# SPDX-License-Identifier: Apache-2.0
"""Kernels of refinement: speckles, medians and planes."""

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
