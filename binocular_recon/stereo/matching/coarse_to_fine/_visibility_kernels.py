# SPDX-License-Identifier: Apache-2.0
"""Kernel of visibility: of the surfaces at one pixel of the right image, the nearest is seen."""

from __future__ import annotations

import numpy as np

from binocular_recon._jit import Array, kernel
from binocular_recon.stereo import _validity_kernels as reason


@kernel
def hidden_strip(
    disparity: Array,
    tolerance: float,
    limits: tuple[float, float],
    validity: Array,
    start: int,
    stop: int,
) -> None:
    """Drop disparities that lead to a pixel of the right image where another surface is nearer.

    A surface is nearer if its disparity is larger by more than ``tolerance``. Disparities outside
    ``limits`` are dropped, too.
    """
    width = disparity.shape[1]
    none, below = np.float32(np.nan), np.float32(-np.inf)
    low, high = np.float32(limits[0]), np.float32(limits[1])
    behind, first, last = np.float32(tolerance), np.float32(0), np.float32(width + 1)
    # the right column of each pixel, from 1 on; the image lacks the first and the last one
    places = np.arange(1, width + 1).astype(np.float32)
    columns = np.empty(width, np.uint32)
    nearest, rival = np.empty(width + 2, np.float32), np.empty(width, np.float32)
    for y in range(start, stop):
        row, why = disparity[y], validity[y]
        for x in range(width):
            there = places[x] - np.rint(row[x])
            there = max(first, there)  # none: NaN
            columns[x] = np.uint32(np.int32(min(last, there)))
        nearest[:] = below
        for x in range(width):
            there, value = columns[x], row[x]
            nearest[there] = max(nearest[there], value)
        nearest[0] = nearest[width + 1] = below
        for x in range(width):
            rival[x] = nearest[columns[x]]
        for x in range(width):
            value = row[x]
            outside = (value < low) | (value > high)
            verdict = reason.AT_LIMIT if outside else why[x]
            why[x] = reason.CONFLICT if rival[x] - value > behind else verdict
        for x in range(width):
            value = row[x]
            dropped = (rival[x] - value > behind) | (value < low) | (value > high)
            row[x] = none if dropped else value
