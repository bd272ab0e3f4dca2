# SPDX-License-Identifier: Apache-2.0
"""Kernel of the columns of windows, from which the extremes of whole windows are found."""

from __future__ import annotations

from binocular_recon._jit import Array, inline_kernel
from binocular_recon._simd import LANES, larger, load, smaller, store


@inline_kernel
def column_range(values: Array, y: int, side: int, spacing: int, low: Array, high: Array) -> None:
    """Write the smallest and the largest value of each column of the windows from row ``y`` on.

    They have every ``spacing``-th of ``side`` rows.
    """
    for x in range(0, low.size - LANES + 1, LANES):
        least = most = load(values[y], x)
        for j in range(spacing, side, spacing):
            value = load(values[y + j], x)
            least, most = smaller(least, value), larger(most, value)
        store(low, x, least)
        store(high, x, most)
