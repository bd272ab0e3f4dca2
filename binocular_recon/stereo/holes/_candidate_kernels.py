# SPDX-License-Identifier: Apache-2.0
"""Kernels that compare filled pixels with the nearest measured ones around them."""

from __future__ import annotations

import numpy as np

from binocular_recon._jit import Array, inline_kernel, kernel

_ZERO, _ONE = np.float32(0), np.float32(1)


@inline_kernel
def _add_candidate(
    candidate: Array, value: Array, hole: Array, squares: Array, counts: Array
) -> None:
    """Add the squared differences from the candidates of one direction where there is a hole."""
    for x in range(len(value)):
        difference = candidate[x] - value[x]
        # a comparison with NaN is false
        counted = np.isnan(hole[x]) and difference == difference
        squares[x] += difference * difference if counted else _ZERO
        counts[x] += _ONE if counted else _ZERO


@inline_kernel
def _keep_nearest(row: Array, candidate: Array) -> None:
    for x in range(len(row)):
        candidate[x] = candidate[x] if np.isnan(row[x]) else row[x]


@kernel
def compare_along_rows(
    measured: Array, filled: Array, squares: Array, counts: Array, start: int, stop: int
) -> None:
    """Set the sums to those over the nearest measured pixels in the west and in the east."""
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
    """Add the nearest measured pixels in the north and south, in columns ``start`` to ``stop``."""
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
