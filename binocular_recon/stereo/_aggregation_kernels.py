# SPDX-License-Identifier: Apache-2.0
"""Kernels of semi-global aggregation of NCC costs along four paths (Hirschmueller 2008).

A cost is one byte, 0 (score 1) to `WORST` (score 0 or less); paths add a quarter of it, so that
their sums fit a byte too. Two sweeps, from the top and from
the bottom, carry two paths each, along the columns and along the rows. They meet in the middle:
each stores half its sums, in a byte, for one half of the picture only, and in the other half adds
what its opposite stored. All sums are integers.

The layout of disparities is that of `_ncc_kernels`, padded to whole vectors.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from binocular_recon._jit import kernel
from binocular_recon._simd import (
    LANES,
    add_saturated,
    larger,
    load,
    shift_left,
    shift_right,
    smaller,
    smallest,
    splat,
    store,
    to_int32,
    to_uint8,
    to_uint16,
)
from binocular_recon.stereo._ncc_kernels import (
    Pair,
    Statistics,
    enter_row,
    new_statistics,
    normalise_row,
)

Array = npt.NDArray[Any]

WORST = np.int32(252)
UNKNOWN = np.uint8(160)  # cost of what cannot be seen: that of a random match
QUARTER = 2  # bits; with P2 up to 192, the sum along a path fits a byte
SENTINEL = 255
NO_SUM = 2**15  # above every sum
PLACE_BITS = 12


class Volume(NamedTuple):
    """Costs (H * W * padded) of one pair and which left pixels have any (H, W)."""

    costs: Array
    scored: Array
    padded: int
    disparities: int


class Columns(NamedTuple):
    """Products of the last columns summed over rows (size * padded), and over windows (padded)."""

    big: Array
    small: Array
    big_window: Array
    small_window: Array


@kernel
def cost_strip(
    big: Pair, small: Pair, noise_energy: float, volume: Volume, start: int, stop: int
) -> None:
    """Fill the costs of rows ``start`` to ``stop``.

    The pictures have a border of the big window's radius. The small window counts where its
    texture exceeds the noise, the big one where it does not.
    """
    size = big.size
    inner = (size - small.size) // 2
    nothing = big.left.shape[0] - 1
    statistics, small_statistics = new_statistics(big), new_statistics(small)
    zero = big.left[nothing, 0]
    columns = Columns(
        np.full(size * volume.padded, zero),
        np.full(size * volume.padded, zero),
        np.full(volume.padded, zero),
        np.full(volume.padded, zero),
    )
    for new in range(start, stop + size - 1):
        enter_row(big, statistics, new, new - size if new - size >= start else nothing)
        new_small = new - inner
        if new_small >= start + inner:
            old = new_small - small.size
            enter_row(small, small_statistics, new_small, old if old >= start + inner else nothing)
        y = new - size + 1
        if y >= start:
            normalise_row(big, statistics)
            normalise_row(small, small_statistics)
            _cost_row(big, small, statistics, small_statistics, noise_energy, columns, volume, y)


@kernel
def _cost_row(
    big: Pair,
    small: Pair,
    statistics: Statistics,
    small_statistics: Statistics,
    noise_energy: float,
    columns: Columns,
    volume: Volume,
    y: int,
) -> None:
    size, padded = big.size, volume.padded
    inner = (size - small.size) // 2
    width = big.left.shape[1] - size + 1
    zero = big.left[big.left.shape[0] - 1, 0]
    mean = statistics.right_norm[0] + statistics.right_norm[1]
    small_mean = small_statistics.right_norm[0] + small_statistics.right_norm[1]
    norm, small_norm = statistics.right_norm[2], small_statistics.right_norm[2]
    highest = np.full(norm.size, zero)
    for i in range(norm.size):
        highest[i] = (WORST if norm[i] > 0 else UNKNOWN) + 0.5
    for i in range(norm.size - inner):
        if norm[i] == 0:
            small_norm[i + inner] = 0
    gains, small_gains = np.full(width, zero), np.full(width, zero)
    for x in range(width):
        inverse = small_statistics.left_norm[1, x + inner]
        share = 1 / (1 + noise_energy * inverse**2) if inverse > 0 else 0.0
        gains[x] = (1 - share) * WORST * statistics.left_norm[1, x]
        small_gains[x] = share * WORST * inverse
    columns.big[:] = 0
    columns.small[:] = 0
    columns.big_window[:] = 0
    columns.small_window[:] = 0
    left = big.left
    right = big.right.reshape(big.right.size)
    stride = big.right.shape[1]
    big_columns, small_columns = columns.big, columns.small
    big_window, small_window = columns.big_window, columns.small_window
    left_norm = statistics.left_norm
    costs = volume.costs
    for i in range(width + size - 1):
        newest = i % size * padded
        small_newest = (i - inner) % size * padded
        small_oldest = (i - inner - small.size) % size * padded
        first = y * stride + big.left.shape[1] - 1 - i
        for k in range(0, padded, LANES):
            at = first + stride + k
            inside = splat(left[y + 1, i]) * load(right, at)
            for j in range(2, size - 1, 2):
                at += 2 * stride
                inside = inside + splat(left[y + j, i]) * load(right, at - stride)
                inside = inside + splat(left[y + j + 1, i]) * load(right, at)
            both = inside + splat(left[y, i]) * load(right, first + k)
            both = both + splat(left[y + size - 1, i]) * load(right, at + stride)
            window = load(big_window, k) + both - load(big_columns, newest + k)
            store(big_window, k, window)
            store(big_columns, newest + k, both)
            window = load(small_window, k) - load(small_columns, small_oldest + k)
            store(small_columns, newest + k, inside)
            store(small_window, k, window + load(small_columns, small_newest + k))
        x = i - size + 1
        if x < 0:
            continue
        offset = (y * width + x) * padded
        volume.scored[y, x] = statistics.left_norm[1, x] > 0
        if statistics.left_norm[1, x] == 0:
            for k in range(0, padded, LANES):
                store(costs, offset + k, splat(UNKNOWN))
        else:
            gain, small_gain = splat(gains[x]), splat(small_gains[x])
            total = splat(left_norm[0, x])
            small_total = splat(small_statistics.left_norm[0, x + inner])
            here = big.left.shape[1] - 1 - i
            for k in range(0, padded, LANES):
                at = here + k
                value = load(big_window, k) - total * load(mean, at)
                cost = load(highest, at) - value * gain * load(norm, at)
                at += inner
                value = load(small_window, k) - small_total * load(small_mean, at)
                cost = cost - value * small_gain * load(small_norm, at)
                steps = smaller(larger(to_int32(cost), splat(np.int32(0))), splat(WORST))
                store(costs, offset + k, to_uint8(steps))
        for k in range(volume.disparities, padded):
            costs[offset + k] = WORST


class Sweep(NamedTuple):
    """State of a sweep between two rows.

    ``sums`` (2 * (W + 1) * (padded + 1)): costs along the columns in the row before and in this
    one, a sentinel before and after each pixel's; ``least`` (2, W) their minima. ``side``
    (3 * (padded + 1)): the same along the row. Zeros are where paths begin.
    """

    sums: Array
    least: Array
    side: Array
    downward: bool


class Penalties(NamedTuple):
    """P1, and P2 (256) by the step of grey level."""

    P1: int
    P2: Array


@kernel
def new_sweep(width: int, padded: int, downward: bool) -> Sweep:
    """Return the state before the first row."""
    stride = padded + 1
    sums = np.zeros(2 * (width + 1) * stride, np.uint8)
    sums[::stride] = SENTINEL
    side = np.zeros(3 * stride, np.uint8)
    side[::stride] = SENTINEL
    return Sweep(sums, np.zeros((2, width), np.uint8), side, downward)


@kernel
def _extend(sums: Array, at: int, penalty: Any, limit: Any, least: Any, cost: Any) -> Any:
    """Return the costs along a path one pixel farther (eq. 13 of Hirschmueller)."""
    beside = add_saturated(smaller(load(sums, at - 1), load(sums, at + 1)), penalty)
    return smaller(smaller(load(sums, at), beside), limit) - least + cost


@kernel
def _aggregate_row(
    volume: Volume,
    levels: Array,
    penalties: Penalties,
    sweep: Sweep,
    y: int,
    total: Array,
) -> None:
    """Write the sums over the sweep's two paths of row ``y`` to ``total`` (W * padded)."""
    height, width = levels.shape
    padded = volume.padded
    stride = padded + 1
    costs, sums, side = volume.costs, sweep.sums, sweep.side
    row = y if sweep.downward else height - 1 - y
    y_before = max(min(y - 1 if sweep.downward else y + 1, height - 1), 0)
    x_step = 1 if sweep.downward else -1
    new, old = row % 2, 1 - row % 2
    penalty = splat(np.uint8(penalties.P1))
    P2 = penalties.P2
    least_side = np.uint8(0)
    side[1 : 1 + padded] = 0
    for i in range(width):
        x = i if sweep.downward else width - 1 - i
        level = np.int64(levels[y, x])
        least = sweep.least[old, x]
        limit = splat(np.uint8(least + P2[abs(level - levels[y_before, x])]))
        x_before = max(min(x - x_step, width - 1), 0)
        limit_side = splat(np.uint8(least_side + P2[abs(level - levels[y, x_before])]))
        lows, lows_side = splat(least), splat(least_side)
        next_least = next_side = splat(np.uint8(SENTINEL))
        before = (old * (width + 1) + x) * stride + 1
        here = (new * (width + 1) + x) * stride + 1
        before_side, here_side = i % 2 * stride + 1, (1 - i % 2) * stride + 1
        offset = (y * width + x) * padded
        for k in range(0, padded, LANES):
            cost = shift_right(load(costs, offset + k), QUARTER)
            down = _extend(sums, before + k, penalty, limit, lows, cost)
            across = _extend(side, before_side + k, penalty, limit_side, lows_side, cost)
            store(sums, here + k, down)
            store(side, here_side + k, across)
            next_least, next_side = smaller(next_least, down), smaller(next_side, across)
            store(total, x * padded + k, to_uint16(down) + to_uint16(across))
        sweep.least[new, x] = smallest(next_least)
        least_side = smallest(next_side)


