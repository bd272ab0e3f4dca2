# SPDX-License-Identifier: Apache-2.0
"""Kernels that compare a filled pixel with the nearest measured ones around it."""

from __future__ import annotations

import numpy as np

from binocular_recon._jit import Array, kernel

_ZERO, _ONE = np.float32(0), np.float32(1)


@kernel
def _add_candidate(
    candidate: Array, value: Array, hole: Array, squares: Array, counts: Array
) -> None:
    """Add the squared differences of one direction's candidates where there is a hole."""
    for x in range(len(value)):
        difference = candidate[x] - value[x]
        # a comparison with NaN is false
        counted = np.isnan(hole[x]) and difference == difference
        squares[x] += difference * difference if counted else _ZERO
        counts[x] += _ONE if counted else _ZERO


@kernel
def _keep_nearest(row: Array, candidate: Array) -> None:
    for x in range(len(row)):
        candidate[x] = candidate[x] if np.isnan(row[x]) else row[x]


@kernel
def compare_along_rows(
    measured: Array, filled: Array, squares: Array, counts: Array, start: int, stop: int
) -> None:
    """Set the sums over the nearest measured pixels to the left and to the right."""
    width = measured.shape[1]
    candidate = np.empty(width, np.float32)
    for y in range(start, stop):
        row = measured[y]
        squares[y], counts[y] = _ZERO, _ZERO
        for side in range(2):
            nearest = np.float32(np.nan)
            for i in range(width):
                x = width - 1 - i if side else i
                nearest = nearest if np.isnan(row[x]) else row[x]
                candidate[x] = nearest
            _add_candidate(candidate, filled[y], row, squares[y], counts[y])


@kernel
def compare_along_columns(
    measured: Array, filled: Array, squares: Array, counts: Array, start: int, stop: int
) -> None:
    """Add to the sums, in columns ``start`` to ``stop``, those above and below."""
    height = len(measured)
    columns = slice(start, stop)
    candidate = np.empty(stop - start, np.float32)
    for side in range(2):
        candidate[:] = np.nan
        for i in range(height):
            y = height - 1 - i if side else i
            _keep_nearest(measured[y, columns], candidate)
            _add_candidate(
                candidate,
                filled[y, columns],
                measured[y, columns],
                squares[y, columns],
                counts[y, columns],
            )
