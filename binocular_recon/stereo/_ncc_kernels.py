# SPDX-License-Identifier: Apache-2.0
"""Kernels of zero-mean normalised cross-correlation (eq. 10) and winner takes all.

Layout: the right picture is mirrored and shifted such that ``right[y, W - 1 - x + k]`` is what the
k-th disparity pairs with left pixel x. So the disparities of a pixel lie side by side, and loops
over k run on vector units.

Exactness: pictures hold centred integers, so sums of products are exact and do not depend on
where they started; neither strips nor crops change a score.

LLVM vectorises the inner loops because each writes one array only, indexes from 0 without
conditions, and takes its maximum of integers: a score and its place share one integer, the key.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from binocular_recon._jit import kernel

Array = npt.NDArray[Any]

NO_SCORE = np.float32(-1.75)  # below every score, above what overflows a key
PLACE_BITS = 12
PLACES = 2**PLACE_BITS
SCORE_STEPS = np.float32(2.0**18)  # per unit of score; -1.75..1 fits the key's upper 20 bits
NO_KEY = np.int32(-(2**31))
TILE = 32  # columns whose scores stay in the first-level cache


class Pair(NamedTuple):
    """Both pictures as the kernels need them; `prepare` in matching.py makes it.

    ``left`` (H + 1, W) and ``right`` (H + 1, W + D - 1) hold centred integers as float32 or
    float64, 0 where there is no data; their last row is 0 and stands for "no row".
    ``left_bad`` and ``right_bad`` are 1 where there is no data.
    """

    left: Array
    right: Array
    left_bad: Array
    right_bad: Array
    size: int
    least_energy: float


class Statistics(NamedTuple):
    """Sums over windows of each picture, row by row.

    ``left_sums``, ``right_sums`` (3, size + N): values, squares and pixels without data, summed
    over the window's rows; the first ``size`` columns are 0. ``left_norm`` (2, N), ``right_norm``
    (4, N), per window by its first column: sum, 1 / norm (0 = no score); mean's integer part,
    mean's rest, 1 / norm, `NO_SCORE` or 0.
    """

    left_sums: Array
    right_sums: Array
    left_norm: Array
    right_norm: Array


class Products(NamedTuple):
    """Sums of products.

    ``columns`` (size + W, D) are over a window's rows, the first ``size`` 0; ``window`` (D) is
    over the whole window.
    """

    columns: Array
    window: Array


@kernel
def new_statistics(pair: Pair) -> Statistics:
    """Return the sums before the first row."""
    width, padded, size = pair.left.shape[1], pair.right.shape[1], pair.size
    return Statistics(
        np.zeros((3, size + width)),
        np.zeros((3, size + padded)),
        np.zeros((2, width), pair.left.dtype),
        np.zeros((4, padded), pair.left.dtype),
    )


@kernel
def new_products(pair: Pair) -> Products:
    """Return the sums of products before the first row."""
    width, size = pair.left.shape[1], pair.size
    disparities = pair.right.shape[1] - width + 1
    return Products(
        np.zeros((size + width, disparities), pair.left.dtype),
        np.zeros(disparities, pair.left.dtype),
    )


@kernel
def _slide(sums: Array, size: int, new: Array, old: Array, new_bad: Array, old_bad: Array) -> None:
    """Move column sums down by a row."""
    values, squares, bad = sums[0, size:], sums[1, size:], sums[2, size:]
    for i in range(new.size):
        values[i] += new[i] - old[i]
    for i in range(new.size):
        squares[i] += np.float64(new[i]) * new[i] - np.float64(old[i]) * old[i]
    for i in range(new.size):
        bad[i] += np.float64(new_bad[i]) - old_bad[i]


@kernel
def enter_row(pair: Pair, statistics: Statistics, new: int, old: int) -> None:
    """Move the windows down: row ``new`` enters, row ``old`` leaves."""
    size = pair.size
    _slide(
        statistics.left_sums,
        size,
        pair.left[new],
        pair.left[old],
        pair.left_bad[new],
        pair.left_bad[old],
    )
    _slide(
        statistics.right_sums,
        size,
        pair.right[new],
        pair.right[old],
        pair.right_bad[new],
        pair.right_bad[old],
    )


@kernel
def _window_energy(sums: Array, size: int, least: float, total: Array, inverse: Array) -> None:
    """Give the sum and 1 / norm of the window that starts at each column; 0 = no score."""
    count = size * size
    windows = sums.shape[1] - 2 * size + 1
    values, squares, bad = np.zeros(windows), np.zeros(windows), np.zeros(windows)
    for j in range(size):
        for i in range(windows):
            values[i] += sums[0, size + i + j]
        for i in range(windows):
            squares[i] += sums[1, size + i + j]
        for i in range(windows):
            bad[i] += sums[2, size + i + j]
    for i in range(windows):
        total[i] = values[i]
    for i in range(windows):
        # count times the energy is a difference of integers: exact, 0 where the window is flat
        energy = count * squares[i] - values[i] * values[i]
        scored = bad[i] == 0 and energy > 0 and energy >= least * count
        inverse[i] = size / np.sqrt(energy) if scored else 0.0


@kernel
def normalise_row(pair: Pair, statistics: Statistics) -> None:
    """Fill both norms from the column sums."""
    size, count = pair.size, pair.size * pair.size
    left, right = statistics.left_norm, statistics.right_norm
    _window_energy(statistics.left_sums, size, pair.least_energy, left[0], left[1])
    _window_energy(statistics.right_sums, size, pair.least_energy, right[0], right[2])
    for i in range(right.shape[1]):
        total = right[0, i]
        whole = np.rint(total / count)
        right[0, i] = whole
        right[1, i] = (total - whole * count) / count
        right[3, i] = 0 if right[2, i] > 0 else NO_SCORE


@kernel
def add_products(
    pair: Pair, products: Products, new: int, old: int, start: int, stop: int
) -> None:
    """Move the column sums of products of columns ``start`` to ``stop`` down by a row."""
    last = pair.left.shape[1] - 1
    disparities = products.window.size
    left_new, left_old = pair.left[new], pair.left[old]
    right_new, right_old = pair.right[new], pair.right[old]
    for x in range(start, stop):
        sums = products.columns[pair.size + x]
        a, b = left_new[x], left_old[x]
        entering = right_new[last - x : last - x + disparities]
        leaving = right_old[last - x : last - x + disparities]
        for k in range(disparities):
            sums[k] += a * entering[k] - b * leaving[k]


@kernel
def score_windows(
    pair: Pair, statistics: Statistics, products: Products, start: int, stop: int, scores: Array
) -> None:
    """Write the scores of the windows that end at columns ``start`` to ``stop`` to ``scores``.

    Must be called for all columns in turn, the first with ``products.window`` zero.
    ``scores`` (stop - start, D) holds `NO_SCORE` where there is none.
    """
    size, last = pair.size, pair.left.shape[1] - 1
    window = products.window
    disparities = window.size
    for x in range(start, stop):
        entering, leaving = products.columns[size + x], products.columns[x]
        for k in range(disparities):
            window[k] += entering[k] - leaving[k]
        row = scores[x - start]
        first = x - size + 1
        if first < 0 or statistics.left_norm[1, first] == 0:
            row[:] = NO_SCORE
            continue
        total, inverse = statistics.left_norm[0, first], statistics.left_norm[1, first]
        here = last - x
        whole = statistics.right_norm[0, here : here + disparities]
        rest = statistics.right_norm[1, here : here + disparities]
        norm = statistics.right_norm[2, here : here + disparities]
        bias = statistics.right_norm[3, here : here + disparities]
        for k in range(disparities):
            # eq. 10; the mean in two parts: their difference from the products stays exact
            covariance = window[k] - total * whole[k] - total * rest[k]
            row[k] = covariance * inverse * norm[k] + bias[k]


@kernel
def score_strip(pair: Pair, scores: Array, start: int, stop: int) -> None:
    """Write the scores of rows ``start`` to ``stop`` to ``scores`` (H, W, D); NaN = none."""
    width, size = pair.left.shape[1], pair.size
    radius, nothing = size // 2, pair.left.shape[0] - 1
    statistics = new_statistics(pair)
    products = new_products(pair)
    row = np.empty((width, products.window.size), pair.left.dtype)
    top = max(start - radius, 0)
    for new in range(top, min(stop + radius, nothing)):
        old = new - size if new - size >= top else nothing
        enter_row(pair, statistics, new, old)
        add_products(pair, products, new, old, 0, width)
        y = new - radius
        if y < start or new - top < size - 1:
            continue
        normalise_row(pair, statistics)
        products.window[:] = 0
        score_windows(pair, statistics, products, 0, width, row)
        for x in range(radius, width - radius):
            for k in range(row.shape[1]):
                score = row[x + radius, k]
                if score != NO_SCORE:
                    scores[y, x, k] = score


class Selection(NamedTuple):
    """How winners are chosen; see `MatchConfig`."""

    min_disparity: int
    disp12_max_diff: float
    uniqueness_ratio: float
    subpixel: bool


@kernel
def pick_winners(
    scores: Array, tags: Array, keys: Array, right_keys: Array, here: int
) -> tuple[int, float]:
    """Return a pixel's best place and score, and enter its scores for the right pixels."""
    candidates = right_keys[here : here + keys.size]
    for k in range(keys.size):
        keys[k] = np.int32((np.int32(scores[k] * SCORE_STEPS) << PLACE_BITS) | tags[k])
    for k in range(keys.size):
        candidates[k] = max(candidates[k], keys[k])
    best = NO_KEY
    for k in range(keys.size):
        best = max(best, keys[k])
    place = _place(best)
    return place, scores[place]


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
    return bool((1 - second) * (100 - ratio) > (1 - scores[place]) * 100 or second == NO_SCORE)


