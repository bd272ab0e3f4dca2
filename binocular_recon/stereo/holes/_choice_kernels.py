# SPDX-License-Identifier: Apache-2.0
"""Kernels that compare the measured pixels at the ends of a hole, as the image connects them.

What a hole pixel would take from each direction has a cost: how far away it is, how much the grey
levels differ, and the largest step between neighbours on the way.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from binocular_recon._jit import Array, inline_kernel, kernel
from binocular_recon._simd import LANES, at_most, larger, largest, load, smaller, splat, store
from binocular_recon.stereo.holes._hole_kernels import is_missing, next_hole

# Costs per pixel of distance, per grey level between the pixel and the end, and per level of the
# largest step on the way.
DISTANCE, LEVEL, EDGE = np.float32(0.03), np.float32(0.1), np.float32(0.4)
# Disparities that differ by less belong to the surface that a pixel was filled with.
SAME_SURFACE_PX = np.float32(1.5)
_ZERO, _ONE = np.float32(0), np.float32(1)
_NAN, _FAR = np.float32(np.nan), np.float32(np.inf)


class Costs(NamedTuple):
    """The least costs of hole pixels, (H, W + LANES) float32; elsewhere anything.

    Attributes
    ----------
    least, value : of any direction, and the disparity at the end there.
    own : of the directions whose disparity is that of the fill.

    """

    least: Array
    value: Array
    own: Array


@inline_kernel
def _size(vector: Any) -> Any:
    return larger(vector, splat(_ZERO) - vector)


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
        first, last = next_hole(row, 0)
        while first < last:
            least[first:last] = own[first:last] = _FAR
            for side in range(2):
                x, step = (last, -1) if side else (first - 1, 1)
                if not 0 <= x < width:
                    continue
                end, level, before, steps, edge = row[x], levels[x], levels[x], _ZERO, _ZERO
                for _ in range(last - first):
                    x += step
                    here = levels[x]
                    steps += _ONE
                    edge = max(edge, abs(here - before))
                    before = here
                    cost = DISTANCE * steps + LEVEL * abs(here - level) + EDGE * edge
                    if cost < own[x] and abs(end - fill[x]) < SAME_SURFACE_PX:
                        own[x] = cost
                    if cost < least[x]:
                        least[x], value[x] = cost, end
            first, last = next_hole(row, last)


@kernel
def compare_ends_of_columns(
    measured: Array, filled: Array, guide: Array, costs: Costs, start: int, stop: int
) -> None:
    """Compare also what those of columns ``start`` to ``stop`` find in the north and the south.

    The images have at least `LANES` columns more, without holes.
    """
    height = len(measured)
    none, zero, one, far = splat(_NAN), splat(_ZERO), splat(_ONE), splat(_FAR)
    distance, contrast, steepness = splat(DISTANCE), splat(LEVEL), splat(EDGE)
    for x in range(start, stop, LANES):
        for side in range(2):
            # of each column: the last measured pixel and its level, and the way and the largest
            # edge since
            end, level, steps, edge = none, zero, zero, zero
            for i in range(height):
                y = height - 1 - i if side else i
                if largest(is_missing(load(measured[y], x))) == 0:
                    continue
                here = before = load(guide[y], x)
                known = none
                if i > 0:
                    y_before = y + 1 if side else y - 1
                    known, before = load(measured[y_before], x), load(guide[y_before], x)
                # the way begins anew behind a measured pixel
                end, level = (
                    at_most(known, known, known, end),
                    at_most(known, known, before, level),
                )
                steps = at_most(known, known, zero, steps) + one
                edge = larger(at_most(known, known, zero, edge), _size(here - before))
                cost = distance * steps + contrast * _size(here - level) + steepness * edge
                # none where nothing was measured on the way
                cost = at_most(end, end, cost, far)
                least, own = load(costs.least[y], x), load(costs.own[y], x)
                off = _size(end - load(filled[y], x))
                same = at_most(splat(SAME_SURFACE_PX), off, far, cost)
                store(costs.own[y], x, smaller(own, same))
                store(costs.value[y], x, at_most(least, cost, load(costs.value[y], x), end))
                store(costs.least[y], x, smaller(least, cost))


@kernel
def take_cheaper(
    measured: Array,
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
        begin, end = next_hole(measured[y], 0)
        while begin < end:
            for x in range(begin, end):
                factor = np.float32(other if unexplained[y, x] else occluded)
                if own[x] > factor * lowest[x] + np.float32(least):
                    fill[x] = value[x]
            begin, end = next_hole(measured[y], end)
