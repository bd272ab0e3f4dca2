# SPDX-License-Identifier: Apache-2.0
"""Kernels of matching costs: the NCC of two windows as one byte, row by row.

Disparities are laid out as in `_ncc_kernels`, padded to whole vectors.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from binocular_recon._jit import Array, inline_kernel
from binocular_recon._simd import (
    LANES,
    larger,
    load,
    smaller,
    splat,
    store,
    to_int32,
    to_uint8,
)
from binocular_recon.stereo.matching._ncc_kernels import (
    PaddedPair,
    Statistics,
    enter_row,
    new_statistics,
    normalise_row,
)

WORST = np.int32(252)  # cost of score 0 or less
UNKNOWN = np.int32(160)  # cost where there is no score: that of a random match


class CostSource(NamedTuple):
    """The images and options that costs are computed from.

    ``big`` and ``small`` are the same image pair with the sizes of the two windows, extended by
    the radius of the big window. The small window counts where its energy exceeds
    ``noise_energy``, the big one elsewhere.
    """

    big: PaddedPair
    small: PaddedPair
    noise_energy: float
    disparities: int
    padded: int


class CostRows(NamedTuple):
    """State between rows: the sums of both windows, and what `_set_gains` computes from them.

    ``gains`` (2, W): factors on the covariances of a left pixel in both windows; ``limit`` (W) and
    ``highest`` (N): the largest costs of a left and of a right pixel.
    """

    big: Statistics
    small: Statistics
    gains: Array
    limit: Array
    highest: Array


@inline_kernel
def new_cost_rows(source: CostSource) -> CostRows:
    """Return the state before the first row."""
    big = source.big
    zero = big.left[big.left.shape[0] - 1, 0]
    return CostRows(
        new_statistics(big),
        new_statistics(source.small),
        np.full((2, big.left.shape[1] - big.size + 1), zero),
        np.empty(big.left.shape[1] - big.size + 1, np.int32),
        np.full(big.right.shape[1], zero),
    )


@inline_kernel
def next_cost_row(source: CostSource, rows: CostRows, y: int, first: int, costs: Array) -> Any:
    """Write the costs of row ``y`` to ``costs`` (W * padded); return which left pixels have any.

    Must be called for all rows in order, from row ``first`` on.
    """
    big, small = source.big, source.small
    inner = (big.size - small.size) // 2
    no_row = big.left.shape[0] - 1
    for new in range(y + big.size - 1 if y > first else first, y + big.size):
        old = new - big.size
        enter_row(big, rows.big, new, old if old >= first else no_row)
        old = new - inner - small.size
        if inner > 0 and new - inner >= first + inner:
            enter_row(small, rows.small, new - inner, old if old >= first + inner else no_row)
    normalise_row(big, rows.big)
    if inner > 0:
        normalise_row(small, rows.small)
    _set_gains(source, rows)
    for k in range(0, source.padded, LANES):
        if inner > 0:
            _cost_columns(source, rows, y, k, costs)
        else:
            _cost_columns_of_three(source, rows, y, k, costs)
    if source.disparities < source.padded:
        for x in range(rows.gains.shape[1]):
            at = x * source.padded
            costs[at + source.disparities : at + source.padded] = WORST
    return rows.big.left_norm[1] > 0


@inline_kernel
def _set_gains(source: CostSource, rows: CostRows) -> None:
    """Set the gains and limits of each pixel, for the inner loop."""
    inner = (source.big.size - source.small.size) // 2
    mean, fraction, norm = rows.big.right_norm[0], rows.big.right_norm[1], rows.big.right_norm[2]
    kind = mean.dtype.type
    zero, one, noise = kind(0), kind(1), kind(source.noise_energy)
    worst, unknown, half = kind(WORST), kind(UNKNOWN), kind(0.5)
    highest = rows.highest
    for i in range(norm.size):
        highest[i] = (worst if norm[i] > zero else unknown) + half
    for i in range(norm.size):
        mean[i] += fraction[i]
    mean, fraction = rows.small.right_norm[0], rows.small.right_norm[1]
    small_norm = rows.small.right_norm[2]
    for i in range(norm.size):
        mean[i] += fraction[i]
    for i in range(norm.size - inner):
        small_norm[i + inner] = small_norm[i + inner] if norm[i] > zero else zero
    gain, small_gain, limit = rows.gains[0], rows.gains[1], rows.limit
    width = gain.size
    inverse = rows.big.left_norm[1]
    small_inverse = rows.small.left_norm[1, inner : inner + width]
    for x in range(width):
        # 0 where the small window is uniform or the noise infinite
        weight = one / (one + noise * small_inverse[x] * small_inverse[x])
        share = weight if small_inverse[x] > zero else zero
        gain[x] = (one - share) * worst
        small_gain[x] = share * worst * small_inverse[x]
    for x in range(width):
        limit[x] = WORST if inverse[x] > zero else UNKNOWN
    for x in range(width):
        gain[x] *= inverse[x]
        small_gain[x] = small_gain[x] if inverse[x] > zero else zero


@inline_kernel
def _cost_columns(source: CostSource, rows: CostRows, y: int, k: int, costs: Array) -> None:
    """Write the costs of a row at `LANES` disparities, from the ``k``-th on."""
    big = source.big
    size, small_size, padded = big.size, source.small.size, source.padded
    inner = (size - small_size) // 2
    left, stride = big.left, big.right.shape[1]
    right = big.right.reshape(big.right.size)
    mean, norm = rows.big.right_norm[0], rows.big.right_norm[2]
    small_mean, small_norm = rows.small.right_norm[0], rows.small.right_norm[2]
    total, small_total = rows.big.left_norm[0], rows.small.left_norm[0]
    gain, small_gain = rows.gains[0], rows.gains[1]
    limit, highest = rows.limit, rows.highest
    zero = left[left.shape[0] - 1, 0]
    columns, small_columns = np.full(size * LANES, zero), np.full(size * LANES, zero)
    window = small_window = splat(zero)
    # indices in the ring buffers of column sums: of the newest column, of the one that enters the
    # small window and of the one that leaves it
    ring = size * LANES
    newest, enters, leaves = (
        0,
        (size - inner) * LANES % ring,
        (2 * size - inner - small_size) * LANES % ring,
    )
    for i in range(left.shape[1]):
        here = left.shape[1] - 1 - i + k
        at = y * stride + here
        inside = splat(left[y + 1, i]) * load(right, at + stride)
        for j in range(2, size - 1):
            inside = inside + splat(left[y + j, i]) * load(right, at + j * stride)
        both = inside + splat(left[y, i]) * load(right, at)
        both = both + splat(left[y + size - 1, i]) * load(right, at + (size - 1) * stride)
        window = window + both - load(columns, newest)
        store(columns, newest, both)
        small_window = small_window - load(small_columns, leaves)
        store(small_columns, newest, inside)
        small_window = small_window + load(small_columns, enters)
        newest = newest + LANES if newest + LANES < ring else 0
        enters = enters + LANES if enters + LANES < ring else 0
        leaves = leaves + LANES if leaves + LANES < ring else 0
        x = i - size + 1
        if x < 0:
            continue
        value = (window - splat(total[x]) * load(mean, here)) * load(norm, here)
        cost = load(highest, here) - value * splat(gain[x])
        value = small_window - splat(small_total[x + inner]) * load(small_mean, here + inner)
        cost = cost - value * load(small_norm, here + inner) * splat(small_gain[x])
        steps = smaller(larger(to_int32(cost), splat(np.int32(0))), splat(limit[x]))
        store(costs, x * padded + k, to_uint8(steps))


@inline_kernel
def _cost_columns_of_three(
    source: CostSource, rows: CostRows, y: int, k: int, costs: Array
) -> None:
    """Write the same costs with windows of side 3, into which no smaller one fits."""
    left, stride = source.big.left, source.big.right.shape[1]
    right = source.big.right.reshape(source.big.right.size)
    mean, norm = rows.big.right_norm[0], rows.big.right_norm[2]
    total, gain = rows.big.left_norm[0], rows.gains[0]
    limit, highest = rows.limit, rows.highest
    width, padded = left.shape[1], source.padded
    least = splat(np.int32(0))
    before = here = splat(left[left.shape[0] - 1, 0])
    for i in range(width):
        there = width - 1 - i + k
        at = y * stride + there
        column = splat(left[y, i]) * load(right, at)
        column = column + splat(left[y + 1, i]) * load(right, at + stride)
        column = column + splat(left[y + 2, i]) * load(right, at + 2 * stride)
        window = before + here + column
        before, here = here, column
        x = i - 2
        if x < 0:
            continue
        value = (window - splat(total[x]) * load(mean, there)) * load(norm, there)
        cost = load(highest, there) - value * splat(gain[x])
        steps = smaller(larger(to_int32(cost), least), splat(limit[x]))
        store(costs, x * padded + k, to_uint8(steps))
