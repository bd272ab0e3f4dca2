# SPDX-License-Identifier: Apache-2.0
"""Kernels that compare the measured pixels at the ends of a hole, as the image connects them.

What a hole pixel would take from each direction has a cost: how far away it is, how much the grey
levels differ, and the largest step between neighbours on the way.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from binocular_recon._jit import Array, inline_kernel, kernel

# Costs per pixel of distance, per grey level between the pixel and the end, and per level of the
# largest step on the way.
DISTANCE, LEVEL, EDGE = np.float32(0.03), np.float32(0.1), np.float32(0.4)
# Disparities that differ by less belong to the surface that a pixel was filled with.
SAME_SURFACE_PX = np.float32(1.5)
_ZERO, _NAN = np.float32(0), np.float32(np.nan)


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


class Ray(NamedTuple):
    """Where each of N sweeps is, float32: the last measured pixel, and the way from there.

    Attributes
    ----------
    disparity, level : of the last measured pixel; NaN = none yet.
    previous : grey level of the last pixel.
    steps, edge : number of pixels since, and the largest step of grey level between them.

    """

    disparity: Array
    level: Array
    previous: Array
    steps: Array
    edge: Array


@inline_kernel
def _new_ray(count: int) -> Ray:
    return Ray(
        np.full(count, _NAN),
        np.full(count, _NAN),
        np.full(count, _NAN),
        np.zeros(count, np.float32),
        np.zeros(count, np.float32),
    )


@inline_kernel
def _visit(
    measured: Array, filled: Array, guide: Array, costs: Costs, ray: Ray, i: int, y: int, x: int
) -> None:
    """Move ray ``i`` to a pixel; in a hole, compare the cost of what the ray brings."""
    here, level = measured[y, x], guide[y, x]
    if here == here:
        ray.disparity[i], ray.level[i], ray.previous[i] = here, level, level
        ray.steps[i], ray.edge[i] = _ZERO, _ZERO
        return
    ray.steps[i] += np.float32(1)
    ray.edge[i] = max(ray.edge[i], abs(level - ray.previous[i]))
    ray.previous[i] = level
    cost = DISTANCE * ray.steps[i] + LEVEL * abs(level - ray.level[i]) + EDGE * ray.edge[i]
    # comparisons with NaN, where nothing was measured on the way, are false
    if abs(ray.disparity[i] - filled[y, x]) < SAME_SURFACE_PX and cost < costs.own[y, x]:
        costs.own[y, x] = cost
    if cost < costs.least[y, x]:
        costs.least[y, x], costs.value[y, x] = cost, ray.disparity[i]


@kernel
def compare_ends_of_rows(
    measured: Array, filled: Array, guide: Array, costs: Costs, start: int, stop: int
) -> None:
    """Compare what hole pixels of rows ``start`` to ``stop`` find in the west and in the east.

    ``guide`` (H, W) has no NaN. ``costs`` must be infinite.
    """
    width = measured.shape[1]
    for y in range(start, stop):
        for side in range(2):
            ray = _new_ray(1)
            for i in range(width):
                x = width - 1 - i if side else i
                _visit(measured, filled, guide, costs, ray, 0, y, x)


@kernel
def compare_ends_of_columns(
    measured: Array, filled: Array, guide: Array, costs: Costs, start: int, stop: int
) -> None:
    """Compare also what those of columns ``start`` to ``stop`` find in the north and the south."""
    height = len(measured)
    for side in range(2):
        ray = _new_ray(stop - start)
        for i in range(height):
            y = height - 1 - i if side else i
            for x in range(start, stop):
                _visit(measured, filled, guide, costs, ray, x - start, y, x)


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
        for x in range(filled.shape[1]):
            factor = np.float32(other if unexplained[y, x] else occluded)
            if costs.own[y, x] > factor * costs.least[y, x] + np.float32(least):
                filled[y, x] = costs.value[y, x]
