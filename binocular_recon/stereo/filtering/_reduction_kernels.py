# SPDX-License-Identifier: Apache-2.0
"""Kernels that eliminate every second pixel exactly: red-black (cyclic) reduction.

Red pixels (y + x odd) have links to black ones only, so each is eliminated by one division. A
system of the black pixels remains: node j of row y is pixel ``2 j + (y & 1)``, linked to the next
one of its row, to two of the next row and to the one two rows below. Red pixels are numbered
alike: node j of row y is pixel ``2 j + 1 - (y & 1)``.
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
from binocular_recon.stereo.filtering._lattice_kernels import ONE, TINY, ZERO, Vector, node
from binocular_recon.stereo.filtering._transfer_kernels import Transfer


class RedBlackGrid(NamedTuple):
    """The equations of all pixels.

    Attributes
    ----------
    links : (4, padded pixels) float32
        Links to the east and, third, to the south: lambda a_x and lambda a_y. The diagonal ones
        are zero.
    weight : (padded pixels,) float32
        c, the weight of the data.
    inverse : (padded nodes,) float32
        1 / diagonal of red pixels.
    columns, stride, half_stride : int
        Columns of pixels, floats per padded row of pixels and of black nodes.

    """

    links: Vector
    weight: Vector
    inverse: Vector
    columns: int
    stride: int
    half_stride: int


@inline_kernel
def _every_second(array: Vector, k: int, odd: int) -> Any:
    """Return numbers k + odd, k + odd + 2, ... of an array."""
    return load_odd(array, k) if odd else load_even(array, k)


@inline_kernel
def _east_west(array: Vector, k: int, odd: int) -> Any:
    """Return the numbers east and west of those of `_every_second`."""
    if odd:
        return load_even(array, k + 2), load_even(array, k)
    return load_odd(array, k), load_odd(array, k - 2)


@kernel
def invert_red(grid: RedBlackGrid, start: int, stop: int) -> None:
    """Write 1 / diagonal of the red pixels of rows."""
    link_east, link_south, stride = grid.links[0], grid.links[2], grid.stride
    for y in range(start, stop):
        odd = 1 - (y & 1)
        k, q = node(stride, y, 0), node(grid.half_stride, y, 0)
        for j in range(0, (grid.columns + 1) // 2, LANES):
            i = k + 2 * j
            diagonal = _every_second(grid.weight, i, odd) + _every_second(link_east, i, odd)
            diagonal = diagonal + _east_west(link_east, i, odd)[1]
            diagonal = diagonal + _every_second(link_south, i, odd)
            diagonal = diagonal + _every_second(link_south, i - stride, odd)
            inverse = splat(ONE) / larger(diagonal, splat(TINY))
            # outside the image: no link and no weight
            store(grid.inverse, q + j, at_most(diagonal, splat(ZERO), splat(ZERO), inverse))


@kernel
def reduce_links(grid: RedBlackGrid, links: Vector, excess: Vector, start: int, stop: int) -> None:
    """Write the links and the excess of black nodes of rows."""
    link_east, link_south, stride = grid.links[0], grid.links[2], grid.stride
    weight, inverse, half_stride = grid.weight, grid.inverse, grid.half_stride
    for y in range(start, stop):
        odd = y & 1
        for j in range(0, (grid.columns + 1) // 2, LANES):
            k, q = node(stride, y, 2 * j), node(half_stride, y, j)
            # share of a black pixel in each of the four red ones around it
            east = _every_second(link_east, k, odd)
            west = _east_west(link_east, k, odd)[1]
            south = _every_second(link_south, k, odd)
            north = _every_second(link_south, k - stride, odd)
            east = east * load(inverse, q + odd)
            west = west * load(inverse, q + odd - 1)
            south = south * load(inverse, q + half_stride)
            north = north * load(inverse, q - half_stride)
            # links of these red pixels to the black ones beyond
            east_south, west_south = _east_west(link_south, k, odd)
            store(links[0], q, east * _east_west(link_east, k, odd)[0])
            south_west = _east_west(link_east, k + stride, odd)[1]
            store(links[1], q, west * west_south + south * south_west)
            south_east = _every_second(link_east, k + stride, odd)
            store(links[2], q, east * east_south + south * south_east)
            store(links[3], q, south * _every_second(link_south, k + stride, odd))
            weight_east, weight_west = _east_west(weight, k, odd)
            total = _every_second(weight, k, odd) + east * weight_east + west * weight_west
            total = total + south * _every_second(weight, k + stride, odd)
            store(excess, q, total + north * _every_second(weight, k - stride, odd))


@kernel
def reduce_rhs(grid: RedBlackGrid, rhs: Vector, out: Vector, start: int, stop: int) -> None:
    """Write the right-hand side of black nodes of rows."""
    link_east, link_south, stride = grid.links[0], grid.links[2], grid.stride
    inverse, half_stride = grid.inverse, grid.half_stride
    for y in range(start, stop):
        odd = y & 1
        for j in range(0, (grid.columns + 1) // 2, LANES):
            k, q = node(stride, y, 2 * j), node(half_stride, y, j)
            east, west = _east_west(rhs, k, odd)
            value = _every_second(rhs, k, odd)
            value = value + _every_second(link_east, k, odd) * east * load(inverse, q + odd)
            link_west = _east_west(link_east, k, odd)[1]
            value = value + link_west * west * load(inverse, q + odd - 1)
            south = _every_second(rhs, k + stride, odd)
            to_south = _every_second(link_south, k, odd)
            value = value + to_south * south * load(inverse, q + half_stride)
            north = _every_second(rhs, k - stride, odd)
            to_north = _every_second(link_south, k - stride, odd)
            store(out, q, value + to_north * north * load(inverse, q - half_stride))


@kernel
def gather_black(grid: RedBlackGrid, pixels: Vector, out: Vector, start: int, stop: int) -> None:
    """Copy the black pixels of rows."""
    for y in range(start, stop):
        k, q = node(grid.stride, y, 0), node(grid.half_stride, y, 0)
        for j in range(0, (grid.columns + 1) // 2, LANES):
            store(out, q + j, _every_second(pixels, k + 2 * j, y & 1))


@kernel
def substitute_red(
    grid: RedBlackGrid, rhs: Vector, black: Vector, out: Vector, start: int, stop: int
) -> None:
    """Solve for the red pixels of rows, and write all pixels."""
    link_east, link_south, stride = grid.links[0], grid.links[2], grid.stride
    half_stride = grid.half_stride
    for y in range(start, stop):
        odd = 1 - (y & 1)  # the column of the first red pixel
        for j in range(0, (grid.columns + 1) // 2, LANES):
            k, q = node(stride, y, 2 * j), node(half_stride, y, j)
            value = _every_second(rhs, k, odd)
            value = value + _every_second(link_east, k, odd) * load(black, q + odd)
            value = value + _east_west(link_east, k, odd)[1] * load(black, q + odd - 1)
            value = value + _every_second(link_south, k, odd) * load(black, q + half_stride)
            north = _every_second(link_south, k - stride, odd)
            value = value + north * load(black, q - half_stride)
            value = value * load(grid.inverse, q)
            if odd:
                store_pairs(out, k, load(black, q), value)
            else:
                store_pairs(out, k, value, load(black, q))


@kernel
def restrict_black(
    black: Vector, transfer: Transfer, coarse: Vector, start: int, stop: int
) -> None:
    """Write ``P^T`` of the black nodes for coarse rows; ``transfer`` is that of all pixels.

    The black pixels are the coarse nodes themselves and the centre nodes.
    """
    weights, stride = transfer.weights, transfer.coarse_stride
    for cy in range(start, stop):
        for cx in range(0, (transfer.columns + 1) // 2, LANES):
            c, k = node(stride, cy, cx), node(stride, 2 * cy, cx)
            value = load(black, k) + load(weights[2], c) * load(black, k + stride)
            value = value + load(weights[3], c - 1) * load(black, k + stride - 1)
            value = value + load(weights[4], c - stride) * load(black, k - stride)
            value = value + load(weights[5], c - stride - 1) * load(black, k - stride - 1)
            store(coarse, c, value)


@kernel
def prolong_black(
    coarse: Vector, transfer: Transfer, black: Vector, start: int, stop: int
) -> None:
    """Add ``P coarse`` to the black nodes of coarse rows."""
    weights, stride = transfer.weights, transfer.coarse_stride
    for cy in range(start, stop):
        for cx in range(0, (transfer.columns + 1) // 2, LANES):
            c, k = node(stride, cy, cx), node(stride, 2 * cy, cx)
            store(black, k, load(black, k) + load(coarse, c))
            if 2 * cy + 1 < transfer.rows:
                value = load(black, k + stride) + load(weights[2], c) * load(coarse, c)
                value = value + load(weights[3], c) * load(coarse, c + 1)
                value = value + load(weights[4], c) * load(coarse, c + stride)
                value = value + load(weights[5], c) * load(coarse, c + stride + 1)
                store(black, k + stride, value)
