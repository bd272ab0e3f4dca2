# SPDX-License-Identifier: Apache-2.0
"""Kernels that compare filled pixels with the nearest measured ones around them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from binocular_recon._jit import Array, exact_kernel, inline_kernel, kernel
from binocular_recon.stereo.holes._hole_kernels import keep_nearest

# Bits of the directions in which a pixel has a measured one.
WEST, EAST, NORTH, SOUTH = 1, 2, 4, 8
_ZERO, _ONE = np.float32(0), np.float32(1)


@inline_kernel
def _add_candidate(
    candidate: Array, value: Array, hole: Array, squares: Array, found: Array, direction: int
) -> None:
    """Add the squared differences from the candidates of one direction where there is a hole."""
    bit, none = np.uint8(direction), np.uint8(0)
    for x in range(len(value)):
        difference = candidate[x] - value[x]
        # a comparison with NaN is false
        counted = np.isnan(hole[x]) and difference == difference
        squares[x] += difference * difference if counted else _ZERO
        found[x] |= bit if counted else none


@kernel
def compare_along_rows(
    measured: Array, filled: Array, squares: Array, found: Array, start: int, stop: int
) -> None:
    """Set the sums to those over the nearest measured pixels in the west and in the east."""
    width = measured.shape[1]
    candidate = np.empty(width, np.float32)
    for y in range(start, stop):
        row = measured[y]
        squares[y], found[y] = _ZERO, 0
        for side in range(2):
            nearest = np.float32(np.nan)
            for i in range(width):
                x = width - 1 - i if side else i
                nearest = nearest if np.isnan(row[x]) else row[x]
                candidate[x] = nearest
            direction = EAST if side else WEST
            _add_candidate(candidate, filled[y], row, squares[y], found[y], direction)


@kernel
def compare_along_columns(
    measured: Array, filled: Array, squares: Array, found: Array, start: int, stop: int
) -> None:
    """Add the nearest measured pixels in the north and south, in columns ``start`` to ``stop``."""
    height = len(measured)
    columns = slice(start, stop)
    candidate = np.empty(stop - start, np.float32)
    for side in range(2):
        candidate[:] = np.nan
        for i in range(height):
            y = height - 1 - i if side else i
            keep_nearest(measured[y, columns], candidate)
            _add_candidate(
                candidate,
                filled[y, columns],
                measured[y, columns],
                squares[y, columns],
                found[y, columns],
                SOUTH if side else NORTH,
            )


class Weights(NamedTuple):
    """The weights of the terms of the variance; see `uncertainty`.

    Attributes
    ----------
    rows, candidates : float
        Of the variance along rows nearby, and of the mean square difference from the nearest
        measured pixels in four directions.
    most_candidates : float
        The second counts up to this multiple of the first.
    unexplained : float
        Factor on both in holes that half-occlusion does not explain.
    distance, distance_beyond : float
        Standard deviation per pixel of distance from the nearest measured one, in these and in
        other extrapolated ones.

    """

    rows: float
    candidates: float
    most_candidates: float
    unexplained: float
    distance: float
    distance_beyond: float


class Surroundings(NamedTuple):
    """What is known of the pixels of a map, (H, W).

    Attributes
    ----------
    found : uint8
        Bits of the directions that have a measured pixel.
    nearby, distance : float32
        Variance along the rows nearby, px^2; distance from the nearest measured pixel, px.
    unexplained : bool
        Whether half-occlusion does not explain the hole.
    open : (H / 2, W / 2) bool
        Whether the hole is unexplained and reaches the image border; half as many rows and
        columns, rounded up.

    """

    found: Array
    nearby: Array
    distance: Array
    unexplained: Array
    open: Array


@exact_kernel
def sum_variance(
    measured: Array,
    around: Surroundings,
    weights: Weights,
    marks: tuple[int, int, int],
    variance: Array,
    validity: Array,
    start: int,
    stop: int,
) -> None:
    """Turn the sums of squares of rows into variances, and mark pixels.

    ``marks`` are those of measured, filled and extrapolated pixels.
    """
    rows, candidates, most = (
        np.float32(weights.rows),
        np.float32(weights.candidates),
        np.float32(weights.most_candidates),
    )
    for y in range(start, stop):
        for x in range(measured.shape[1]):
            if not np.isnan(measured[y, x]):
                variance[y, x], validity[y, x] = _ZERO, marks[0]
                continue
            found, near = around.found[y, x], around.nearby[y, x]
            count = (found & 1) + (found >> 1 & 1) + (found >> 2 & 1) + (found >> 3)
            mean = variance[y, x] / np.float32(max(count, 1))
            total = min(mean, most * near) * candidates + rows * near
            enclosed = found & 3 == 3 or found & 12 == 12
            unexplained = around.unexplained[y, x]
            extrapolated = not enclosed or (unexplained and around.open[y // 2, x // 2])
            slope = weights.distance_beyond if extrapolated else 0.0
            if unexplained:
                slope = weights.distance
                total *= np.float32(weights.unexplained)
            reach = around.distance[y, x] * np.float32(slope)
            variance[y, x] = total + reach * reach
            validity[y, x] = marks[2] if extrapolated else marks[1]