class Decision(NamedTuple):
    """How winners are chosen (see `MatchConfig`) and where they go, (H, W)."""

    min_disparity: int
    disp12_max_diff: float
    uniqueness_ratio: float
    subpixel: bool
    disparity: Array


@kernel
def aggregate_rows(
    volume: Volume,
    levels: Array,
    penalties: Penalties,
    sweep: Sweep,
    partial: Array,
    start: int,
    stop: int,
) -> None:
    """Store the halves of the sweep's sums of rows ``start`` to ``stop`` in ``partial``."""
    row = levels.shape[1] * volume.padded
    total = np.empty(row, np.uint16)
    for i in range(stop - start):
        y = start + i if sweep.downward else stop - 1 - i
        _aggregate_row(volume, levels, penalties, sweep, y, total)
        for k in range(0, row, LANES):
            half = to_uint8(shift_right(load(total, k), 1))
            store(partial, (y - start) * row + k, half)


@kernel
def decide_rows(
    volume: Volume,
    levels: Array,
    penalties: Penalties,
    sweep: Sweep,
    partial: Array,
    start: int,
    stop: int,
    decision: Decision,
) -> None:
    """Continue a sweep through rows ``start`` to ``stop``, add the other's sums and choose."""
    row = levels.shape[1] * volume.padded
    total = np.empty(row, np.uint16)
    for i in range(stop - start):
        y = start + i if sweep.downward else stop - 1 - i
        _aggregate_row(volume, levels, penalties, sweep, y, total)
        _decide_row(volume, total, partial, (y - start) * row, decision, y)