@kernel
def _refine(scores: Array, place: int, freedom: float) -> tuple[float, float]:
    """Return the peak's offset from ``place`` and its standard deviation, px."""
    best = scores[place]
    if place == 0 or place == scores.size - 1:
        return 0.0, 1.0
    before, after = scores[place - 1], scores[place + 1]
    if before == NO_SCORE or after == NO_SCORE:
        return 0.0, 1.0
    curvature = 2 * best - before - after
    if curvature <= 0:
        return 0.0, 1.0
    offset = 0.5 * (after - before) / curvature
    noise = max(1 - best * best, np.float32(1e-6)) * max(best, np.float32(0.1)) / freedom
    return offset, np.sqrt(noise / curvature)


@kernel
def select_strip(
    pair: Pair, selection: Selection, disparity: Array, sigma: Array, start: int, stop: int
) -> None:
    """Choose the best disparity of rows ``start`` to ``stop``; NaN = none."""
    width, size = pair.left.shape[1], pair.size
    radius, nothing, last = size // 2, pair.left.shape[0] - 1, width - 1
    statistics = new_statistics(pair)
    products = new_products(pair)
    disparities = products.window.size
    tags = (PLACES - 1 - np.arange(disparities)).astype(np.int32)
    keys = np.empty(disparities, np.int32)
    right_keys = np.empty(pair.right.shape[1], np.int32)
    places = np.empty(width, np.int32)
    scores = np.empty((TILE, disparities), pair.left.dtype)
    top = max(start - radius, 0)
    for new in range(top, min(stop + radius, nothing)):
        old = new - size if new - size >= top else nothing
        enter_row(pair, statistics, new, old)
        y = new - radius
        if y < start or new - top < size - 1:
            add_products(pair, products, new, old, 0, width)
            continue
        normalise_row(pair, statistics)
        products.window[:] = 0
        right_keys[:] = NO_KEY
        places[:] = -1
        for tile in range(0, width, TILE):
            end = min(tile + TILE, width)
            add_products(pair, products, new, old, tile, end)
            score_windows(pair, statistics, products, tile, end, scores)
            for x in range(max(tile, size - 1), end):
                if statistics.left_norm[1, x - size + 1] == 0:
                    continue
                curve = scores[x - tile]
                place, best = pick_winners(curve, tags, keys, right_keys, last - x)
                if best == NO_SCORE:
                    continue
                ratio = selection.uniqueness_ratio
                if ratio > 0 and not _is_unique(curve, place, ratio):
                    continue
                offset, deviation = _refine(curve, place, size * size - 2.0)
                places[x] = place
                whole = selection.min_disparity + place
                disparity[y, x - radius] = whole + offset if selection.subpixel else whole
                sigma[y, x - radius] = deviation
        if selection.disp12_max_diff >= 0:
            for x in range(size - 1, width):
                if places[x] >= 0:
                    back = _place(right_keys[last - x + places[x]])
                    if abs(back - places[x]) > selection.disp12_max_diff:
                        disparity[y, x - radius] = np.nan
