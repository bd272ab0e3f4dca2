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
from binocular_recon.stereo._wls_kernels import PAD, Vector

Real = np.floating[Any] | float

_ZERO = np.float32(0)
_ONE = np.float32(1)


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
def _share(one: float, other: float) -> np.float32:
    total = one + other
    return np.float32(one / total) if total > 0 else _ONE


@kernel
def weigh_between(links: Vector, transfer: Transfer, start: int, stop: int) -> None:
    """Write the weights of fine nodes between two coarse ones, for coarse rows."""
    stride, coarse_stride = transfer.stride, transfer.coarse_stride
    right, down_left, down, down_right = links[0], links[1], links[2], links[3]
    for cy in range(start, stop):
        for cx in range((transfer.columns + 1) // 2):
            c = (cy + PAD) * coarse_stride + cx + PAD
            k = (2 * cy + PAD) * stride + 2 * cx + PAD
            west = max(right[k], _ZERO) + max(down_right[k - stride], _ZERO)
            west += max(down_left[k + 1], _ZERO)
            east = max(right[k + 1], _ZERO) + max(down_left[k - stride + 2], _ZERO)
            east += max(down_right[k + 1], _ZERO)
            transfer.weights[0, c] = _share(west, east)
            north = max(down[k], _ZERO) + max(down_right[k - 1], _ZERO)
            north += max(down_left[k + 1], _ZERO)
            below = k + stride
            south = max(down[below], _ZERO) + max(down_left[below], _ZERO)
            south += max(down_right[below], _ZERO)
            transfer.weights[1, c] = _share(north, south)


@kernel
def weigh_amid(links: Vector, transfer: Transfer, start: int, stop: int) -> None:
    """Write the weights of fine nodes amid four coarse ones, for coarse rows."""
    weights, stride, coarse_stride = transfer.weights, transfer.stride, transfer.coarse_stride
    right, down_left, down, down_right = links[0], links[1], links[2], links[3]
    for cy in range(start, stop):
        for cx in range((transfer.columns + 1) // 2):
            c = (cy + PAD) * coarse_stride + cx + PAD
            k = (2 * cy + PAD) * stride + 2 * cx + PAD
            amid = k + stride + 1
            north, south = max(down[k + 1], _ZERO), max(down[amid], _ZERO)
            west, east = max(right[amid - 1], _ZERO), max(right[amid], _ZERO)
            nw, ne = max(down_right[k], _ZERO), max(down_left[k + 2], _ZERO)
            sw, se = max(down_left[amid], _ZERO), max(down_right[amid], _ZERO)
            top, bottom = weights[0, c], weights[0, c + coarse_stride]
            left, other = weights[1, c], weights[1, c + 1]
            total = north + south + west + east + nw + ne + sw + se
            inverse = _ONE / total if total > 0 else _ZERO
            weights[2, c] = (nw + north * top + west * left) * inverse
            weights[3, c] = (ne + north * (_ONE - top) + east * other) * inverse
            weights[4, c] = (sw + south * bottom + west * (_ONE - left)) * inverse
            weights[5, c] = (se + south * (_ONE - bottom) + east * (_ONE - other)) * inverse


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
    """Add up the links of coarse rows; ``coarse`` (4, coarse nodes) starts at zero."""
    coarse_stride = transfer.coarse_stride
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
    across, along = weights[0], weights[1]
    for cy in range(start, stop):
        for cx in range((transfer.columns + 1) // 2):
            c = (cy + PAD) * coarse_stride + cx + PAD
            k = (2 * cy + PAD) * stride + 2 * cx + PAD
            above = c - coarse_stride
            value = fine[k] + across[c] * fine[k + 1] + (_ONE - across[c - 1]) * fine[k - 1]
            value += along[c] * fine[k + stride] + (_ONE - along[above]) * fine[k - stride]
            value += weights[2, c] * fine[k + stride + 1]
            value += weights[3, c - 1] * fine[k + stride - 1]
            value += weights[4, above] * fine[k - stride + 1]
            value += weights[5, above - 1] * fine[k - stride - 1]
            coarse[c] = value


@kernel
def prolong(coarse: Vector, transfer: Transfer, fine: Vector, start: int, stop: int) -> None:
    """Add ``P coarse`` to the fine nodes of coarse rows."""
    weights, stride, coarse_stride = transfer.weights, transfer.stride, transfer.coarse_stride
    for cy in range(start, stop):
        down = 2 * cy + 1 < transfer.rows
        for cx in range((transfer.columns + 1) // 2):
            c = (cy + PAD) * coarse_stride + cx + PAD
            k = (2 * cy + PAD) * stride + 2 * cx + PAD
            c0, c1 = coarse[c], coarse[c + 1]
            c2, c3 = coarse[c + coarse_stride], coarse[c + coarse_stride + 1]
            right = 2 * cx + 1 < transfer.columns
            fine[k] += c0
            if right:
                fine[k + 1] += weights[0, c] * c0 + (_ONE - weights[0, c]) * c1
            if down:
                fine[k + stride] += weights[1, c] * c0 + (_ONE - weights[1, c]) * c2
            if right and down:
                fine[k + stride + 1] += (
                    weights[2, c] * c0
                    + weights[3, c] * c1
                    + weights[4, c] * c2
                    + weights[5, c] * c3
                )