@kernel
def _decide_row(
    volume: Volume, total: Array, partial: Array, at: int, decision: Decision, y: int
) -> None:
    """Choose the best disparities of a row, of both pictures, and keep those that agree."""
    width, padded, disparities = volume.scored.shape[1], volume.padded, volume.disparities
    places = np.arange(padded).astype(np.uint16)
    outside = np.where(places >= disparities, NO_SUM, 0).astype(np.uint16)
    right_best = np.full(width + padded, NO_SUM, np.uint16)
    chosen = np.empty(width, np.int64)
    for x in range(width):
        here = width - 1 - x
        best = splat(np.uint16(NO_SUM))
        for k in range(0, padded, LANES):
            other = shift_left(to_uint16(load(partial, at + x * padded + k)), 1)
            both = add_saturated(load(total, x * padded + k) + other, load(outside, k))
            store(total, x * padded + k, both)
            best = smaller(best, both)
            store(right_best, here + k, smaller(both, load(right_best, here + k)))
        lowest = splat(smallest(best))
        first = splat(np.uint16(NO_SUM))
        for k in range(0, padded, LANES):
            # the place where the sum is the lowest, far beyond all places elsewhere
            excess = smaller(load(total, x * padded + k) - lowest, splat(np.uint16(1)))
            first = smaller(first, load(places, k) + shift_left(excess, PLACE_BITS))
        chosen[x] = smallest(first)
    for x in range(width):
        place = chosen[x]
        if not volume.scored[y, x] or not _agrees(total, right_best, decision, padded, x, place):
            continue
        curve = total[x * padded : x * padded + disparities]
        if decision.uniqueness_ratio > 0 and not _is_unique(curve, place, decision):
            continue
        offset = _offset(volume, curve, place, y, x) if decision.subpixel else 0.0
        decision.disparity[y, x] = decision.min_disparity + place + offset


