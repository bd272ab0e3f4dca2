# SPDX-License-Identifier: Apache-2.0
"""Kernels that eliminate every other pixel exactly: cyclic (red-black) reduction.

Pixels (y, x) with y + x odd, the red ones, link to black ones only, so each is eliminated by one
division. What remains is a system for the black half: node j of row y is pixel
``2 j + (y & 1)``, linked to the next of its row, to two of the next row and to the one two rows
below. Red pixels are counted alike, node j of row y being pixel ``2 j + 1 - (y & 1)``.
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
from binocular_recon.stereo.filtering._transfer_kernels import Transfer

_ZERO = np.float32(0)
_ONE = np.float32(1)
_TINY = np.float32(1e-30)


class RedBlackGrid(NamedTuple):
    """The equations of all pixels.

    Attributes
    ----------
    links : (4, padded pixels) float32
        lambda a_x to the right and, third, lambda a_y downwards; the diagonals are zero.
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
    """Return the numbers right and left of `_every_second`."""
    if odd:
        return load_even(array, k + 2), load_even(array, k)
    return load_odd(array, k), load_odd(array, k - 2)


@kernel
def invert_red(picture: RedBlackGrid, start: int, stop: int) -> None:
    """Write 1 / diagonal of the red pixels of rows."""
    right, down, stride = picture.links[0], picture.links[2], picture.stride
    for y in range(start, stop):
        odd = 1 - (y & 1)
        k, q = (y + PAD) * stride + PAD, (y + PAD) * picture.half_stride + PAD
        for j in range(0, (picture.columns + 1) // 2, LANES):
            i = k + 2 * j
            diagonal = _every_second(picture.weight, i, odd) + _every_second(right, i, odd)
            diagonal = diagonal + _east_west(right, i, odd)[1] + _every_second(down, i, odd)
            diagonal = diagonal + _every_second(down, i - stride, odd)
            inverse = splat(_ONE) / larger(diagonal, splat(_TINY))
            # no pixel: no link and no weight
            store(picture.inverse, q + j, at_most(diagonal, splat(_ZERO), splat(_ZERO), inverse))


@kernel
def reduce_links(
    picture: RedBlackGrid, links: Vector, excess: Vector, start: int, stop: int
) -> None:
    """Write the links and the excess of black nodes of rows."""
    right, down, stride = picture.links[0], picture.links[2], picture.stride
    weight, inverse, half_stride = picture.weight, picture.inverse, picture.half_stride
    for y in range(start, stop):
        odd = y & 1
        for j in range(0, (picture.columns + 1) // 2, LANES):
            k, q = (y + PAD) * stride + PAD + 2 * j, (y + PAD) * half_stride + PAD + j
            to_east, to_west = _every_second(right, k, odd), _east_west(right, k, odd)[1]
            to_south, to_north = _every_second(down, k, odd), _every_second(down, k - stride, odd)
            east = to_east * load(inverse, q + odd)
            west = to_west * load(inverse, q + odd - 1)
            south = to_south * load(inverse, q + half_stride)
            north = to_north * load(inverse, q - half_stride)
            down_east, down_west = _east_west(down, k, odd)
            store(links[0], q, east * _east_west(right, k, odd)[0])
            southern = _east_west(right, k + stride, odd)[1]
            store(links[1], q, west * down_west + south * southern)
            southern = _every_second(right, k + stride, odd)
            store(links[2], q, east * down_east + south * southern)
            store(links[3], q, south * _every_second(down, k + stride, odd))
            eastern, western = _east_west(weight, k, odd)
            total = _every_second(weight, k, odd) + east * eastern + west * western
            total = total + south * _every_second(weight, k + stride, odd)
            store(excess, q, total + north * _every_second(weight, k - stride, odd))


@kernel
def reduce_right_side(
    picture: RedBlackGrid, right_side: Vector, out: Vector, start: int, stop: int
) -> None:
    """Write the right side of black nodes of rows."""
    right, down, stride = picture.links[0], picture.links[2], picture.stride
    inverse, half_stride = picture.inverse, picture.half_stride
    for y in range(start, stop):
        odd = y & 1
        for j in range(0, (picture.columns + 1) // 2, LANES):
            k, q = (y + PAD) * stride + PAD + 2 * j, (y + PAD) * half_stride + PAD + j
            eastern, western = _east_west(right_side, k, odd)
            value = _every_second(right_side, k, odd)
            value = value + _every_second(right, k, odd) * eastern * load(inverse, q + odd)
            to_west = _east_west(right, k, odd)[1]
            value = value + to_west * western * load(inverse, q + odd - 1)
            southern = _every_second(right_side, k + stride, odd)
            to_south = _every_second(down, k, odd)
            value = value + to_south * southern * load(inverse, q + half_stride)
            northern = _every_second(right_side, k - stride, odd)
            to_north = _every_second(down, k - stride, odd)
            store(out, q, value + to_north * northern * load(inverse, q - half_stride))


@kernel
def gather_black(
    picture: RedBlackGrid, pixels: Vector, out: Vector, start: int, stop: int
) -> None:
    """Copy the black pixels of rows."""
    for y in range(start, stop):
        k, q = (y + PAD) * picture.stride + PAD, (y + PAD) * picture.half_stride + PAD
        for j in range(0, (picture.columns + 1) // 2, LANES):
            store(out, q + j, _every_second(pixels, k + 2 * j, y & 1))


@kernel
def substitute(
    picture: RedBlackGrid, right_side: Vector, black: Vector, out: Vector, start: int, stop: int
) -> None:
    """Write all pixels of rows from the black ones."""
    right, down, stride = picture.links[0], picture.links[2], picture.stride
    half_stride = picture.half_stride
    for y in range(start, stop):
        odd = 1 - (y & 1)  # the column of the row's first red pixel
        for j in range(0, (picture.columns + 1) // 2, LANES):
            k, q = (y + PAD) * stride + PAD + 2 * j, (y + PAD) * half_stride + PAD + j
            value = _every_second(right_side, k, odd)
            value = value + _every_second(right, k, odd) * load(black, q + odd)
            value = value + _east_west(right, k, odd)[1] * load(black, q + odd - 1)
            value = value + _every_second(down, k, odd) * load(black, q + half_stride)
            value = value + _every_second(down, k - stride, odd) * load(black, q - half_stride)
            value = value * load(picture.inverse, q)
            if odd:
                store_pairs(out, k, load(black, q), value)
            else:
                store_pairs(out, k, value, load(black, q))


@kernel
def restrict_black(
    black: Vector, transfer: Transfer, coarse: Vector, start: int, stop: int
) -> None:
    """Write ``P^T black`` of coarse rows; ``transfer`` is that of all pixels."""
    weights, stride = transfer.weights, transfer.coarse_stride
    for cy in range(start, stop):
        for cx in range(0, (transfer.columns + 1) // 2, LANES):
            c = (cy + PAD) * stride + cx + PAD
            k = (2 * cy + PAD) * stride + cx + PAD
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
            c = (cy + PAD) * stride + cx + PAD
            k = (2 * cy + PAD) * stride + cx + PAD
            store(black, k, load(black, k) + load(coarse, c))
            if 2 * cy + 1 < transfer.rows:
                value = load(black, k + stride) + load(weights[2], c) * load(coarse, c)
                value = value + load(weights[3], c) * load(coarse, c + 1)
                value = value + load(weights[4], c) * load(coarse, c + stride)
                value = value + load(weights[5], c) * load(coarse, c + stride + 1)
                store(black, k + stride, value)
