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
from binocular_recon._simd import LANES, at_most, larger, load, smaller, splat, store
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


class Work(NamedTuple):
    """What a tile needs: its pixels row by row, `LANES` columns, with its border.

    ``bases``: the guesses; ``warped`` (OFFSETS, ...): right pixels at each offset from them;
    ``sums``: sums over the rows of windows, of levels and squares of the left image, then of
    levels, squares and products at each offset; ``scores`` (OFFSETS, ...); ``found`` and ``best``:
    the best disparity and its score; ``tried``: 1 where the guesses are tried, else 0.
    """

    bases: Array
    warped: Array
    sums: Array
    scores: Array
    found: Array
    best: Array
    tried: Array


@inline_kernel
def _new_work() -> Work:
    size, spare = TILE_ROWS * LANES, 2 * LANES
    whole = size + 2 * RADIUS * LANES + spare
    kind = np.float32
    return Work(
        np.zeros(whole, kind),
        np.zeros((OFFSETS, whole), kind),
        np.zeros((2 + 3 * OFFSETS, size + spare), kind),
        np.zeros((OFFSETS, size), kind),
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
    height, width = pair.left.shape[0] - 2 * RADIUS, pair.left.shape[1] - 2 * RADIUS - LANES
    last = width + 2 * MARGIN - OFFSETS
    bases, warped = work.bases, work.warped
    for j in range(TILE_ROWS + 2 * RADIUS):
        if not wanted[max(j - 2 * RADIUS, 0) : j + 1].any():
            continue
        row = min(max(top + j - RADIUS, 0), height - 1)
        guesses, right = pair.guesses[surface, row >> 1], pair.right[row + RADIUS]
        at = j * LANES
        for i in range(LANES):
            column = min(max(x + i - RADIUS, 0), width - 1)
            guess = guesses[column >> 1]
            bases[at + i] = guess
            first = min(max(column - guess - BAND + MARGIN, 0), last)
            for k in range(OFFSETS):
                warped[k, at + i] = right[first + OFFSETS - 1 - k]


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
                level = load(warped[k], (j + m) * LANES)
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
def _score(pair: GuidedPair, wanted: Array, work: Work) -> None:
    """Score the windows of a tile's wanted rows.

    Scores are the square of the NCC with its sign: they have the same maximum, without a root.
    """
    count, zero = splat(np.float32(SIDE * SIDE)), splat(np.float32(0))
    no_score, least = splat(NO_SCORE), splat(np.float32(pair.least_energy))
    least_product = splat(np.float32(1e-12))
    sums, scores = work.sums, work.scores
    for j in range(TILE_ROWS):
        if not wanted[j]:
            continue
        at = j * LANES
        sum_l = _window_sum(sums[0], at)
        energy_l = _window_sum(sums[1], at) * count - sum_l * sum_l
        for k in range(OFFSETS):
            sum_r = _window_sum(sums[3 * k + 2], at)
            energy_r = _window_sum(sums[3 * k + 3], at) * count - sum_r * sum_r
            covariance = _window_sum(sums[3 * k + 4], at) * count - sum_l * sum_r
            energies = larger(energy_l * energy_r, least_product)
            score = covariance * larger(covariance, zero - covariance) / energies
            score = at_most(least, energy_l, score, no_score)
            store(scores[k], at, at_most(least, energy_r, score, no_score))


@inline_kernel
def _mean_guess(bases: Array, at: int) -> Any:
    """Return the mean guess of the window around each pixel, of those on the same surface.

    An offset is that of the window, not of its middle pixel, whose guess is rounded.
    """
    zero, one, pixels = splat(np.float32(0)), splat(np.float32(1)), splat(np.float32(SIDE * SIDE))
    middle = load(bases, at + RADIUS * LANES + RADIUS)
    total = zero
    for j in range(SIDE):
        for i in range(SIDE):
            step = load(bases, at + j * LANES + i) - middle
            total = total + at_most(larger(step, zero - step), one, step, zero)
    return middle + total / pixels


@inline_kernel
def _keep_best(wanted: Array, work: Work) -> None:
    """Keep the best disparity of each pixel of a tile, at the maximum of a parabola."""
    zero, one, half = splat(np.float32(0)), splat(np.float32(1)), splat(np.float32(0.5))
    scored, flat = splat(np.float32(-1)), splat(np.float32(1e-6))
    no_score = splat(NO_SCORE)
    scores, found, best = work.scores, work.found, work.best
    for j in range(TILE_ROWS):
        if not wanted[j]:
            continue
        at = j * LANES
        base = _mean_guess(work.bases, at)
        highest, value, tried = load(best, at), load(found, at), load(work.tried, at)
        for k in range(OFFSETS):
            score = load(scores[k], at)
            offset = zero
            if 0 < k < OFFSETS - 1:
                before, after = load(scores[k - 1], at), load(scores[k + 1], at)
                curvature = score + score - before - after
                offset = half * (after - before) / larger(curvature, flat)
                offset = at_most(curvature, zero, zero, offset)
                offset = at_most(scored, before, at_most(scored, after, offset, zero), zero)
                offset = larger(smaller(offset, one), zero - one)
            score = at_most(one, tried, score, no_score)
            value = at_most(score, highest, value, base + splat(np.float32(k - BAND)) + offset)
            highest = larger(highest, score)
        store(best, at, highest)
        store(found, at, value)


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
    pair: GuidedPair, images: tuple[Array, Array, Array], clear: float, start: int, stop: int
) -> None:
    """Write the best disparities of rows ``start`` to ``stop`` around their guesses.

    ``images``: the guess of each pixel of half resolution, in its pixels, NaN = none; where it is
    doubtful, bool; and the result (H, W), NaN = none. Without a score a pixel keeps its guess; a
    doubtful one needs a score above ``clear``.
    """
    guesses, doubtful, disparity = images
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
                _score(pair, wanted, work)
                _keep_best(wanted, work)
            for j in range(rows):
                own, unsure = guesses[(top + j) >> 1], doubtful[(top + j) >> 1]
                out = disparity[top + j]
                for i in range(min(INNER, width - x)):
                    half, score = (x + i) >> 1, best[j * LANES + i]
                    value = found[j * LANES + i] if score > NO_SCORE else own[half] + own[half]
                    kept = (score > limit) | (unsure[half] == 0)
                    out[x + i] = value if kept else none


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
