# SPDX-License-Identifier: Apache-2.0
"""Kernels of semi-global selection: the best sum over paths of each pixel, and its checks."""

from __future__ import annotations

from typing import Any

import numpy as np

from binocular_recon._jit import Array, inline_kernel
from binocular_recon._simd import LANES, first_equal, load, smaller, smallest, splat, store
from binocular_recon.stereo import _validity_kernels as reason
from binocular_recon.stereo.matching._cost_kernels import WORST
from binocular_recon.stereo.matching._selection_kernels import Selection

SENTINEL = np.uint8(255)  # above or equal to every sum
# Least lead of the best sum over the second, per percent of the uniqueness ratio: between two
# nearly perfect sums, as on a periodic pattern, noise decides.
LEAST_LEAD = 0.32
# Copies of the best sums of the right image, so that a load does not wait for the store before it.
COPIES = 8


@inline_kernel
def select_row(
    costs: Array,
    total: Array,
    scored: tuple[Array, Array],
    best: Array,
    padded: int,
    selection: Selection,
    results: tuple[Array, Array],
) -> None:
    """Choose the best disparities of a row for both images, and write those that agree.

    ``scored``: which left pixels (W), and which right ones from right to left, have any score.
    """
    left_scored, right_scored = scored
    disparity, validity = results
    width, disparities = left_scored.size, selection.disparities
    best[:] = SENTINEL
    chosen = np.empty(width, np.int64)
    for x in range(width):
        here, right_best = width - 1 - x, best[x % COPIES]
        lowest = splat(SENTINEL)
        for k in range(0, padded, LANES):
            sums = load(total, x * padded + k)
            lowest = smaller(lowest, sums)
            store(right_best, here + k, smaller(sums, load(right_best, here + k)))
        least = smallest(lowest)
        lane, k = LANES, -LANES
        while lane == LANES:
            k += LANES
            lane = first_equal(load(total, x * padded + k), least)
        chosen[x] = k + lane
    for copy in range(1, COPIES):
        for i in range(width + padded):
            best[0, i] = min(best[0, i], best[copy, i])
    tolerance = int(np.floor(selection.disp12_max_diff))
    for x in range(width):
        at, index = x * padded, chosen[x]
        there = width - 1 - x + index
        if not left_scored[x]:
            validity[x] = reason.LOW_TEXTURE
            continue
        agrees = tolerance < 0
        low, high = max(-tolerance, -x, -index), min(tolerance, padded - 1 - index)
        for j in range(low, min(high, width - 1 - x) + 1):
            # the same right pixel, paired with a neighbour of the left one
            agrees |= total[at + index + j * (padded + 1)] == best[0, there]
        if not (agrees and right_scored[there]) or (tolerance >= 0 and costs[at + index] >= WORST):
            validity[x] = reason.CONFLICT
            continue
        if tolerance >= 0 and not (selection.ends or 0 < index < disparities - 1):
            validity[x] = reason.AT_LIMIT
            continue
        if selection.uniqueness_ratio > 0 and not _is_unique(
            total, at, index, (disparities, padded), selection.uniqueness_ratio
        ):
            validity[x] = reason.AMBIGUOUS
            continue
        validity[x] = reason.MEASURED
        offset = _offset(costs, total, at + index) if 0 < index < disparities - 1 else 0.0
        if not selection.subpixel:
            offset = 0.0
        disparity[x] = selection.min_disparity + index + offset


@inline_kernel
def _is_unique(total: Array, at: int, index: int, sizes: tuple[int, int], ratio: float) -> bool:
    """Return whether the best sum beats all but its neighbours' by ``ratio`` percent.

    ``sizes``: the number of disparities, and with those that pad it to whole vectors.
    """
    disparities, padded = sizes
    # in the meantime its own sum and its neighbours' are no rivals; nor are those of padding
    low, high = max(index - 1, 0), min(index + 2, disparities)
    kept = total[at + low], total[at + index], total[at + high - 1]
    for k in range(low, high):
        total[at + k] = SENTINEL
    lowest = splat(SENTINEL)
    for k in range(0, padded, LANES):
        lowest = smaller(lowest, load(total, at + k))
    total[at + low], total[at + high - 1] = kept[0], kept[2]
    total[at + index] = kept[1]
    second = np.int64(smallest(lowest))
    lead = second - np.int64(total[at + index])
    return bool(lead * 100 > second * ratio and lead > LEAST_LEAD * ratio)


@inline_kernel
def _offset(costs: Array, total: Array, at: int) -> Any:
    """Return the offset, px, of the best disparity, whose cost is at ``at``.

    It is the minimum of the parabola through the pixel's own costs, because the penalties give
    the sums over paths a sharp minimum, which would pull the offset to whole pixels.
    """
    best = np.float32(costs[at])
    before, after = np.float32(costs[at - 1]) - best, np.float32(costs[at + 1]) - best
    if before < 0 or after < 0 or before + after == 0:
        best = np.float32(total[at])
        before, after = np.float32(total[at - 1]) - best, np.float32(total[at + 1]) - best
        rise = max(before, after)
        return np.float32(0.5) * (before - after) / rise if rise > 0 else np.float32(0)
    return np.float32(0.5) * (before - after) / (before + after)
