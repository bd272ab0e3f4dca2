# SPDX-License-Identifier: Apache-2.0
"""Kernels of zero-mean normalised cross-correlation (eq. 10).

Layout: the right image is mirrored and shifted such that ``right[y, W - 1 - x + k]`` is the
partner of left pixel x at the k-th disparity. The disparities of a pixel are thus contiguous in
memory, and loops over k are vectorised.

Exactness: the images hold integers around zero, so that sums of products are exact and do not
depend on where they were started. Scores therefore depend neither on strips nor on crops.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from binocular_recon._jit import Array, exact_kernel, inline_kernel, kernel
from binocular_recon._simd import LANES, load, splat, store

NO_SCORE = np.float32(-1.75)  # below every score, above what overflows a key


class PaddedPair(NamedTuple):
    """Both images as the kernels need them; `prepare_pair` makes it.

    ``left`` (H + 1, W) and ``right`` (H + 1, W + D - 1) hold integers around zero as float32 or
    float64, 0 where there is no data; their last row, all 0, stands for "no row".
    ``left_missing`` and ``right_missing`` are 1 where there is no data. A window is scored if its
    energy, the sum of squared differences from its mean, reaches ``least_energy``.
    """

    left: Array
    right: Array
    left_missing: Array
    right_missing: Array
    size: int
    least_energy: tuple[float, float]


class Statistics(NamedTuple):
    """Sums over the windows of each image, row by row.

    ``left_sums``, ``right_sums`` (3, N + size + LANES): values, squares and pixels without data,
    summed over the rows of the window. ``left_norm`` (2, N), by first column of the window: sum
    and 1 / norm (0 = no score). ``right_norm`` (4, N): integer part of the mean, its fraction,
    1 / norm, and `NO_SCORE` or 0.
    """

    left_sums: Array
    right_sums: Array
    left_norm: Array
    right_norm: Array


class Products(NamedTuple):
    """Sums of products of left and right pixels.

    ``columns`` ((size + W) * padded) over the rows of a window, the first ``size`` columns 0;
    ``window`` (padded) over the whole window.
    """

    columns: Array
    window: Array
    padded: int


@inline_kernel
def new_statistics(pair: PaddedPair) -> Statistics:
    """Return the sums before the first row."""
    width, right_width = pair.left.shape[1], pair.right.shape[1]
    margin = pair.size + LANES
    return Statistics(
        np.zeros((3, width + margin), pair.left.dtype),
        np.zeros((3, right_width + margin), pair.left.dtype),
        np.zeros((2, width), pair.left.dtype),
        np.zeros((4, right_width), pair.left.dtype),
    )


@inline_kernel
def new_products(pair: PaddedPair) -> Products:
    """Return the sums of products before the first row."""
    width = pair.left.shape[1]
    padded = pair.right.shape[1] - width + 1
    zero = pair.left[pair.left.shape[0] - 1, 0]
    return Products(np.full((pair.size + width) * padded, zero), np.full(padded, zero), padded)


@inline_kernel
def _slide(sums: Array, new: Array, old: Array, new_missing: Array, old_missing: Array) -> None:
    """Move column sums down by a row."""
    values, squares, missing = sums[0], sums[1], sums[2]
    for i in range(new.size):
        values[i] += new[i] - old[i]
    for i in range(new.size):
        squares[i] += new[i] * new[i] - old[i] * old[i]
    for i in range(new.size):
        missing[i] += np.float32(new_missing[i]) - np.float32(old_missing[i])


@inline_kernel
def enter_row(pair: PaddedPair, statistics: Statistics, new: int, old: int) -> None:
    """Move the windows down: row ``new`` enters, row ``old`` leaves."""
    _slide(
        statistics.left_sums,
        pair.left[new],
        pair.left[old],
        pair.left_missing[new],
        pair.left_missing[old],
    )
    _slide(
        statistics.right_sums,
        pair.right[new],
        pair.right[old],
        pair.right_missing[new],
        pair.right_missing[old],
    )


@exact_kernel
def _window_energy(sums: Array, size: int, least: float, total: Array, inverse: Array) -> None:
    """Write the sum and 1 / norm of the window that starts at each column; 0 = no score."""
    count = size * size
    values, squares, missing = sums[0], sums[1], sums[2]
    windows = total.size - size + 1
    side, zero = values.dtype.type(size), values.dtype.type(0)
    sum_of = np.empty((3, total.size + LANES), sums.dtype)
    value, square, no_data = sum_of[0], sum_of[1], sum_of[2]
    for i in range(0, windows, LANES):
        a, b, c = load(values, i), load(squares, i), load(missing, i)
        for j in range(1, size):
            a, b = a + load(values, i + j), b + load(squares, i + j)
            c = c + load(missing, i + j)
        store(value, i, a)
        store(square, i, b)
        store(no_data, i, c)
    for i in range(windows):
        total[i] = value[i]
    for i in range(windows):
        # count * energy is a difference of integers: exact, and 0 in a uniform window
        energy = np.float64(count) * square[i] - np.float64(value[i]) * np.float64(value[i])
        scored = no_data[i] == 0 and energy > 0 and energy >= least * count
        # the arrays are used again: for the energies, and for whether a window is scored
        square[i], no_data[i] = energy, scored
    for i in range(windows):
        inverse[i] = side / np.sqrt(square[i]) if no_data[i] != 0 else zero


@exact_kernel
def normalise_row(pair: PaddedPair, statistics: Statistics) -> None:
    """Set the norms of both images from the column sums."""
    size = pair.size
    left, right = statistics.left_norm, statistics.right_norm
    _window_energy(statistics.left_sums, size, pair.least_energy[0], left[0], left[1])
    _window_energy(statistics.right_sums, size, pair.least_energy[1], right[0], right[2])
    total, fraction, norm, bias = right[0], right[1], right[2], right[3]
    pixels, no_score = total.dtype.type(size * size), total.dtype.type(NO_SCORE)
    half, zero = total.dtype.type(0.5), total.dtype.type(0)
    per_pixel = total.dtype.type(1) / pixels
    for i in range(total.size):
        whole = np.floor(total[i] * per_pixel + half)
        fraction[i] = (total[i] - whole * pixels) * per_pixel
        total[i] = whole
    for i in range(total.size):
        bias[i] = zero if norm[i] > 0 else no_score


@inline_kernel
def score_columns(
    pair: PaddedPair,
    statistics: Statistics,
    products: Products,
    rows: tuple[int, int],
    start: int,
    stop: int,
    scores: Array,
) -> None:
    """Score the windows whose last row is ``rows[0]`` and last column in ``start`` to ``stop``.

    First moves the sums of these columns down: row ``rows[0]`` enters, row ``rows[1]`` leaves.
    Then writes the scores to ``scores`` ((stop - start) * padded), `NO_SCORE` where there is none;
    nothing if ``scores`` is empty. Must be called for all columns in order, for the first with
    ``products.window`` zero.
    """
    size, last, padded = pair.size, pair.left.shape[1] - 1, products.padded
    columns, window = products.columns, products.window
    left_new, left_old = pair.left[rows[0]], pair.left[rows[1]]
    right_new, right_old = pair.right[rows[0]], pair.right[rows[1]]
    whole, fraction = statistics.right_norm[0], statistics.right_norm[1]
    norm, bias = statistics.right_norm[2], statistics.right_norm[3]
    for x in range(start, stop):
        here, at = last - x, (size + x) * padded
        entering, leaving = splat(left_new[x]), splat(left_old[x])
        for k in range(0, padded, LANES):
            column = load(columns, at + k) + entering * load(right_new, here + k)
            column = column - leaving * load(right_old, here + k)
            store(columns, at + k, column)
        if scores.size == 0:
            continue
        first = max(x - size + 1, 0)
        total, inverse = (
            splat(statistics.left_norm[0, first]),
            splat(statistics.left_norm[1, first]),
        )
        for k in range(0, padded, LANES):
            product = load(window, k) + load(columns, at + k) - load(columns, x * padded + k)
            store(window, k, product)
            # eq. 10; the mean in two parts, so that subtracting the integer part is exact
            covariance = product - total * load(whole, here + k) - total * load(fraction, here + k)
            score = covariance * inverse * load(norm, here + k) + load(bias, here + k)
            store(scores, (x - start) * padded + k, score)


@kernel
def score_strip(pair: PaddedPair, scores: Array, start: int, stop: int) -> None:
    """Write the scores of rows ``start`` to ``stop`` to ``scores`` (H, W, D); NaN = none."""
    width, size = pair.left.shape[1], pair.size
    radius, no_row = size // 2, pair.left.shape[0] - 1
    statistics, products = new_statistics(pair), new_products(pair)
    row = np.empty(width * products.padded, pair.left.dtype)
    top = max(start - radius, 0)
    for new in range(top, min(stop + radius, no_row)):
        old = new - size if new - size >= top else no_row
        enter_row(pair, statistics, new, old)
        y = new - radius
        ready = y >= start and new - top >= size - 1
        if ready:
            normalise_row(pair, statistics)
            products.window[:] = 0
        score_columns(pair, statistics, products, (new, old), 0, width, row if ready else row[:0])
        for x in range(radius if ready else width, width - radius):
            if statistics.left_norm[1, x - radius] > 0:
                for k in range(scores.shape[2]):
                    score = row[(x + radius) * products.padded + k]
                    if score != NO_SCORE:
                        scores[y, x, k] = score
