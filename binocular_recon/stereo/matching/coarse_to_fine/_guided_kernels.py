# SPDX-License-Identifier: Apache-2.0
"""Kernels of guided matching: NCC at few disparities around those of a coarser match.

Around each pixel the right image is warped by the guess of every pixel of the window, so the
window follows slanted surfaces and stays on one side of an edge. Pixels are scored in tiles of
`TILE_ROWS` rows and `INNER` columns, because neighbouring windows share most of their pixels.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from binocular_recon._jit import Array, inline_kernel, kernel
from binocular_recon._simd import LANES, at_most, larger, load, splat, store
from binocular_recon.stereo import _validity_kernels as reason

RADIUS = 2  # of the window
SIDE = 2 * RADIUS + 1
BAND = 2  # disparities on each side of a guess
OFFSETS = 2 * BAND + 1
MARGIN = OFFSETS  # columns without data on each side of the right image
TILE_ROWS = 8
INNER = LANES - 2 * RADIUS
NO_GUESS = 2**20  # beyond every image
NO_SCORE = np.float32(-2)


class GuidedPair(NamedTuple):
    """Both images with a border without data, and the guesses.

    ``left`` (H + 2 RADIUS, W + 2 RADIUS + LANES) and ``right`` (H + 2 RADIUS, W + 2 MARGIN) are
    float32, NaN = no data. ``guesses`` (S, ceil(H / 2), ceil(W / 2)) int32: disparities of up to S
    surfaces at each pixel of half the resolution, in whole pixels of the full one; `NO_GUESS` =
    none. ``edges`` (ceil(H / 2), ceil(W / 2)): where the surfaces differ. ``least_energy``: least
    sum of squared differences from the mean of a window that is scored, times its pixels.
    """

    left: Array
    right: Array
    guesses: Array
    edges: Array
    least_energy: float


@inline_kernel
def _warp(pair: GuidedPair, surface: int, y: int, x: int, warped: Array, bases: Array) -> None:
    """Copy the pixels of the right image that the guesses of a tile's pixels point to.

    The tile's first pixel is (``y``, ``x``). Writes, per row and column of the tile with its
    border, the guess to ``bases`` and the pixel at each offset from it to ``warped``.
    """
    height, width = pair.left.shape[0] - 2 * RADIUS, pair.left.shape[1] - 2 * RADIUS - LANES
    last = width + 2 * MARGIN - OFFSETS
    for j in range(TILE_ROWS + 2 * RADIUS):
        row = min(max(y + j - RADIUS, 0), height - 1)
        guesses, right = pair.guesses[surface, row // 2], pair.right[row + RADIUS]
        at = j * LANES
        for i in range(LANES):
            column = min(max(x + i - RADIUS, 0), width - 1)
            guess = guesses[column // 2]
            bases[at + i] = guess
            first = min(max(column - guess - BAND + MARGIN, 0), last)
            for k in range(OFFSETS):
                warped[k, at + i] = right[first + OFFSETS - 1 - k]


@inline_kernel
def _row_sums(sums: Array) -> None:
    """Replace each number by the sum of itself and those up to the window's side behind it."""
    total = load(sums, 0)
    for i in range(1, SIDE):
        total = total + load(sums, i)
    store(sums, 0, total)


