# SPDX-License-Identifier: Apache-2.0
"""Kernels between a grid and the grid of every second node: black-box multigrid.

The interpolation follows the links (J. E. Dendy, Black box multigrid, J. Comput. Phys. 48, 1982),
so it does not cross the edges that the filter preserves; the coarse equations are Galerkin's,
P^T A P. A fine node between two coarse ones takes both values, weighed by its links to either
side; one amid four solves its own equation.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from binocular_recon._jit import inline_kernel, kernel
from binocular_recon._simd import (
    LANES,
    at_most,
    larger,
    load,
    load_even,
    load_odd,
    splat,
    store,
    store_pairs,
)
from binocular_recon.stereo.filtering._lattice_kernels import PAD, Vector

Real = np.floating[Any] | float

_ZERO = np.float32(0)
_ONE = np.float32(1)
_TINY = np.float32(1e-30)


class Transfer(NamedTuple):
    """Interpolation from a coarse grid.

    Attributes
    ----------
    weights : (6, coarse nodes) float32
        Two for the fine nodes right of and below a coarse node: its share, the rest is that of
        its neighbour. Four for the fine node diagonally below: the shares of the coarse nodes
        upper left, upper right, lower left and lower right of it.
    rows, columns, stride : int
        The fine grid's.
    coarse_stride : int
        Floats per padded row of the coarse grid.
    diagonal : bool
        Whether the fine grid has diagonal links.

    """

    weights: Vector
    rows: int
    columns: int
    stride: int
    coarse_stride: int
    diagonal: bool


@inline_kernel
def _even(links: Vector, k: int) -> Any:
    """Return links k, k + 2, ...; a negative one counts as none."""
    return larger(load_even(links, k), splat(_ZERO))


@inline_kernel
def _share(one: Any, other: Any) -> Any:
    """Return ``one / (one + other)``, 1 if both are 0."""
    total, zero = one + other, splat(_ZERO)
    return at_most(total, zero, splat(_ONE), one / larger(total, splat(_TINY)))


@kernel
def weigh_between(links: Vector, transfer: Transfer, start: int, stop: int) -> None:
    """Write the weights of fine nodes between two coarse ones, for coarse rows."""
    stride = transfer.stride
    right, down_left, down, down_right = links[0], links[1], links[2], links[3]
    for cy in range(start, stop):
        for cx in range(0, (transfer.columns + 1) // 2, LANES):
            c = (cy + PAD) * transfer.coarse_stride + cx + PAD
            k = (2 * cy + PAD) * stride + 2 * cx + PAD
            below = k + stride
            west, east = _even(right, k), _even(right, k + 1)
            north, south = _even(down, k), _even(down, below)
            if transfer.diagonal:
                west = west + _even(down_right, k - stride) + _even(down_left, k + 1)
                east = east + _even(down_left, k - stride + 2) + _even(down_right, k + 1)
                north = north + _even(down_right, k - 1) + _even(down_left, k + 1)
                south = south + _even(down_left, below) + _even(down_right, below)
            store(transfer.weights[0], c, _share(west, east))
            store(transfer.weights[1], c, _share(north, south))


@kernel
def weigh_amid(links: Vector, transfer: Transfer, start: int, stop: int) -> None:
    """Write the weights of fine nodes amid four coarse ones, for coarse rows."""
    weights, stride, coarse_stride = transfer.weights, transfer.stride, transfer.coarse_stride
    right, down_left, down, down_right = links[0], links[1], links[2], links[3]
    one, zero = splat(_ONE), splat(_ZERO)
    for cy in range(start, stop):
        for cx in range(0, (transfer.columns + 1) // 2, LANES):
            c = (cy + PAD) * coarse_stride + cx + PAD
            k = (2 * cy + PAD) * stride + 2 * cx + PAD
            amid = k + stride + 1
            north, south = _even(down, k + 1), _even(down, amid)
            west, east = _even(right, amid - 1), _even(right, amid)
            total = north + south + west + east
            nw = ne = sw = se = zero
            if transfer.diagonal:
                nw, ne = _even(down_right, k), _even(down_left, k + 2)
                sw, se = _even(down_left, amid), _even(down_right, amid)
                total = total + nw + ne + sw + se
            inverse = at_most(total, zero, zero, one / larger(total, splat(_TINY)))
            top, bottom = load(weights[0], c), load(weights[0], c + coarse_stride)
            left, other = load(weights[1], c), load(weights[1], c + 1)
            store(weights[2], c, (nw + north * top + west * left) * inverse)
            store(weights[3], c, (ne + north * (one - top) + east * other) * inverse)
            store(weights[4], c, (sw + south * bottom + west * (one - left)) * inverse)
            store(weights[5], c, (se + south * (one - bottom) + east * (one - other)) * inverse)


@inline_kernel
def _add_link(cell: Vector, link: Real, g0: Real, g1: Real, g2: Real, g3: Real) -> None:
    """Add the energy ``link * (g0 f0 + g1 f1 + g2 f2 + g3 f3)^2`` to a coarse cell's links."""
    cell[0] -= link * g0 * g1
    cell[1] -= link * g0 * g2
    cell[2] -= link * g0 * g3
    cell[3] -= link * g1 * g2
    cell[4] -= link * g1 * g3
    cell[5] -= link * g2 * g3


