# SPDX-License-Identifier: Apache-2.0
"""Slow, obvious twin of semi-global matching: its costs, paths and selection."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from test import naive_ncc

Array = npt.NDArray[np.float64]
WORST, UNKNOWN = 252, 160


def costs(
    left: npt.ArrayLike, right: npt.ArrayLike, size: int, first: int, count: int, noise: float
) -> tuple[Array, list[npt.NDArray[np.bool_]]]:
    """Return costs before rounding (H, W, D), and which pixels of either image have any (H, W).

    Two windows contribute: that of ``size - 2`` with the weight v / (v + n) of its variance v and
    the variance n of the noise, that of ``size`` with the rest.
    """
    radius = size // 2
    left, right = (np.pad(np.asarray(i, float), radius, mode='reflect') for i in (left, right))
    big = naive_ncc.ncc(left, right, size, first, count, 0.0)
    small = naive_ncc.ncc(left, right, max(size - 2, 3), first, count, 0.0)
    inside = slice(radius, -radius)
    height, width = left[inside, inside].shape
    result = np.full((height, width, count), float(UNKNOWN))
    half = max(size - 2, 3) // 2
    for y in range(height):
        for x in range(width):
            rows, columns = y + radius, x + radius
            window = left[rows - half : rows + half + 1, columns - half : columns + half + 1]
            share = window.var() / (window.var() + noise**2)
            for k in range(count):
                if np.isfinite(big[rows, columns, k]):
                    score = (1 - share) * big[rows, columns, k]
                    score += share * np.nan_to_num(small[rows, columns, k])
                    result[y, x, k] = min(max(WORST * (1 - score), 0), WORST)
    return result, [_scored(left, size), _scored(right, size)]


def _scored(padded: Array, size: int) -> npt.NDArray[np.bool_]:
    windows = np.lib.stride_tricks.sliding_window_view(padded, (size, size))
    return np.array([[bool(np.ptp(window) > 0) for window in row] for row in windows])


def aggregate(
    costs: npt.NDArray[np.int64], levels: npt.NDArray[np.int64], P1: int, P2: npt.NDArray[np.int64]
) -> npt.NDArray[np.int64]:
    """Return the sums over three paths, 255 at most; ``P2`` (256) by the difference of levels."""
    ways = ((0, 1), (0, -1), (1, 0))
    return np.minimum(sum(_along(costs, levels, P1, P2, dy, dx) for dy, dx in ways), 255)


def _along(
    costs: npt.NDArray[np.int64],
    levels: npt.NDArray[np.int64],
    P1: int,
    P2: npt.NDArray[np.int64],
    dy: int,
    dx: int,
) -> npt.NDArray[np.int64]:
    height, width, count = costs.shape
    path = costs.copy()
    for y in range(height) if dy >= 0 else reversed(range(height)):
        for x in range(width) if dx >= 0 else reversed(range(width)):
            if not (0 <= y - dy < height and 0 <= x - dx < width):
                continue
            before = path[y - dy, x - dx]
            penalty = P2[abs(levels[y, x] - levels[y - dy, x - dx])]
            for k in range(count):
                ways = [before[k], before.min() + penalty]
                ways += [before[j] + P1 for j in (k - 1, k + 1) if 0 <= j < count]
                path[y, x, k] = costs[y, x, k] + min(ways) - before.min()
    return path


def choose(
    total: npt.NDArray[np.int64],
    costs: npt.NDArray[np.int64],
    scored: list[npt.NDArray[np.bool_]],
    first: int,
    max_difference: float,
) -> Array:
    """Return each left pixel's best disparity if the right one's agrees; NaN = none.

    There is none at the limits of the range, nor where the pixel's own NCC is not above 0. A
    negative ``max_difference`` turns all of this off.
    """
    height, width, count = total.shape
    best = total.argmin(axis=2)
    result = np.full((height, width), np.nan)
    for y in range(height):
        for x in range(width):
            there = x - first - best[y, x]
            if not (0 <= there < width and scored[0][y, x] and scored[1][y, there]):
                continue
            candidates = {
                k: total[y, there + first + k, k]
                for k in range(count)
                if 0 <= there + first + k < width
            }
            winners = [k for k, cost in candidates.items() if cost == min(candidates.values())]
            difference = min(abs(k - best[y, x]) for k in winners)
            positive = costs[y, x, best[y, x]] < 252
            inside = 0 < best[y, x] < count - 1
            if (difference <= max_difference and positive and inside) or max_difference < 0:
                result[y, x] = first + best[y, x]
    return result
