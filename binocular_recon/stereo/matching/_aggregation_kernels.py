# SPDX-License-Identifier: Apache-2.0
"""Kernels of semi-global aggregation of NCC costs along paths (Hirschmueller 2008).

A cost is one byte, from 0 (score 1) to 252 (score 0 or less); paths add an eighth of it, so that
the sum over two paths fits in a byte. The sum over three paths saturates at 255.

Rows are processed once, from the top, so no cost volume is stored. A block of rows is aggregated
along both directions of its rows, interleaved, because each pixel waits for its predecessor; then
row by row down the columns. All sums are integers.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from binocular_recon._jit import Array, inline_kernel, kernel
from binocular_recon._simd import (
    LANES,
    add_saturated,
    load,
    shift_right,
    smaller,
    smallest,
    splat,
    store,
)
from binocular_recon.stereo.matching._cost_kernels import (
    CostSource,
    new_cost_rows,
    next_cost_row,
)
from binocular_recon.stereo.matching._selection_kernels import Selection
from binocular_recon.stereo.matching._sum_selection_kernels import COPIES, SENTINEL, select_row

EIGHTH = 3  # bits
BLOCK = 2  # rows
WARM_UP = 24  # rows above a strip, from which its paths down the columns start


class Penalties(NamedTuple):
    """P1, and P2 (256) by the difference of grey levels, at most 96."""

    P1: int
    P2: Array


class Paths(NamedTuple):
    """Costs along paths.

    ``costs`` and ``totals`` (BLOCK, W * padded): costs of a block of rows, and their sums over
    paths. ``down`` (2, W * stride): sums down the columns, in the previous and in the current row,
    with a sentinel before and after those of each pixel; ``down_least`` (2, W): their minima.
    ``across`` (BLOCK, 2, 2, stride) and ``across_least`` (BLOCK, 2): the same along the rows, in
    both directions. Paths start at zero.
    """

    costs: Array
    totals: Array
    down: Array
    down_least: Array
    across: Array
    across_least: Array
    padded: int


@inline_kernel
def _new_paths(width: int, padded: int) -> Paths:
    stride = padded + 1
    down = np.zeros((2, width * stride + 1), np.uint8)
    down[:, ::stride] = SENTINEL
    across = np.zeros(BLOCK * 4 * stride + 1, np.uint8)
    across[::stride] = SENTINEL
    return Paths(
        np.empty((BLOCK, width * padded), np.uint8),
        np.empty((BLOCK, width * padded), np.uint8),
        down,
        np.zeros((2, width), np.uint8),
        across,
        np.zeros((BLOCK, 2), np.uint8),
        padded,
    )


@inline_kernel
def _extend(sums: Array, at: int, penalty: Any, limit: Any, least: Any, cost: Any) -> Any:
    """Return the costs along a path, extended by one pixel (eq. 13 of Hirschmueller)."""
    neighbours = add_saturated(smaller(load(sums, at - 1), load(sums, at + 1)), penalty)
    return smaller(smaller(load(sums, at), neighbours), limit) - least + cost


@inline_kernel
def _aggregate_across(
    paths: Paths, levels: Array, penalties: Penalties, disparities: int, y: int, rows: int
) -> None:
    """Set the totals of ``rows`` rows, from ``y`` on, to the sums over both directions."""
    width, padded = levels.shape[1], paths.padded
    stride = padded + 1
    across, least = paths.across, paths.across_least
    least[:] = 0
    for r in range(rows):
        paths.totals[r, :] = 0
        if disparities < padded:
            for x in range(width):
                paths.totals[r, x * padded + disparities : (x + 1) * padded] = SENTINEL
        for side in range(2):
            begin = (r * 2 + side) * 2 * stride + 1
            across[begin : begin + padded] = 0
    penalty = splat(np.uint8(penalties.P1))
    for i in range(width):
        for r in range(rows):
            costs, totals = paths.costs[r], paths.totals[r]
            for side in range(2):
                x = width - 1 - i if side else i
                x_before = max(min(x + 1 if side else x - 1, width - 1), 0)
                step = abs(np.int64(levels[y + r, x]) - np.int64(levels[y + r, x_before]))
                lowest = least[r, side]
                limit = splat(np.uint8(lowest + penalties.P2[step]))
                lows = splat(lowest)
                next_least = splat(SENTINEL)
                begin = (r * 2 + side) * 2 * stride + 1
                before, here = begin + i % 2 * stride, begin + (1 - i % 2) * stride
                at = x * padded
                for k in range(0, padded, LANES):
                    cost = shift_right(load(costs, at + k), EIGHTH)
                    sums = _extend(across, before + k, penalty, limit, lows, cost)
                    store(across, here + k, sums)
                    next_least = smaller(next_least, sums)
                    store(totals, at + k, add_saturated(load(totals, at + k), sums))
                least[r, side] = smallest(next_least)


@inline_kernel
def _aggregate_down(
    paths: Paths, levels: Array, penalties: Penalties, y: int, row: int, total: Array
) -> None:
    """Extend the paths down the columns to row ``y``, row ``row`` of the block; add them."""
    width, padded = levels.shape[1], paths.padded
    stride = padded + 1
    costs = paths.costs[row]
    old, new = paths.down[y % 2], paths.down[1 - y % 2]
    old_least, new_least = paths.down_least[y % 2], paths.down_least[1 - y % 2]
    penalty = splat(np.uint8(penalties.P1))
    above = levels[max(y - 1, 0)]
    for x in range(width):
        lowest = old_least[x]
        step = abs(np.int64(levels[y, x]) - np.int64(above[x]))
        limit = splat(np.uint8(lowest + penalties.P2[step]))
        lows = splat(lowest)
        next_least = splat(SENTINEL)
        for k in range(0, padded, LANES):
            at = x * padded + k
            cost = shift_right(load(costs, at), EIGHTH)
            sums = _extend(old, x * stride + 1 + k, penalty, limit, lows, cost)
            store(new, x * stride + 1 + k, sums)
            next_least = smaller(next_least, sums)
            store(total, at, add_saturated(load(total, at), sums))
        new_least[x] = smallest(next_least)


@kernel
def match_strip(
    source: CostSource,
    levels: Array,
    penalties: Penalties,
    selection: Selection,
    results: tuple[Array, Array],
    start: int,
    stop: int,
) -> None:
    """Write the disparities of rows ``start`` to ``stop`` that pass all checks.

    ``results`` (H, W): disparities, and `MEASURED` or the reason why there is none.
    """
    width = levels.shape[1]
    first = max(start - WARM_UP, 0)
    rows = new_cost_rows(source)
    paths = _new_paths(width, source.padded)
    scored = np.zeros((BLOCK, width), np.bool_)
    right_scored = np.zeros((BLOCK, rows.highest.size), np.bool_)
    best = np.empty((COPIES, width + source.padded), np.uint8)
    for y in range(first, start):
        next_cost_row(source, rows, y, first, paths.costs[0])
        paths.totals[0] = 0
        _aggregate_down(paths, levels, penalties, y, 0, paths.totals[0])
    for y in range(start, stop, BLOCK):
        count = min(BLOCK, stop - y)
        for r in range(count):
            has = next_cost_row(source, rows, y + r, first, paths.costs[r])
            scored[r] = has[:width]
            right_scored[r] = rows.big.right_norm[2] > 0
        _aggregate_across(paths, levels, penalties, source.disparities, y, count)
        for r in range(count):
            total = paths.totals[r]
            _aggregate_down(paths, levels, penalties, y + r, r, total)
            have_scores = scored[r], right_scored[r]
            out = results[0][y + r], results[1][y + r]
            select_row(paths.costs[r], total, have_scores, best, source.padded, selection, out)
