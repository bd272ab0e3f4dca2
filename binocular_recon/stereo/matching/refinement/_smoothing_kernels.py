# SPDX-License-Identifier: Apache-2.0
"""Kernels of smoothing: weighted medians and planes."""

from __future__ import annotations

from typing import Any

import numpy as np

from binocular_recon._jit import Array, exact_kernel, inline_kernel, kernel
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

# Planes: samples on each side of the pixel, and their spacing in pixels (neighbours have
# correlated errors).
REACH = 2
SPACING = 3
BORDER = REACH * SPACING
MEDIAN_BORDER = 6  # reach of the windows of medians
MEDIAN_SPACING = 2  # of their samples
WIDE_SPACING = 3
MEDIAN_ERROR_PX = np.float32(0.1)  # at which bisection stops
LEAST_SAMPLES = np.float32(5)  # of a plane
LEAST_SPREAD = np.float32(1e-2)  # of the samples: on a line they do not define a plane


@inline_kernel
def _is_near(where: Array, y: int, x: int) -> bool:
    """Return whether any of `LANES` pixels counts, of ``where`` at half resolution."""
    if where.size == 0:
        return True
    row, found = where[y >> 1], 0
    for i in range(x >> 1, min((x + LANES) >> 1, row.size)):
        found |= row[i]
    return found != 0


@kernel
def weighted_median_strip(
    images: tuple[Array, Array, Array],
    where: Array,
    spacing: int,
    softness: float,
    keep: float,
    samples: Array,
    start: int,
    stop: int,
) -> None:
    """Replace values that differ from the weighted median of their window by that median.

    Only where ``where`` (ceil(H / 2), ceil(W / 2)), uint8, is not 0; everywhere if it is empty.
    ``images``: the values and grey levels (H + 2 MEDIAN_BORDER, W + 2 MEDIAN_BORDER + 2 LANES),
    with borders of NaN, and a mask (H, W): NaN where the result is to be. Windows have a sample
    every ``spacing`` px. Weights fall with the
    difference of grey levels, to a half at ``softness``; a value within ``keep`` of its median
    stays. ``samples`` (H + 2 BORDER, W + 2 BORDER + LANES): the result, with a border of NaN, of
    which the first and the last strip write what is above and below.
    """
    values, levels, mask = images
    height, width = mask.shape
    none = np.float32(np.nan)
    if start == 0:
        samples[:BORDER] = none
    if stop == height:
        samples[BORDER + height :] = none
    count = (2 * MEDIAN_BORDER // spacing + 1) ** 2
    window, weights = np.empty(count * LANES, np.float32), np.empty(count * LANES, np.float32)
    lows, highs = np.empty(values.shape[1], np.float32), np.empty(values.shape[1], np.float32)
    medians = np.empty(width + LANES, np.float32)
    zero, one, half = splat(np.float32(0)), splat(np.float32(1)), splat(np.float32(0.5))
    scale, near, most = (
        splat(np.float32(1 / softness)),
        splat(np.float32(keep)),
        splat(np.float32(1e9)),
    )
    certain = splat(np.float32(keep) - MEDIAN_ERROR_PX)
    for y in range(start, stop):
        if where.size == 0 or where[y >> 1].any():
            column_range(values, y, 2 * MEDIAN_BORDER + 1, spacing, lows, highs)
        for x in range(0, width, LANES):
            here = load(values[y + MEDIAN_BORDER], x + MEDIAN_BORDER)
            store(medians, x, here)
            if not _is_near(where, y, x):
                continue
            low = high = here
            for i in range(0, 2 * MEDIAN_BORDER + 1, spacing):
                low, high = smaller(low, load(lows, x + i)), larger(high, load(highs, x + i))
            error = np.float32(largest(to_int32(at_most(high - low, most, high - low, zero))) + 1)
            if error <= keep:
                continue
            level = load(levels[y + MEDIAN_BORDER], x + MEDIAN_BORDER)
            # most values are near their median, which two sums show without bisection
            total = to_high = to_low = zero
            at = 0
            for j in range(0, 2 * MEDIAN_BORDER + 1, spacing):
                grey, row = levels[y + j], values[y + j]
                for i in range(0, 2 * MEDIAN_BORDER + 1, spacing):
                    step, value = (load(grey, x + i) - level) * scale, load(row, x + i)
                    weight = one / (one + step * step)
                    # 0 where a level or a value is NaN
                    weight = at_most(weight, one, weight, zero)
                    weight = at_most(value, most, weight, zero)
                    store(window, at, value)
                    store(weights, at, weight)
                    total = total + weight
                    to_high = to_high + at_most(value, here + certain, weight, zero)
                    to_low = to_low + at_most(value, here - certain, weight, zero)
                    at += LANES
            enough = total * half
            moves = at_most(to_high, enough, one, at_most(to_low, enough, zero, one))
            if largest(to_int32(moves)) == 0:
                continue
            while error > MEDIAN_ERROR_PX:
                error *= np.float32(0.5)
                middle = (low + high) * half
                below = zero
                for k in range(0, count * LANES, LANES):
                    below = below + at_most(load(window, k), middle, load(weights, k), zero)
                low = at_most(below, enough, middle, low)
                high = at_most(below, enough, high, middle)
            median = (low + high) * half
            step = median - here
            store(medians, x, at_most(larger(step, zero - step), near, here, median))
            if where.size > 0:
                for i in range(x, min(x + LANES, width)):
                    if where[y >> 1, i >> 1] == 0:
                        medians[i] = values[y + MEDIAN_BORDER, i + MEDIAN_BORDER]
        out, given = samples[y + BORDER], mask[y]
        out[:BORDER] = none
        out[BORDER + width :] = none
        for x in range(width):
            out[BORDER + x] = medians[x] if given[x] == given[x] else none


@exact_kernel
def _set_sigma(squares: Array, factor: Any, common: Any, sigma: Array) -> None:
    for x in range(sigma.size):
        sigma[x] = np.sqrt(squares[x] * factor + common)


@kernel
def plane_strip(
    disparity: Array,
    reach_px: float,
    terms: tuple[float, float],
    results: tuple[Array, Array],
    start: int,
    stop: int,
) -> None:
    """Fit a plane to the samples around each pixel that differ from it by at most ``reach_px``.

    ``disparity`` (H + 2 BORDER, W + 2 BORDER + LANES) has a border of NaN. ``results`` (H, W): the
    value of the plane, and its standard deviation, from the mean square of the residuals, the
    first of ``terms`` times that plus the second one. With too few samples, the value itself, and
    the variance of a uniform distribution within ``reach_px``; NaN where there is no disparity.
    """
    width = disparity.shape[1] - 2 * BORDER - LANES
    planes, squares = np.empty(width + LANES, np.float32), np.empty(width + LANES, np.float32)
    factor, common = np.float32(terms[0]), np.float32(terms[1])
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
            store(planes, x, fitted)
            uniform = limit * limit / splat(np.float32(3))
            square = at_most(splat(LEAST_SAMPLES), n, larger(square, zero), uniform)
            store(squares, x, square + (here - here))  # NaN where there is no disparity
        results[0][y] = planes[:width]
        _set_sigma(squares, factor, common, results[1][y])
