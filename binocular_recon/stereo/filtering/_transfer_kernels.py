# SPDX-License-Identifier: Apache-2.0
"""Kernels between a grid and the next coarser one, of every second node: black-box multigrid.

The interpolation follows the links (J. E. Dendy, Black box multigrid, J. Comput. Phys. 48, 1982),
so it does not cross the edges that the filter preserves; the coarse equations are Galerkin's,
P^T A P. A fine node on the line between two coarse ones (a line node) takes the mean of both,
weighted by its links to either side; one at the centre of four coarse nodes (a centre node) solves
its own equation.
"""

from __future__ import annotations

from typing import Any, NamedTuple

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
from binocular_recon.stereo.filtering._lattice_kernels import ONE, PAD, TINY, ZERO, Vector, node

Cell = tuple[Any, Any, Any, Any, Any, Any]


class Transfer(NamedTuple):
    """Interpolation from a coarse grid.

    Attributes
    ----------
    weights : (6, coarse nodes) float32
        By coarse node. Two for the line nodes east and south of it: its own weight, the other
        coarse node has the rest. Four for the centre node south-east of it: the weights of the
        coarse nodes north-west, north-east, south-west and south-east of that.
    rows, columns, stride : int
        Of the fine grid.
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
def _every_second(links: Vector, k: int) -> Any:
    """Return links k, k + 2, ...; negative ones count as 0."""
    return larger(load_even(links, k), splat(ZERO))


@inline_kernel
def _first_share(one: Any, other: Any) -> Any:
    """Return ``one / (one + other)``, 1 if both are 0."""
    total, zero = one + other, splat(ZERO)
    return at_most(total, zero, splat(ONE), one / larger(total, splat(TINY)))


@kernel
def set_line_weights(links: Vector, transfer: Transfer, start: int, stop: int) -> None:
    """Write the weights of line nodes, for coarse rows."""
    stride = transfer.stride
    link_east, link_sw, link_south, link_se = links[0], links[1], links[2], links[3]
    for cy in range(start, stop):
        for cx in range(0, (transfer.columns + 1) // 2, LANES):
            c, k = node(transfer.coarse_stride, cy, cx), node(stride, 2 * cy, 2 * cx)
            below = k + stride
            west, east = _every_second(link_east, k), _every_second(link_east, k + 1)
            north, south = _every_second(link_south, k), _every_second(link_south, below)
            if transfer.diagonal:
                west = west + _every_second(link_se, k - stride) + _every_second(link_sw, k + 1)
                east = east + _every_second(link_sw, k - stride + 2)
                east = east + _every_second(link_se, k + 1)
                north = north + _every_second(link_se, k - 1) + _every_second(link_sw, k + 1)
                south = south + _every_second(link_sw, below) + _every_second(link_se, below)
            store(transfer.weights[0], c, _first_share(west, east))
            store(transfer.weights[1], c, _first_share(north, south))


@kernel
def set_centre_weights(links: Vector, transfer: Transfer, start: int, stop: int) -> None:
    """Write the weights of centre nodes, for coarse rows, from those of line nodes."""
    weights, coarse_stride = transfer.weights, transfer.coarse_stride
    link_east, link_sw, link_south, link_se = links[0], links[1], links[2], links[3]
    one, zero = splat(ONE), splat(ZERO)
    for cy in range(start, stop):
        for cx in range(0, (transfer.columns + 1) // 2, LANES):
            c, k = node(coarse_stride, cy, cx), node(transfer.stride, 2 * cy, 2 * cx)
            centre = k + transfer.stride + 1
            north, south = _every_second(link_south, k + 1), _every_second(link_south, centre)
            west, east = _every_second(link_east, centre - 1), _every_second(link_east, centre)
            total = north + south + west + east
            nw = ne = sw = se = zero
            if transfer.diagonal:
                nw, ne = _every_second(link_se, k), _every_second(link_sw, k + 2)
                sw, se = _every_second(link_sw, centre), _every_second(link_se, centre)
                total = total + nw + ne + sw + se
            inverse = at_most(total, zero, zero, one / larger(total, splat(TINY)))
            # the four line nodes around: weight of their western or northern coarse node
            at_north, at_south = load(weights[0], c), load(weights[0], c + coarse_stride)
            at_west, at_east = load(weights[1], c), load(weights[1], c + 1)
            store(weights[2], c, (nw + north * at_north + west * at_west) * inverse)
            store(weights[3], c, (ne + north * (one - at_north) + east * at_east) * inverse)
            store(weights[4], c, (sw + south * at_south + west * (one - at_west)) * inverse)
            last = se + south * (one - at_south) + east * (one - at_east)
            store(weights[5], c, last * inverse)


@inline_kernel
def _add_link(cell: Cell, link: Any, g0: Any, g1: Any, g2: Any, g3: Any) -> Cell:
    """Add the energy ``link * (g0 f0 + g1 f1 + g2 f2 + g3 f3)^2`` to the links of cells."""
    h0, h1, h2 = link * g0, link * g1, link * g2
    return (
        cell[0] - h0 * g1,
        cell[1] - h0 * g2,
        cell[2] - h0 * g3,
        cell[3] - h1 * g2,
        cell[4] - h1 * g3,
        cell[5] - h2 * g3,
    )


@inline_kernel
def _sum_cells(links: Vector, transfer: Transfer, k: int, c: int) -> Cell:
    """Sum the fine links in cells of four coarse nodes, without the eastern and southern sides.

    The corners are numbered 0 and 1 in the north, 2 and 3 in the south; returns the links 0-1,
    0-2, 0-3, 1-2, 1-3 and 2-3. ``n0`` is the weight of corner 0 in the northern line node, and so
    on; ``m0`` to ``m3`` are those of the centre node.
    """
    weights, stride = transfer.weights, transfer.stride
    link_east, link_sw, link_south, link_se = links[0], links[1], links[2], links[3]
    below, one, zero = k + stride, splat(ONE), splat(ZERO)
    n0, s2 = load(weights[0], c), load(weights[0], c + transfer.coarse_stride)
    w0, e1 = load(weights[1], c), load(weights[1], c + 1)
    n1, s3, w2, e3 = one - n0, one - s2, one - w0, one - e1
    m0, m1, m2, m3 = (
        load(weights[2], c),
        load(weights[3], c),
        load(weights[4], c),
        load(weights[5], c),
    )
    west, east = load_even(link_east, k), load_odd(link_east, k)
    north, south = load_even(link_south, k), load_even(link_south, below)
    cell = (
        west * n1 * n1 + east * n0 * n0,
        north * w2 * w2 + south * w0 * w0,
        zero,
        zero,
        zero,
        zero,
    )
    cell = _add_link(cell, load_odd(link_south, k), m0 - n0, m1 - n1, m2, m3)
    cell = _add_link(cell, load_odd(link_south, below), m0, m1, m2 - s2, m3 - s3)
    cell = _add_link(cell, load_even(link_east, below), m0 - w0, m1, m2 - w2, m3)
    cell = _add_link(cell, load_odd(link_east, below), m0, m1 - e1, m2, m3 - e3)
    if transfer.diagonal:
        cell = _add_link(cell, load_even(link_se, k), m0 - one, m1, m2, m3)
        cell = _add_link(cell, load_even(link_sw, k + 2), m0, m1 - one, m2, m3)
        cell = _add_link(cell, load_odd(link_sw, below), m0, m1, m2 - one, m3)
        cell = _add_link(cell, load_odd(link_se, below), m0, m1, m2, m3 - one)
        cell = _add_link(cell, load_odd(link_sw, k), n0 - w0, n1, zero - w2, zero)
        cell = _add_link(cell, load_odd(link_se, k), n0, n1 - e1, zero, zero - e3)
        cell = _add_link(cell, load_even(link_se, below), w0, zero, w2 - s2, zero - s3)
        cell = _add_link(cell, load_even(link_sw, below + 2), zero, e1, zero - s2, e3 - s3)
    return cell


@inline_kernel
def _add(array: Vector, k: int, values: Any) -> None:
    store(array, k, load(array, k) + values)


@kernel
def galerkin(links: Vector, transfer: Transfer, coarse: Vector, start: int, stop: int) -> None:
    """Write the links (4, coarse nodes) of coarse rows."""
    coarse_stride = transfer.coarse_stride
    coarse[:, (start + PAD) * coarse_stride : (stop + PAD) * coarse_stride] = ZERO
    east, south_west, south, south_east = coarse[0], coarse[1], coarse[2], coarse[3]
    for cy in range(start - 1, stop):
        for cx in range(0, (transfer.columns + 1) // 2, LANES):
            c, k = node(coarse_stride, cy, cx), node(transfer.stride, 2 * cy, 2 * cx)
            cell = _sum_cells(links, transfer, k, c)
            if cy >= start:
                _add(east, c, cell[0])
                _add(south, c, cell[1])
                _add(south_east, c, cell[2])
                _add(south_west, c + 1, cell[3])
                _add(south, c + 1, cell[4])
            if cy + 1 < stop:
                _add(east, c + coarse_stride, cell[5])


@kernel
def restrict(fine: Vector, transfer: Transfer, coarse: Vector, start: int, stop: int) -> None:
    """Write ``P^T fine`` of coarse rows."""
    weights, stride, coarse_stride = transfer.weights, transfer.stride, transfer.coarse_stride
    at_east, at_south, one = weights[0], weights[1], splat(ONE)
    for cy in range(start, stop):
        for cx in range(0, (transfer.columns + 1) // 2, LANES):
            c, k = node(coarse_stride, cy, cx), node(stride, 2 * cy, 2 * cx)
            c_above, above, below = c - coarse_stride, k - stride, k + stride
            value = load_even(fine, k) + load(at_east, c) * load_odd(fine, k)
            value = value + (one - load(at_east, c - 1)) * load_odd(fine, k - 2)
            value = value + load(at_south, c) * load_even(fine, below)
            value = value + (one - load(at_south, c_above)) * load_even(fine, above)
            value = value + load(weights[2], c) * load_odd(fine, below)
            value = value + load(weights[3], c - 1) * load_odd(fine, below - 2)
            value = value + load(weights[4], c_above) * load_odd(fine, above)
            value = value + load(weights[5], c_above - 1) * load_odd(fine, above - 2)
            store(coarse, c, value)


@kernel
def prolong(coarse: Vector, transfer: Transfer, fine: Vector, start: int, stop: int) -> None:
    """Add ``P coarse`` to the fine nodes of coarse rows."""
    weights, stride, coarse_stride = transfer.weights, transfer.stride, transfer.coarse_stride
    one = splat(ONE)
    for cy in range(start, stop):
        for cx in range(0, (transfer.columns + 1) // 2, LANES):
            c, k = node(coarse_stride, cy, cx), node(stride, 2 * cy, 2 * cx)
            c0, c1 = load(coarse, c), load(coarse, c + 1)
            weight = load(weights[0], c)
            odd = load_odd(fine, k) + weight * c0 + (one - weight) * c1
            store_pairs(fine, k, load_even(fine, k) + c0, odd)
            if 2 * cy + 1 < transfer.rows:
                c2, c3 = load(coarse, c + coarse_stride), load(coarse, c + coarse_stride + 1)
                k += stride
                weight = load(weights[1], c)
                even = load_even(fine, k) + weight * c0 + (one - weight) * c2
                odd = load_odd(fine, k) + load(weights[2], c) * c0 + load(weights[3], c) * c1
                odd = odd + load(weights[4], c) * c2 + load(weights[5], c) * c3
                store_pairs(fine, k, even, odd)
        # in a grid of odd width, pairs reach one node into the padding
        beyond = node(stride, 2 * cy, transfer.columns)
        fine[beyond] = fine[beyond + stride] = ZERO