@inline_kernel
def _score(
    pair: GuidedPair,
    warped: Array,
    bases: Array,
    tile: tuple[int, int, int],
    work: Array,
    results: tuple[Array, Array],
) -> None:
    """Score the windows of a tile, and keep the best disparity of each pixel.

    Scores are the square of the NCC with its sign: they have the same maximum, without a root.
    """
    top, x, rows = tile
    found, best = results
    scores, sums_r, sums_rr, sums_lr = work[0], work[1], work[2], work[3]
    count, zero, half = splat(np.float32(SIDE * SIDE)), splat(np.float32(0)), splat(np.float32(0.5))
    no_score, least = splat(NO_SCORE), splat(np.float32(pair.least_energy))
    scored, one = splat(np.float32(-1)), splat(np.float32(1))
    for j in range(rows):
        sum_l = sum_ll = zero
        for m in range(SIDE):
            level = load(pair.left[top + j + m], x)
            sum_l, sum_ll = sum_l + level, sum_ll + level * level
        store(sums_r, 0, sum_l)
        store(sums_rr, 0, sum_ll)
        _row_sums(sums_r)
        _row_sums(sums_rr)
        sum_l = load(sums_r, 0)
        energy_l = load(sums_rr, 0) * count - sum_l * sum_l
        for k in range(OFFSETS):
            sum_r = sum_rr = sum_lr = zero
            for m in range(SIDE):
                level = load(warped[k], (j + m) * LANES)
                sum_r, sum_rr = sum_r + level, sum_rr + level * level
                sum_lr = sum_lr + level * load(pair.left[top + j + m], x)
            store(sums_r, 0, sum_r)
            store(sums_rr, 0, sum_rr)
            store(sums_lr, 0, sum_lr)
            _row_sums(sums_r)
            _row_sums(sums_rr)
            _row_sums(sums_lr)
            sum_r = load(sums_r, 0)
            energy_r = load(sums_rr, 0) * count - sum_r * sum_r
            covariance = load(sums_lr, 0) * count - sum_l * sum_r
            score = covariance * larger(covariance, zero - covariance) / (energy_l * energy_r)
            score = at_most(least, energy_l, score, no_score)
            store(scores, k * LANES, at_most(least, energy_r, score, no_score))
        base = load(bases, (j + RADIUS) * LANES + RADIUS)
        highest, value = load(best, j * LANES), load(found, j * LANES)
        for k in range(OFFSETS):
            score = load(scores, k * LANES)
            offset = zero
            if 0 < k < OFFSETS - 1:
                before, after = load(scores, (k - 1) * LANES), load(scores, (k + 1) * LANES)
                curvature = score + score - before - after
                offset = half * (after - before) / larger(curvature, splat(np.float32(1e-6)))
                offset = at_most(curvature, zero, zero, offset)
                offset = at_most(scored, before, at_most(scored, after, offset, zero), zero)
                offset = at_most(offset, one, at_most(zero - one, offset, offset, zero), zero)
            value = at_most(score, highest, value, base + splat(np.float32(k - BAND)) + offset)
            highest = larger(highest, score)
        store(best, j * LANES, highest)
        store(found, j * LANES, value)


@inline_kernel
def _has_edge(edges: Array, tile: tuple[int, int, int]) -> bool:
    """Return whether the surfaces differ anywhere in a tile."""
    top, x, rows = tile
    some = False
    for j in range(top // 2, (top + rows + 1) // 2):
        for i in range(x // 2, min((x + INNER + 1) // 2, edges.shape[1])):
            some |= edges[j, i]
    return some


@kernel
def refine_strip(
    pair: GuidedPair,
    images: tuple[Array, Array, Array],
    clear: float,
    start: int,
    stop: int,
) -> None:
    """Write the best disparities of rows ``start`` to ``stop`` around their guesses.

    ``images``: the guess of each pixel of half resolution, in its pixels, NaN = none; where it is
    doubtful, bool; and the result (H, W), NaN = none. Without a score a pixel keeps its guess; a
    doubtful one needs a score above ``clear``.
    """
    guesses, doubtful, disparity = images
    width = disparity.shape[1]
    warped = np.zeros((OFFSETS, (TILE_ROWS + 2 * RADIUS) * LANES), np.float32)
    bases = np.zeros((TILE_ROWS + 2 * RADIUS + 1) * LANES, np.float32)
    work = np.zeros((4, OFFSETS * LANES), np.float32)
    found, best = np.zeros(TILE_ROWS * LANES, np.float32), np.zeros(TILE_ROWS * LANES, np.float32)
    for top in range(start, stop, TILE_ROWS):
        for x in range(0, width, INNER):
            tile = (top, x, min(TILE_ROWS, stop - top))
            surfaces = pair.guesses.shape[0] if _has_edge(pair.edges, tile) else 1
            best[:] = NO_SCORE
            for surface in range(surfaces):
                _warp(pair, surface, top, x, warped, bases)
                _score(pair, warped, bases, tile, work, (found, best))
            for j in range(tile[2]):
                y = top + j
                for i in range(min(INNER, width - x)):
                    score = best[j * LANES + i]
                    value = np.float32(2) * guesses[y // 2, (x + i) // 2]
                    value = found[j * LANES + i] if score > NO_SCORE else value
                    kept = score > clear or not doubtful[y // 2, (x + i) // 2]
                    disparity[y, x + i] = value if kept else np.float32(np.nan)


@kernel
def hidden_strip(
    disparity: Array, tolerance: float, validity: Array, start: int, stop: int
) -> None:
    """Drop disparities that lead to a pixel of the right image where another surface is nearer.

    A surface is nearer if its disparity is larger by more than ``tolerance``.
    """
    width = disparity.shape[1]
    nearest = np.empty(width, np.float32)
    for y in range(start, stop):
        nearest[:] = -np.inf
        row = disparity[y]
        for x in range(width):
            if row[x] == row[x]:
                there = x - int(np.rint(row[x]))
                if 0 <= there < width:
                    nearest[there] = max(nearest[there], row[x])
        for x in range(width):
            if row[x] == row[x]:
                there = x - int(np.rint(row[x]))
                if 0 <= there < width and nearest[there] - row[x] > tolerance:
                    row[x] = np.nan
                    validity[y, x] = reason.CONFLICT
