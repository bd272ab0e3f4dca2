# SPDX-License-Identifier: Apache-2.0
"""Kernels that prepare guided matching, at half the resolution: guesses, and steps of grey."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from binocular_recon._jit import Array, inline_kernel, kernel
from binocular_recon._simd import LANES, larger, load, smaller, store

NO_GUESS = 2**20  # beyond every image


class Guesses(NamedTuple):
    """What is known of each pixel of half resolution (h, w) before the match at full resolution.

    ``known``: its disparity in its pixels, else that of the farthest surface around it, NaN =
    none; ``guesses`` (3, h, w) int32: that one, and those of the nearest and of the farthest
    surface around it, in whole pixels of full resolution, `NO_GUESS` = none; ``edges``: whether
    these two differ; ``doubtful``: whether its own disparity is missing or at the limits.
    """

    known: Array
    guesses: Array
    edges: Array
    doubtful: Array


@inline_kernel
def _in_full_pixels(values: Array, guesses: Array) -> None:
    """Write disparities of half resolution in whole pixels of full resolution."""
    two, nothing = np.float32(2), np.float32(NO_GUESS)
    for x in range(guesses.size):
        guesses[x] = np.int32(np.rint(two * values[x]) if values[x] == values[x] else nothing)


@kernel
def guess_strip(
    coarse: Array, edge: float, limits: tuple[float, float], out: Guesses, start: int, stop: int
) -> None:
    """Write rows ``start`` to ``stop`` of ``out``.

    ``coarse`` (h + 2, w + 2 + LANES): disparities with a border of NaN; surfaces differ if their
    disparities do by more than ``edge``.
    """
    width = out.known.shape[1]
    step, low, high = np.float32(edge), np.float32(limits[0]), np.float32(limits[1])
    far, near = (
        np.empty(width + 2 + 2 * LANES, np.float32),
        np.empty(width + 2 + 2 * LANES, np.float32),
    )
    for y in range(start, stop):
        for x in range(0, width + 2, LANES):
            above, here, below = load(coarse[y], x), load(coarse[y + 1], x), load(coarse[y + 2], x)
            store(far, x, smaller(smaller(above, here), below))
            store(near, x, larger(larger(above, here), below))
        for x in range(0, width, LANES):
            store(far, x, smaller(smaller(load(far, x), load(far, x + 1)), load(far, x + 2)))
            store(near, x, larger(larger(load(near, x), load(near, x + 1)), load(near, x + 2)))
        known, edges, doubtful = out.known[y], out.edges[y], out.doubtful[y]
        first, second, third = out.guesses[0, y], out.guesses[1, y], out.guesses[2, y]
        for x in range(width):
            own = coarse[y + 1, x + 1]
            known[x] = own if own == own else far[x]
        _in_full_pixels(known, first)
        _in_full_pixels(near, second)
        _in_full_pixels(far, third)
        for x in range(width):
            edges[x] = near[x] - far[x] > step
        for x in range(width):
            whole = np.rint(coarse[y + 1, x + 1])
            doubtful[x] = not ((whole > low) & (whole < high))


@kernel
def sum_steps(image: Array, half: Array, sums: Array, start: int, stop: int) -> None:
    """Sum the steps between neighbours in a row over the pixels of half resolution.

    ``sums`` (4, h, w): steps of ``image`` (H, W), 4 to a pixel, and their squares; steps of
    ``half`` (h, w), and their squares. A step from or to a pixel without data is 0.
    """
    height, width = image.shape
    half_width = half.shape[1]
    zero = np.float32(0)
    values, squares = np.zeros(2 * half_width, np.float32), np.zeros(2 * half_width, np.float32)
    for y in range(start, stop):
        upper, lower = image[2 * y], image[min(2 * y + 1, height - 1)]
        for x in range(1, width):
            one, other = upper[x] - upper[x - 1], lower[x] - lower[x - 1]
            one = one if one == one else zero
            other = other if other == other else zero
            values[x], squares[x] = one + other, one * one + other * other
        own = half[y]
        for x in range(half_width):
            sums[0, y, x] = values[2 * x] + values[2 * x + 1]
        for x in range(half_width):
            sums[1, y, x] = squares[2 * x] + squares[2 * x + 1]
        sums[2, y, 0] = sums[3, y, 0] = zero
        for x in range(1, half_width):
            step = own[x] - own[x - 1]
            step = step if step == step else zero
            sums[2, y, x], sums[3, y, x] = step, step * step
