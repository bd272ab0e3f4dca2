# SPDX-License-Identifier: Apache-2.0
"""Kernels of refinement: speckles, weighted medians and planes."""

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

# Planes: samples on each side of the pixel, and their spacing in pixels (neighbours have
# correlated errors).
REACH = 2
SPACING = 3
BORDER = REACH * SPACING
MEDIAN_REACH = 3
MEDIAN_SPACING = 2
MEDIAN_BORDER = MEDIAN_REACH * MEDIAN_SPACING
MEDIAN_ERROR_PX = np.float32(0.1)  # at which bisection stops
LEAST_SAMPLES = np.float32(5)  # of a plane
LEAST_SPREAD = np.float32(1e-2)  # of the samples: on a line they do not define a plane


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
def pad_strip(
    values: Array, mask: Array, border: int, padded: Array, start: int, stop: int
) -> None:
    """Copy ``values`` (H, W) into ``padded``, with a border of NaN; NaN where ``mask`` is NaN.

    ``padded`` (H + 2 border, W + 2 border + LANES); the first and the last strip write the border
    above and below.
    """
    height, width = values.shape
    if start == 0:
        padded[:border] = np.nan
    if stop == height:
        padded[border + height :] = np.nan
    for y in range(start, stop):
        row = padded[y + border]
        row[:border] = np.nan
        row[border + width :] = np.nan
        for x in range(width):
            row[border + x] = values[y, x] if mask[y, x] == mask[y, x] else np.float32(np.nan)


@kernel
def weighted_median_strip(
    values: Array,
    levels: Array,
    where: Array,
    softness: float,
    keep: float,
    out: Array,
    start: int,
    stop: int,
) -> None:
    """Replace values that differ from the weighted median of their window by that median.

    Only where ``where`` (H, W + LANES), uint8, is not 0; everywhere if it is empty. ``values`` and
    ``levels`` (H + 2 MEDIAN_BORDER, W + 2 MEDIAN_BORDER + LANES) have borders of NaN; ``out``
    (H, W + LANES). Weights fall with the difference of grey levels, to a half at ``softness``; a
    value within ``keep`` of its median stays.
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
    certain = splat(np.float32(keep) - MEDIAN_ERROR_PX)
    for y in range(start, stop):
        for x in range(0, width, LANES):
            here = load(values[y + MEDIAN_BORDER], x + MEDIAN_BORDER)
            if where.size > 0 and largest(load(where[y], x)) == 0:
                store(out[y], x, here)
                continue
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
                    # 0 where a level or a value is NaN
                    weight = at_most(weight, one, weight, zero)
                    weight = at_most(load(samples, at), most, weight, zero)
                    store(weights, at, weight)
                    total = total + weight
                    at += LANES
            enough = total * half
            # most values are near their median, which two sums show without bisection
            to_high = to_low = zero
            for k in range(0, count * LANES, LANES):
                sample, weight = load(samples, k), load(weights, k)
                to_high = to_high + at_most(sample, here + certain, weight, zero)
                to_low = to_low + at_most(sample, here - certain, weight, zero)
            moves = at_most(to_high, enough, one, at_most(to_low, enough, zero, one))
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
            if where.size > 0:
                for i in range(x, x + LANES):
                    if where[y, i] == 0:
                        out[y, i] = values[y + MEDIAN_BORDER, i + MEDIAN_BORDER]


@kernel
def plane_strip(
    disparity: Array, reach_px: float, plane: Array, residual: Array, start: int, stop: int
) -> None:
    """Fit a plane to the samples around each pixel that differ from it by at most ``reach_px``.

    ``disparity`` (H + 2 BORDER, W + 2 BORDER + LANES) has a border of NaN. Writes the value of the
    plane and the mean square of its residuals to ``plane`` and ``residual`` (H, W + LANES); with
    too few samples, the value itself and the variance of a uniform distribution within
    ``reach_px``; NaN where there is no disparity.
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
            safe = larger(spread, splat(LEAST_SPREAD))
            slope_x = (cxv * cyy - cyv * cxy) / safe
            slope_y = (cyv * cxx - cxv * cxy) / safe
            square = svv / count - mv * mv - slope_x * cxv - slope_y * cyv
            fitted = here + mv - slope_x * mx - slope_y * my
            fitted = at_most(splat(LEAST_SPREAD), spread, fitted, here)
            fitted = at_most(splat(LEAST_SAMPLES), n, fitted, here)
            store(plane[y], x, fitted)
            uniform = limit * limit / splat(np.float32(3))
            square = at_most(splat(LEAST_SAMPLES), n, larger(square, zero), uniform)
            store(residual[y], x, square + (here - here))  # NaN where there is no disparity


@kernel
def find_between_strip(
    disparity: Array,
    near: tuple[Array, Array],
    limits: tuple[int, float, float, int],
    between: Array,
    start: int,
    stop: int,
) -> None:
    """Mark pixels next to a step with too few like them around.

    ``near`` are the smallest and the largest disparity in the window around each pixel; ``limits``
    the radius of the window, the least step from these, the largest difference of pixels that are
    alike, and how many there must be in a whole window, the pixel itself included.
    """
    lowest, highest = near
    radius, step, alike, least = limits
    height, width = disparity.shape
    for y in range(start, stop):
        top, bottom = max(y - radius, 0), min(y + radius + 1, height)
        for x in range(width):
            here = disparity[y, x]
            # a comparison with NaN is false
            between[y, x] = here - lowest[y, x] > step or highest[y, x] - here > step
            if not between[y, x]:
                continue
            first, end = max(x - radius, 0), min(x + radius + 1, width)
            count = 0
            for j in range(top, bottom):
                for i in range(first, end):
                    count += abs(disparity[j, i] - here) <= alike
            # at the image border fewer suffice
            inside, whole = (bottom - top) * (end - first), (2 * radius + 1) ** 2
            between[y, x] = count * whole < least * inside
