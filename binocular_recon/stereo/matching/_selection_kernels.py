# SPDX-License-Identifier: Apache-2.0
"""Kernels of winner-takes-all selection: the best NCC score of each pixel and its checks."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from binocular_recon._jit import Array, kernel
from binocular_recon._simd import LANES, larger, largest, load, shift_left, splat, store, to_int32
from binocular_recon.stereo._validity_kernels import (
    AMBIGUOUS,
    AT_LIMIT,
    CONFLICT,
    MEASURED,
)
from binocular_recon.stereo.matching._ncc_kernels import (
    NO_SCORE,
    PaddedPair,
    enter_row,
    new_products,
    new_statistics,
    normalise_row,
    score_columns,
)

PLACE_BITS = 12
PLACES = 2**PLACE_BITS
SCORE_STEPS = np.float32(2.0**18)  # per unit of score; -1.75..1 fits the key's upper 20 bits
NO_KEY = np.int32(-(2**31))
TILE = 32  # columns whose scores stay in the first-level cache
# Least lead of the best score over the second, per percent of the ratio asked for.
LEAST_LEAD = np.float32(0.002)


class Selection(NamedTuple):
    """How winners are chosen; see `MatchConfig`."""

    disparities: int
    min_disparity: int
    disp12_max_diff: float
    uniqueness_ratio: float
    subpixel: bool


@kernel
def _pick_columns(
    scores: Array, tags: Array, right_keys: Array, last: int, start: int, stop: int, keys: Array
) -> None:
    """Find the best key of columns ``start`` to ``stop``; enter all for the right pixels."""
    padded = tags.size
    steps = splat(np.full(1, SCORE_STEPS, scores.dtype)[0])
    for x in range(start, stop):
        here = last - x
        best = splat(NO_KEY)
        for k in range(0, padded, LANES):
            score = to_int32(load(scores, (x - start) * padded + k) * steps)
            key = shift_left(score, PLACE_BITS) + load(tags, k)
            best = larger(best, key)
            store(right_keys, here + k, larger(key, load(right_keys, here + k)))
        keys[x] = largest(best)


@kernel
def _place(key: Any) -> Any:
    """Return the place that a key holds; of equal scores the smaller place wins."""
    return PLACES - 1 - (key & (PLACES - 1))


@kernel
def _is_unique(scores: Array, place: int, ratio: float) -> bool:
    """Whether the best 1 - score beats all but its neighbours' by ``ratio`` percent."""
    second = NO_SCORE
    for k in range(scores.size):
        if abs(k - place) > 1:
            second = max(second, scores[k])
    if second == NO_SCORE:
        return True
    best = scores[place]
    beaten = (1 - second) * (100 - ratio) > (1 - best) * 100
    return bool(beaten and best - second > LEAST_LEAD * ratio)


@kernel
def _verdict(scores: Array, place: int, selection: Selection) -> Any:
    """Return `MEASURED`, or why the best score of a pixel is no match."""
    checked, ratio = selection.disp12_max_diff >= 0, selection.uniqueness_ratio
    if checked and scores[place] <= 0:
        return CONFLICT
    if checked and (place == 0 or place == selection.disparities - 1):
        return AT_LIMIT
    if ratio > 0 and not _is_unique(scores, place, ratio):
        return AMBIGUOUS
    return MEASURED


@kernel
def _offset(scores: Array, place: int) -> Any:
    """Return the maximum's offset from ``place``, px, on the parabola through three scores."""
    if place == 0 or place == scores.size - 1:
        return 0.0
    before, best, after = scores[place - 1], scores[place], scores[place + 1]
    curvature = 2 * best - before - after
    if before == NO_SCORE or after == NO_SCORE or curvature <= 0:
        return 0.0
    return 0.5 * (after - before) / curvature


@kernel
def select_strip(
    pair: PaddedPair,
    selection: Selection,
    disparity: Array,
    validity: Array,
    start: int,
    stop: int,
) -> None:
    """Choose the best disparity of rows ``start`` to ``stop``; NaN = none.

    ``validity`` gets the reason, and stays where there is no score.
    """
    width, size = pair.left.shape[1], pair.size
    radius, nothing, last = size // 2, pair.left.shape[0] - 1, width - 1
    statistics, products = new_statistics(pair), new_products(pair)
    padded = products.padded
    tags = (PLACES - 1 - np.arange(padded)).astype(np.int32)
    right_keys = np.empty(pair.right.shape[1] + LANES, np.int32)
    keys = np.empty(width, np.int32)
    places = np.empty(width, np.int64)
    scores = np.empty(TILE * padded, pair.left.dtype)
    top = max(start - radius, 0)
    for new in range(top, min(stop + radius, nothing)):
        rows = (new, new - size if new - size >= top else nothing)
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
            _cover(scores, statistics.left_norm[1], size, tile, end, selection, padded)
            _pick_columns(scores, tags, right_keys, last, tile, end, keys)
            for x in range(max(tile, size - 1), end):
                curve = scores[(x - tile) * padded : (x - tile) * padded + selection.disparities]
                places[x] = _place(keys[x])
                best = curve[places[x]]
                reason = _verdict(curve, places[x], selection)
                if best != NO_SCORE:
                    validity[y, x - radius] = reason
                if best == NO_SCORE or reason != MEASURED:
                    places[x] = -1
                    continue
                offset = _offset(curve, places[x]) if selection.subpixel else 0.0
                disparity[y, x - radius] = selection.min_disparity + places[x] + offset
        if selection.disp12_max_diff >= 0:
            for x in range(size - 1, width):
                if places[x] >= 0:
                    back = _place(right_keys[last - x + places[x]])
                    if abs(back - places[x]) > selection.disp12_max_diff:
                        disparity[y, x - radius] = np.nan
                        validity[y, x - radius] = CONFLICT


@kernel
def _cover(
    scores: Array, norm: Array, size: int, start: int, stop: int, selection: Selection, padded: int
) -> None:
    """Set what is no score to `NO_SCORE`: pixels without texture, disparities not searched."""
    for x in range(start, stop):
        row = (x - start) * padded
        if x < size - 1 or norm[x - size + 1] == 0:
            scores[row : row + padded] = NO_SCORE
        else:
            scores[row + selection.disparities : row + padded] = NO_SCORE
