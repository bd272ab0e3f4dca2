# SPDX-License-Identifier: Apache-2.0
"""Kernels of winner-takes-all selection: the best NCC score of each pixel, and its checks.

A score and the index of its disparity share one integer, the key, so that one maximum finds both.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from binocular_recon._jit import Array, exact_kernel, inline_kernel, kernel
from binocular_recon._simd import LANES, larger, largest, load, shift_left, splat, store, to_int32
from binocular_recon.stereo import _validity_kernels as reason
from binocular_recon.stereo.matching._ncc_kernels import (
    NO_SCORE,
    PaddedPair,
    enter_row,
    new_products,
    new_statistics,
    normalise_row,
    score_columns,
)

INDEX_BITS = 12
MOST_INDICES = 2**INDEX_BITS
SCORE_STEPS = np.float32(2.0**18)  # per unit of score; -1.75..1 fits the upper 20 bits of the key
NO_KEY = np.int32(-(2**31))
TILE = 32  # columns whose scores stay in the first-level cache
# Least lead of the best score over the second, per percent of the uniqueness ratio.
LEAST_LEAD = np.float32(0.002)


class Selection(NamedTuple):
    """How disparities are chosen; see `MatchConfig`.

    ``ends``: whether the first and the last disparity are matches.
    """

    disparities: int
    min_disparity: int
    disp12_max_diff: float
    uniqueness_ratio: float
    subpixel: bool
    ends: bool


@inline_kernel
def _find_best(
    scores: Array, tags: Array, right_keys: Array, last: int, start: int, stop: int, keys: Array
) -> None:
    """Find the best key of each left pixel in ``start`` to ``stop``; update the right pixels'."""
    padded = tags.size
    steps = splat(np.full(1, SCORE_STEPS, scores.dtype)[0])
    for x in range(start, stop):
        here = last - x
        best = splat(NO_KEY)
        for k in range(0, padded, LANES):
            score = to_int32(load(scores, (x - start) * padded + k) * steps)
            key = shift_left(score, INDEX_BITS) + load(tags, k)
            best = larger(best, key)
            store(right_keys, here + k, larger(key, load(right_keys, here + k)))
        keys[x] = largest(best)


@inline_kernel
def _index(key: Any) -> Any:
    """Return the index in a key; it is stored so that of equal scores the smaller index wins."""
    return MOST_INDICES - 1 - (key & (MOST_INDICES - 1))


@inline_kernel
def _is_unique(scores: Array, index: int, ratio: float) -> bool:
    """Return whether the best 1 - score beats all but its neighbours' by ``ratio`` percent."""
    second = NO_SCORE
    for k in range(scores.size):
        if abs(k - index) > 1:
            second = max(second, scores[k])
    if second == NO_SCORE:
        return True
    best = scores[index]
    beaten = (1 - second) * (100 - ratio) > (1 - best) * 100
    return bool(beaten and best - second > LEAST_LEAD * ratio)


@inline_kernel
def _check(scores: Array, index: int, selection: Selection) -> Any:
    """Return `MEASURED`, or the reason why the best score of a pixel is not a match."""
    checked, ratio = selection.disp12_max_diff >= 0, selection.uniqueness_ratio
    if checked and scores[index] <= 0:
        return reason.CONFLICT
    at_end = index == 0 or index == selection.disparities - 1
    if checked and at_end and not selection.ends:
        return reason.AT_LIMIT
    if ratio > 0 and not _is_unique(scores, index, ratio):
        return reason.AMBIGUOUS
    return reason.MEASURED


@exact_kernel
def _offset(scores: Array, index: int) -> Any:
    """Return the offset of the maximum from ``index``, on the parabola through three scores."""
    if index == 0 or index == scores.size - 1:
        return 0.0
    before, best, after = scores[index - 1], scores[index], scores[index + 1]
    curvature = 2 * best - before - after
    if before == NO_SCORE or after == NO_SCORE or curvature <= 0:
        return 0.0
    return 0.5 * (after - before) / curvature


@kernel
def select_strip(
    pair: PaddedPair,
    selection: Selection,
    results: tuple[Array, Array],
    start: int,
    stop: int,
) -> None:
    """Write the best disparities of rows ``start`` to ``stop`` that pass all checks.

    ``results`` (H, W): disparities, and `MEASURED` or the reason why there is none, both unchanged
    where there is no score.
    """
    disparity, validity = results
    width, size = pair.left.shape[1], pair.size
    radius, no_row, last = size // 2, pair.left.shape[0] - 1, width - 1
    statistics, products = new_statistics(pair), new_products(pair)
    padded = products.padded
    tags = (MOST_INDICES - 1 - np.arange(padded)).astype(np.int32)
    right_keys = np.empty(pair.right.shape[1] + LANES, np.int32)
    keys = np.empty(width, np.int32)
    indices = np.empty(width, np.int64)
    scores = np.empty(TILE * padded, pair.left.dtype)
    top = max(start - radius, 0)
    for new in range(top, min(stop + radius, no_row)):
        rows = (new, new - size if new - size >= top else no_row)
        enter_row(pair, statistics, *rows)
        y = new - radius
        if y < start or new - top < size - 1:
            score_columns(pair, statistics, products, rows, 0, width, scores[:0])
            continue
        normalise_row(pair, statistics)
        products.window[:] = 0
        right_keys[:] = NO_KEY
        for tile in range(0, width, TILE):
            end = min(tile + TILE, width)
            score_columns(pair, statistics, products, rows, tile, end, scores)
            _mask_unscored(scores, statistics.left_norm[1], size, tile, end, selection, padded)
            _find_best(scores, tags, right_keys, last, tile, end, keys)
            for x in range(max(tile, size - 1), end):
                curve = scores[(x - tile) * padded : (x - tile) * padded + selection.disparities]
                indices[x] = _index(keys[x])
                best = curve[indices[x]]
                verdict = _check(curve, indices[x], selection)
                if best != NO_SCORE:
                    validity[y, x - radius] = verdict
                if best == NO_SCORE or verdict != reason.MEASURED:
                    indices[x] = -1
                    continue
                offset = _offset(curve, indices[x]) if selection.subpixel else 0.0
                disparity[y, x - radius] = selection.min_disparity + indices[x] + offset
        if selection.disp12_max_diff >= 0:
            for x in range(size - 1, width):
                if indices[x] >= 0:
                    back = _index(right_keys[last - x + indices[x]])
                    if abs(back - indices[x]) > selection.disp12_max_diff:
                        disparity[y, x - radius] = np.nan
                        validity[y, x - radius] = reason.CONFLICT


@inline_kernel
def _mask_unscored(
    scores: Array, norm: Array, size: int, start: int, stop: int, selection: Selection, padded: int
) -> None:
    """Write `NO_SCORE` for pixels without texture and for disparities that are not searched."""
    for x in range(start, stop):
        row = (x - start) * padded
        if x < size - 1 or norm[x - size + 1] == 0:
            scores[row : row + padded] = NO_SCORE
        else:
            scores[row + selection.disparities : row + padded] = NO_SCORE