@kernel
def _agrees(
    total: Array, right_best: Array, decision: Decision, padded: int, x: int, place: int
) -> bool:
    """Whether the right pixel's best sum belongs to the same disparity, or nearly."""
    width = total.size // padded
    tolerance = int(np.floor(decision.disp12_max_diff))
    seen = x - decision.min_disparity - place
    agrees = tolerance < 0
    if not 0 <= seen < width:
        return agrees
    for j in range(-tolerance, tolerance + 1):
        if 0 <= x + j < width and 0 <= place + j < padded:
            # the same right pixel, paired with a neighbour of the left one
            agrees |= total[(x + j) * padded + place + j] == right_best[width - 1 - x + place]
    return agrees


@kernel
def _is_unique(curve: Array, place: int, decision: Decision) -> bool:
    """Whether the best sum is below all but its neighbours' by the ratio asked for."""
    second = np.int64(NO_SUM)
    for k in range(curve.size):
        if abs(k - place) > 1:
            second = min(second, np.int64(curve[k]))
    return bool(second * (100 - decision.uniqueness_ratio) > curve[place] * 100)


@kernel
def _offset(volume: Volume, curve: Array, place: int, y: int, x: int) -> Any:
    """Return the best disparity's offset from ``place``, px.

    It is the minimum of the parabola through the pixel's own costs: the sums over paths are
    pointed by the penalties and would draw it to whole pixels.
    """
    if place == 0 or place == curve.size - 1:
        return 0.0
    at = (y * volume.scored.shape[1] + x) * volume.padded + place
    best = np.float64(volume.costs[at])
    before, after = volume.costs[at - 1] - best, volume.costs[at + 1] - best
    if before < 0 or after < 0 or before + after == 0:
        before, after = np.float64(curve[place - 1]), np.float64(curve[place + 1])
        rise = max(before, after) - curve[place]
        return 0.5 * (before - after) / rise if rise > 0 else 0.0
    return 0.5 * (before - after) / (before + after)
