# SPDX-License-Identifier: Apache-2.0
"""Kernels that eliminate every other pixel exactly: cyclic (red-black) reduction.

Pixels (y, x) with y + x odd, the red ones, link to black ones only, so each is eliminated by one
division. What remains is a system for the black half: node j of row y is pixel
``2 j + (y & 1)``, linked to the next of its row, to two of the next row and to the one two rows
below. Red pixels are counted alike, node j of row y being pixel ``2 j + 1 - (y & 1)``.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from binocular_recon._jit import kernel
from binocular_recon.stereo._wls_kernels import PAD, Vector
from binocular_recon.stereo._wls_transfer_kernels import Transfer

_ONE = np.float32(1)


class Picture(NamedTuple):
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


@kernel
def invert_red(picture: Picture, start: int, stop: int) -> None:
    """Write 1 / diagonal of the red pixels of rows."""
    right, down, stride = picture.links[0], picture.links[2], picture.stride
    for y in range(start, stop):
        for j in range((picture.columns + (y & 1)) // 2):
            k = (y + PAD) * stride + 2 * j + 1 - (y & 1) + PAD
            diagonal = picture.weight[k] + right[k] + right[k - 1] + down[k] + down[k - stride]
            picture.inverse[(y + PAD) * picture.half_stride + j + PAD] = _ONE / diagonal


@kernel
def reduce_links(picture: Picture, links: Vector, excess: Vector, start: int, stop: int) -> None:
    """Write the links and the excess of black nodes of rows."""
    right, down, stride = picture.links[0], picture.links[2], picture.stride
    weight, inverse = picture.weight, picture.inverse
    for y in range(start, stop):
        odd = y & 1
        for j in range((picture.columns + 1 - odd) // 2):
            k = (y + PAD) * stride + 2 * j + odd + PAD
            q = (y + PAD) * picture.half_stride + j + PAD
            east, west = right[k] * inverse[q + odd], right[k - 1] * inverse[q + odd - 1]
            south = down[k] * inverse[q + picture.half_stride]
            north = down[k - stride] * inverse[q - picture.half_stride]
            links[0, q] = east * right[k + 1]
            links[1, q] = west * down[k - 1] + south * right[k + stride - 1]
            links[2, q] = east * down[k + 1] + south * right[k + stride]
            links[3, q] = south * down[k + stride]
            excess[q] = (
                weight[k]
                + east * weight[k + 1]
                + west * weight[k - 1]
                + south * weight[k + stride]
                + north * weight[k - stride]
            )


@kernel
def reduce_right_side(
    picture: Picture, right_side: Vector, out: Vector, start: int, stop: int
) -> None:
    """Write the right side of black nodes of rows."""
    right, down, stride = picture.links[0], picture.links[2], picture.stride
    inverse, half_stride = picture.inverse, picture.half_stride
    for y in range(start, stop):
        odd = y & 1
        for j in range((picture.columns + 1 - odd) // 2):
            k = (y + PAD) * stride + 2 * j + odd + PAD
            q = (y + PAD) * half_stride + j + PAD
            value = right_side[k] + right[k] * right_side[k + 1] * inverse[q + odd]
            value += right[k - 1] * right_side[k - 1] * inverse[q + odd - 1]
            value += down[k] * right_side[k + stride] * inverse[q + half_stride]
            value += down[k - stride] * right_side[k - stride] * inverse[q - half_stride]
            out[q] = value


@kernel
def gather_black(picture: Picture, pixels: Vector, out: Vector, start: int, stop: int) -> None:
    """Copy the black pixels of rows."""
    for y in range(start, stop):
        for j in range((picture.columns + 1 - (y & 1)) // 2):
            k = (y + PAD) * picture.stride + 2 * j + (y & 1) + PAD
            out[(y + PAD) * picture.half_stride + j + PAD] = pixels[k]


@kernel
def substitute(
    picture: Picture, right_side: Vector, black: Vector, out: Vector, start: int, stop: int
) -> None:
    """Write all pixels of rows from the black ones."""
    right, down, stride = picture.links[0], picture.links[2], picture.stride
    half_stride = picture.half_stride
    for y in range(start, stop):
        first = 1 - (y & 1)  # the column of the row's first red pixel
        for j in range((picture.columns + 1) // 2):
            q = (y + PAD) * half_stride + j + PAD
            k = (y + PAD) * stride + 2 * j + PAD
            if 2 * j + 1 - first < picture.columns:
                out[k + 1 - first] = black[q]
            if 2 * j + first < picture.columns:
                k += first
                value = right_side[k] + right[k] * black[q + first]
                value += right[k - 1] * black[q + first - 1]
                value += down[k] * black[q + half_stride]
                value += down[k - stride] * black[q - half_stride]
                out[k] = value * picture.inverse[q]


@kernel
def restrict_black(
    black: Vector, transfer: Transfer, coarse: Vector, start: int, stop: int
) -> None:
    """Write ``P^T black`` of coarse rows; ``transfer`` is that of all pixels."""
    weights, stride = transfer.weights, transfer.coarse_stride
    for cy in range(start, stop):
        for cx in range((transfer.columns + 1) // 2):
            c = (cy + PAD) * stride + cx + PAD
            k = (2 * cy + PAD) * stride + cx + PAD
            coarse[c] = (
                black[k]
                + weights[2, c] * black[k + stride]
                + weights[3, c - 1] * black[k + stride - 1]
                + weights[4, c - stride] * black[k - stride]
                + weights[5, c - stride - 1] * black[k - stride - 1]
            )


@kernel
def prolong_black(
    coarse: Vector, transfer: Transfer, black: Vector, start: int, stop: int
) -> None:
    """Add ``P coarse`` to the black nodes of coarse rows."""
    weights, stride = transfer.weights, transfer.coarse_stride
    for cy in range(start, stop):
        for cx in range((transfer.columns + 1) // 2):
            c = (cy + PAD) * stride + cx + PAD
            k = (2 * cy + PAD) * stride + cx + PAD
            black[k] += coarse[c]
            if 2 * cy + 1 < transfer.rows:
                black[k + stride] += (
                    weights[2, c] * coarse[c]
                    + weights[3, c] * coarse[c + 1]
                    + weights[4, c] * coarse[c + stride]
                    + weights[5, c] * coarse[c + stride + 1]
                )