@inline_kernel
def _gather_cell(cell: Vector, links: Vector, transfer: Transfer, k: int, c: int) -> None:
    """Sum the fine links of a coarse cell, its right and lower border left out."""
    weights, stride = transfer.weights, transfer.stride
    right, down_left, down, down_right = links[0], links[1], links[2], links[3]
    amid, below = k + stride + 1, k + stride
    n0, s2 = weights[0, c], weights[0, c + transfer.coarse_stride]
    w0, e1 = weights[1, c], weights[1, c + 1]
    n1, s3, w2, e3 = _ONE - n0, _ONE - s2, _ONE - w0, _ONE - e1
    m0, m1, m2, m3 = weights[2, c], weights[3, c], weights[4, c], weights[5, c]
    cell[:] = 0
    _add_link(cell, down[k + 1], m0 - n0, m1 - n1, m2, m3)
    _add_link(cell, down[amid], m0, m1, m2 - s2, m3 - s3)
    _add_link(cell, right[amid - 1], m0 - w0, m1, m2 - w2, m3)
    _add_link(cell, right[amid], m0, m1 - e1, m2, m3 - e3)
    cell[0] += right[k] * n1 * n1 + right[k + 1] * n0 * n0
    cell[1] += down[k] * w2 * w2 + down[below] * w0 * w0
    if transfer.diagonal:
        _add_link(cell, down_right[k], m0 - _ONE, m1, m2, m3)
        _add_link(cell, down_left[k + 2], m0, m1 - _ONE, m2, m3)
        _add_link(cell, down_left[amid], m0, m1, m2 - _ONE, m3)
        _add_link(cell, down_right[amid], m0, m1, m2, m3 - _ONE)
        _add_link(cell, down_left[k + 1], n0 - w0, n1, -w2, _ZERO)
        _add_link(cell, down_right[k + 1], n0, n1 - e1, _ZERO, -e3)
        _add_link(cell, down_right[below], w0, _ZERO, w2 - s2, -s3)
        _add_link(cell, down_left[below + 2], _ZERO, e1, -s2, e3 - s3)


@kernel
def galerkin(links: Vector, transfer: Transfer, coarse: Vector, start: int, stop: int) -> None:
    """Write the links (4, coarse nodes) of coarse rows."""
    coarse_stride = transfer.coarse_stride
    coarse[:, (start + PAD) * coarse_stride : (stop + PAD) * coarse_stride] = _ZERO
    cell = np.zeros(6, np.float32)
    for cy in range(start - 1, stop):
        for cx in range((transfer.columns + 1) // 2):
            c = (cy + PAD) * coarse_stride + cx + PAD
            k = (2 * cy + PAD) * transfer.stride + 2 * cx + PAD
            _gather_cell(cell, links, transfer, k, c)
            if cy >= start:
                coarse[0, c] += cell[0]
                coarse[2, c] += cell[1]
                coarse[3, c] += cell[2]
                coarse[1, c + 1] += cell[3]
                coarse[2, c + 1] += cell[4]
            if cy + 1 < stop:
                coarse[0, c + coarse_stride] += cell[5]


@kernel
def restrict(fine: Vector, transfer: Transfer, coarse: Vector, start: int, stop: int) -> None:
    """Write ``P^T fine`` of coarse rows."""
    weights, stride, coarse_stride = transfer.weights, transfer.stride, transfer.coarse_stride
    across, along, one = weights[0], weights[1], splat(_ONE)
    for cy in range(start, stop):
        for cx in range(0, (transfer.columns + 1) // 2, LANES):
            c = (cy + PAD) * coarse_stride + cx + PAD
            k = (2 * cy + PAD) * stride + 2 * cx + PAD
            above, before, after = c - coarse_stride, k - stride, k + stride
            value = load_even(fine, k) + load(across, c) * load_odd(fine, k)
            value = value + (one - load(across, c - 1)) * load_odd(fine, k - 2)
            value = value + load(along, c) * load_even(fine, after)
            value = value + (one - load(along, above)) * load_even(fine, before)
            value = value + load(weights[2], c) * load_odd(fine, after)
            value = value + load(weights[3], c - 1) * load_odd(fine, after - 2)
            value = value + load(weights[4], above) * load_odd(fine, before)
            value = value + load(weights[5], above - 1) * load_odd(fine, before - 2)
            store(coarse, c, value)


@kernel
def prolong(coarse: Vector, transfer: Transfer, fine: Vector, start: int, stop: int) -> None:
    """Add ``P coarse`` to the fine nodes of coarse rows."""
    weights, stride, coarse_stride = transfer.weights, transfer.stride, transfer.coarse_stride
    one = splat(_ONE)
    for cy in range(start, stop):
        for cx in range(0, (transfer.columns + 1) // 2, LANES):
            c = (cy + PAD) * coarse_stride + cx + PAD
            k = (2 * cy + PAD) * stride + 2 * cx + PAD
            c0, c1 = load(coarse, c), load(coarse, c + 1)
            share = load(weights[0], c)
            odd = load_odd(fine, k) + share * c0 + (one - share) * c1
            store_pairs(fine, k, load_even(fine, k) + c0, odd)
            if 2 * cy + 1 < transfer.rows:
                c2, c3 = load(coarse, c + coarse_stride), load(coarse, c + coarse_stride + 1)
                k += stride
                share = load(weights[1], c)
                even = load_even(fine, k) + share * c0 + (one - share) * c2
                odd = load_odd(fine, k) + load(weights[2], c) * c0 + load(weights[3], c) * c1
                odd = odd + load(weights[4], c) * c2 + load(weights[5], c) * c3
                store_pairs(fine, k, even, odd)
        beyond = (2 * cy + PAD) * stride + PAD + transfer.columns
        fine[beyond] = fine[beyond + stride] = _ZERO
