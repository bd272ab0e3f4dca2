# SPDX-License-Identifier: Apache-2.0
"""Kernels that compare the measured pixels at the ends of a hole, as the image connects them.

What a hole pixel would take from each direction has a cost: how far away it is, how much the grey
levels differ, and the largest step between neighbours on the way.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from binocular_recon._jit import Array, inline_kernel, kernel

# Costs per pixel of distance, per grey level between the pixel and the end, and per level of the
# largest step on the way.
DISTANCE, LEVEL, EDGE = np.float32(0.03), np.float32(0.1), np.float32(0.4)
# Disparities that differ by less belong to the surface that a pixel was filled with.
SAME_SURFACE_PX = np.float32(1.5)
_ZERO, _ONE = np.float32(0), np.float32(1)
_NAN, _FAR = np.float32(np.nan), np.float32(np.inf)


class Costs(NamedTuple):
    """The least costs of hole pixels, (H, W) float32.

    Attributes
    ----------
    least, value : of any direction, and the disparity at the end there.
    own : of the directions whose disparity is that of the fill.

    """

    least: Array
    value: Array
    own: Array


@inline_kernel
def _cost(steps: Any, difference: Any, edge: Any) -> Any:
    return DISTANCE * steps + LEVEL * abs(difference) + EDGE * edge


@kernel
def compare_ends_of_rows(
    measured: Array, filled: Array, guide: Array, costs: Costs, start: int, stop: int
) -> None:
    """Compare what hole pixels of rows ``start`` to ``stop`` find in the west and in the east.

    ``guide`` (H, W) has no NaN. ``costs`` may hold anything.
    """
    width = measured.shape[1]
    for y in range(start, stop):
        row, fill, levels = measured[y], filled[y], guide[y]
        least, value, own = costs.least[y], costs.value[y], costs.own[y]
        least[:], own[:] = _FAR, _FAR
        for side in range(2):
            end, level, before, steps, edge = _NAN, _ZERO, _ZERO, _ZERO, _ZERO
            for i in range(width):
                x = width - 1 - i if side else i
                here = levels[x]
                if row[x] == row[x]:
                    end, level, before, steps, edge = row[x], here, here, _ZERO, _ZERO
                    continue
                steps += _ONE
                edge = max(edge, abs(here - before))
                before = here
                # no cost where nothing was measured on the way
                cost = _cost(steps, here - level, edge) if end == end else _FAR
                if cost < own[x] and abs(end - fill[x]) < SAME_SURFACE_PX:
                    own[x] = cost
                if cost < least[x]:
                    least[x], value[x] = cost, end


@kernel
def compare_ends_of_columns(
    measured: Array, filled: Array, guide: Array, costs: Costs, start: int, stop: int
) -> None:
    """Compare also what those of columns ``start`` to ``stop`` find in the north and the south."""
    height, width = len(measured), stop - start
    # of each column: the last measured pixel and its level, the level of the last pixel, and the
    # way and the largest edge since
    end, level, before = np.empty((3, width), np.float32)
    steps, edge = np.empty((2, width), np.float32)
    for side in range(2):
        end[:] = _NAN
        for i in range(height):
            y = height - 1 - i if side else i
            row, fill, levels = measured[y], filled[y], guide[y]
            least, value, own = costs.least[y], costs.value[y], costs.own[y]
            for k in range(width):
                x = start + k
                here = levels[x]
                if row[x] == row[x]:
                    end[k], level[k], before[k] = row[x], here, here
                    steps[k], edge[k] = _ZERO, _ZERO
                    continue
                if end[k] != end[k]:
                    continue
                steps[k] += _ONE
                edge[k] = max(edge[k], abs(here - before[k]))
                before[k] = here
                cost = _cost(steps[k], here - level[k], edge[k])
                if cost < own[x] and abs(end[k] - fill[x]) < SAME_SURFACE_PX:
                    own[x] = cost
                if cost < least[x]:
                    least[x], value[x] = cost, end[k]


@kernel
def take_cheaper(
    costs: Costs,
    unexplained: Array,
    limits: tuple[float, float, float],
    filled: Array,
    start: int,
    stop: int,
) -> None:
    """Take the disparity of least cost where that of the fill costs far more.

    ``limits``: a constant, and factors in holes that half-occlusion explains and in others.
    """
    least, occluded, other = limits
    for y in range(start, stop):
        lowest, value, own, fill = costs.least[y], costs.value[y], costs.own[y], filled[y]
        for x in range(fill.size):
            factor = np.float32(other if unexplained[y, x] else occluded)
            if own[x] > factor * lowest[x] + np.float32(least):
                fill[x] = value[x]
