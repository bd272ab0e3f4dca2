# SPDX-License-Identifier: Apache-2.0
"""Kernels of guided matching: NCC at few disparities around those of a coarser match.

Around each pixel the right image is warped by the guess of every pixel of the window, so the
window follows slanted surfaces and stays on one side of an edge. Pixels are scored in tiles of
`TILE_ROWS` rows and `INNER` columns, because neighbouring windows share most of their pixels.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from binocular_recon._jit import Array, inline_kernel, kernel
from binocular_recon._simd import (
    LANES,
    at_most,
    copy_pair,
    larger,
    load,
    smaller,
    splat,
    store,
)

RADIUS = 1  # of the window
SIDE = 2 * RADIUS + 1
OFFSETS = 3  # a guess, and the disparities on both sides of it
BAND = OFFSETS // 2
MARGIN = OFFSETS + 1  # columns without data on each side of the right image
TILE_ROWS = 8
INNER = LANES - 2 * RADIUS
STRIDE = (
    LANES + 2
)  # of the rows of a tile: two columns share a guess, and pairs begin at even ones
LEAD = 2 - RADIUS  # where the first lane is in them
NO_SCORE = np.float32(-2)


class GuidedPair(NamedTuple):
    """Both images with a border without data, and the guesses.

    ``left`` (H + 2 RADIUS, W + 2 RADIUS + LANES) and ``right`` (H + 2 RADIUS, W + 2 MARGIN) are
    float32, NaN = no data. ``guesses`` and ``edges``: see `Guesses`. ``least_energy``: least sum
    of squared differences from the mean of a window that is scored, times its pixels.
    """

    left: Array
    right: Array
    guesses: Array
    edges: Array
    least_energy: float


class Work(NamedTuple):
    """What a tile needs: its pixels row by row, `LANES` columns, with its border.

    ``bases``: the guesses, rows of `STRIDE`; ``warped`` (OFFSETS, ...): right pixels at each
    offset from them, likewise; ``sums``: sums over the rows of windows, of levels and squares of
    the left image, then of levels, squares and products at each offset; ``found`` and ``best``:
    the best disparity and its score; ``tried``: 1 where the guesses are tried, else 0.
    """

    bases: Array
    warped: Array
    sums: Array
    found: Array
    best: Array
    tried: Array


@inline_kernel
def _new_work() -> Work:
    size = TILE_ROWS * LANES
    whole = (TILE_ROWS + 2 * RADIUS) * STRIDE + 2 * LANES
    kind = np.float32
    return Work(
        np.zeros(whole, kind),
        np.zeros((OFFSETS, whole), kind),
        np.zeros((2 + 3 * OFFSETS, size + LANES), kind),
        np.zeros(size, kind),
        np.zeros(size, kind),
        np.zeros(size, kind),
    )


@inline_kernel
def _warp(
    pair: GuidedPair, surface: int, tile: tuple[int, int], wanted: Array, work: Work
) -> None:
    """Copy the pixels of the right image that the guesses of a tile's pixels point to.

    Of the rows of the tile, with its border, that are needed for those ``wanted``.
    """
    top, x = tile
    height, half_width = pair.left.shape[0] - 2 * RADIUS, pair.guesses.shape[2]
    last = pair.right.shape[1] - OFFSETS - 1
    bases, warped = work.bases, work.warped
    for j in range(TILE_ROWS + 2 * RADIUS):
        needed = False
        for i in range(max(j - 2 * RADIUS, 0), min(j + 1, TILE_ROWS)):
            needed |= wanted[i]
        if not needed:
            continue
        row = min(max(top + j - RADIUS, 0), height - 1)
        guesses, right = pair.guesses[surface, row >> 1], pair.right[row + RADIUS]
        for i in range(0, STRIDE, 2):
            column, at = x - 2 + i, j * STRIDE + i
            guess = guesses[min(max(column >> 1, 0), half_width - 1)]
            bases[at] = bases[at + 1] = guess
            first = min(max(column - guess - BAND + MARGIN, 0), last)
            for k in range(OFFSETS):
                copy_pair(right, first + OFFSETS - 1 - k, warped[k], at)


@inline_kernel
def _sum_columns(pair: GuidedPair, tile: tuple[int, int], wanted: Array, work: Work) -> None:
    """Sum levels, squares and products over the rows of the windows of each wanted row."""
    top, x = tile
    zero = splat(np.float32(0))
    warped, sums = work.warped, work.sums
    for j in range(TILE_ROWS):
        if not wanted[j]:
            continue
        sum_l = sum_ll = zero
        for m in range(SIDE):
            level = load(pair.left[top + j + m], x)
            sum_l, sum_ll = sum_l + level, sum_ll + level * level
        store(sums[0], j * LANES, sum_l)
        store(sums[1], j * LANES, sum_ll)
        for k in range(OFFSETS):
            sum_r = sum_rr = sum_lr = zero
            for m in range(SIDE):
                level = load(warped[k], (j + m) * STRIDE + LEAD)
                sum_r, sum_rr = sum_r + level, sum_rr + level * level
                sum_lr = sum_lr + level * load(pair.left[top + j + m], x)
            store(sums[3 * k + 2], j * LANES, sum_r)
            store(sums[3 * k + 3], j * LANES, sum_rr)
            store(sums[3 * k + 4], j * LANES, sum_lr)


@inline_kernel
def _window_sum(sums: Array, at: int) -> Any:
    """Return the sums over whole windows from those of their columns."""
    total = load(sums, at)
    for i in range(1, SIDE):
        total = total + load(sums, at + i)
    return total


@inline_kernel
def _score(sums: Array, at: int, k: int, left: tuple[Any, Any], least_energy: float) -> Any:
    """Return the scores of windows at an offset; ``left``: sums and energies of the left image.

    They are the square of the NCC with its sign: it has the same maximum, without a root.
    """
    count, zero = splat(np.float32(SIDE * SIDE)), splat(np.float32(0))
    no_score, least = splat(NO_SCORE), splat(np.float32(least_energy))
    sum_l, energy_l = left
    sum_r = _window_sum(sums[3 * k + 2], at)
    energy_r = _window_sum(sums[3 * k + 3], at) * count - sum_r * sum_r
    covariance = _window_sum(sums[3 * k + 4], at) * count - sum_l * sum_r
    energies = larger(energy_l * energy_r, splat(np.float32(1e-12)))
    score = covariance * larger(covariance, zero - covariance) / energies
    return at_most(least, energy_r, at_most(least, energy_l, score, no_score), no_score)


@inline_kernel
def _mean_guess(bases: Array, at: int) -> Any:
    """Return the mean guess of the window around each pixel, of those on the same surface.

    An offset is that of the window, not of its middle pixel, whose guess is rounded.
    """
    zero, one, pixels = splat(np.float32(0)), splat(np.float32(1)), splat(np.float32(SIDE * SIDE))
    middle = load(bases, at + RADIUS * STRIDE + RADIUS)
    total = zero
    for j in range(SIDE):
        for i in range(SIDE):
            step = load(bases, at + j * STRIDE + i) - middle
            total = total + at_most(larger(step, zero - step), one, step, zero)
    return middle + total / pixels


@inline_kernel
def _keep_best(least_energy: float, wanted: Array, work: Work) -> None:
    """Keep the best disparity of each pixel of a tile, at the maximum of a parabola."""
    zero, one, half = splat(np.float32(0)), splat(np.float32(1)), splat(np.float32(0.5))
    scored, flat = splat(np.float32(-1)), splat(np.float32(1e-6))
    no_score = splat(NO_SCORE)
    sums, found, best = work.sums, work.found, work.best
    for j in range(TILE_ROWS):
        if not wanted[j]:
            continue
        at = j * LANES
        sum_l = _window_sum(sums[0], at)
        left = sum_l, _window_sum(sums[1], at) * splat(np.float32(SIDE * SIDE)) - sum_l * sum_l
        before = _score(sums, at, 0, left, least_energy)
        same = _score(sums, at, 1, left, least_energy)
        after = _score(sums, at, 2, left, least_energy)
        curvature = same + same - before - after
        vertex = half * (after - before) / larger(curvature, flat)
        vertex = larger(smaller(vertex, one), zero - one)
        highest = larger(before, same)
        step = at_most(after, highest, at_most(same, before, zero - one, zero), one)
        curved = at_most(curvature, flat, step, vertex)
        step = at_most(before, scored, step, at_most(after, scored, step, curved))
        highest = larger(highest, after)
        value = _mean_guess(work.bases, j * STRIDE + LEAD) + step
        score = at_most(one, load(work.tried, at), highest, no_score)
        store(found, at, at_most(score, load(best, at), load(found, at), value))
        store(best, at, larger(load(best, at), score))


@inline_kernel
def _select(edges: Array, tile: tuple[int, int], rows: int, wanted: Array, work: Work) -> bool:
    """Select the pixels at ``edges`` in the first ``rows`` rows of a tile; return whether any.

    Selects all pixels if ``edges`` is empty.
    """
    top, x = tile
    some, last = False, edges.shape[1] - 1
    for j in range(TILE_ROWS):
        wanted[j] = False
        if j >= rows:
            continue
        for i in range(LANES):
            tried = edges.size == 0 or edges[(top + j) >> 1, min((x + i) >> 1, last)]
            work.tried[j * LANES + i] = tried
            wanted[j] |= tried
        some |= wanted[j]
    return some


@kernel
def refine_strip(
    pair: GuidedPair,
    halves: tuple[Array, Array, Array],
    clear: float,
    results: tuple[Array, Array],
    start: int,
    stop: int,
) -> None:
    """Write the best disparities of rows ``start`` to ``stop`` around their guesses.

    ``halves``, of each pixel of half resolution: the guess in its pixels, NaN = none; whether it
    is doubtful; and the validity. ``results`` (H, W): disparity, NaN = none, and validity. Without
    a score a pixel keeps its guess; a doubtful one needs a score above ``clear``.
    """
    guesses, doubtful, reasons = halves
    disparity, validity = results
    width = disparity.shape[1]
    work, wanted = _new_work(), np.empty(TILE_ROWS, np.bool_)
    found, best = work.found, work.best
    limit, none = np.float32(clear), np.float32(np.nan)
    for top in range(start, stop, TILE_ROWS):
        rows = min(TILE_ROWS, stop - top)
        for x in range(0, width, INNER):
            tile = (top, x)
            best[:] = NO_SCORE
            for surface in range(pair.guesses.shape[0]):
                pixels = pair.edges if surface > 0 else pair.edges[:0]
                if surface < 2 and not _select(pixels, tile, rows, wanted, work):
                    break
                _warp(pair, surface, tile, wanted, work)
                _sum_columns(pair, tile, wanted, work)
                _keep_best(pair.least_energy, wanted, work)
            for j in range(rows):
                half = (top + j) >> 1
                own, unsure, known = guesses[half], doubtful[half], reasons[half]
                out, why = disparity[top + j], validity[top + j]
                for i in range(min(INNER, width - x)):
                    half, score = (x + i) >> 1, best[j * LANES + i]
                    value = found[j * LANES + i] if score > NO_SCORE else own[half] + own[half]
                    kept = (score > limit) | (unsure[half] == 0)
                    out[x + i] = value if kept else none
                    why[x + i] = known[half]
