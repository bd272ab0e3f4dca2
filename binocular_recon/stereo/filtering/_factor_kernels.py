# SPDX-License-Identifier: Apache-2.0
"""Kernels that make the smoother of a lattice: incomplete Cholesky factors, strip by strip."""

from __future__ import annotations

import numpy as np

from binocular_recon._jit import inline_kernel, kernel, ordered_kernel
from binocular_recon._simd import (
    LANES,
    larger,
    load,
    narrow,
    smaller,
    splat,
    store,
    to_int32,
    to_uint16,
)
from binocular_recon.stereo.filtering._lattice_kernels import (
    ONE,
    OVERLAP,
    STEPS,
    ZERO,
    Lattice,
    Vector,
    node,
)


@inline_kernel
def _load_strip(lattice: Lattice, matrix: Vector, top: int, bottom: int) -> None:
    """Copy a strip's matrix without negative links, so that the factors stay positive."""
    stride, links, zero = lattice.stride, lattice.links, splat(ZERO)
    diagonal = matrix[4]
    for y in range(top, bottom):
        back = lattice.earlier[y & 1]
        k, first = node(stride, y, 0), node(stride, y - top, 0)
        for i in range(first, first + lattice.width, LANES):
            total = load(lattice.excess, k)
            for a in range(4):
                link = larger(load(links[a], k), zero)
                store(matrix[a], i, link)
                total = total + link + larger(load(links[a], k - back[a]), zero)
            store(diagonal, i, total)
            k += LANES


@ordered_kernel
def _invert_pivots(diagonal: Vector, link_east: Vector, first: int, last: int) -> None:
    """Replace the diagonal of a row by 1 / pivots; each elimination changes the next diagonal.

    Two nodes at a time: the next pair waits for one division, not for two.
    """
    eliminated = ZERO
    for i in range(first, last, 2):
        pivot, square = diagonal[i] - eliminated, link_east[i] * link_east[i]
        if pivot > 0:
            # the next pivot, times this one
            product = diagonal[i + 1] * pivot - square
            inverse, share = ONE / pivot, pivot
        else:
            product, inverse, share = diagonal[i + 1], ZERO, ONE
        diagonal[i] = inverse
        next_inverse = share / product if product > 0 else ZERO
        diagonal[i + 1] = next_inverse
        eliminated = link_east[i + 1] * link_east[i + 1] * next_inverse


@kernel
def factorise(lattice: Lattice, start: int, stop: int) -> None:
    """Factorise a strip's matrix by incomplete Cholesky, IC(0), row by row; round its links."""
    strip, stride = start // lattice.strip, lattice.stride
    factors, inverses = lattice.factors[strip], lattice.inverse[strip]
    top, bottom = max(0, start - OVERLAP), min(lattice.rows, stop + OVERLAP)
    matrix = np.zeros((5, factors.shape[1]), np.float32)
    inverse = matrix[4]
    _load_strip(lattice, matrix, top, bottom)
    steps, one = splat(STEPS), splat(ONE)
    for y in range(top, bottom):
        ahead, first = lattice.later[y & 1], node(stride, y - top, 0)
        last = first + lattice.width
        _invert_pivots(inverse, matrix[0], first, last)
        for t in range(4):
            a, b, c = lattice.triangles[t]
            for i in range(first, last, LANES):
                fill = load(matrix[a], i) * load(matrix[b], i) * load(inverse, i)
                j = i + ahead[a]
                store(matrix[c], j, load(matrix[c], j) + fill)
        for a in range(4):
            for i in range(first, last, LANES):
                link = load(matrix[a], i)
                scaled = link * load(inverse, i)
                # rounded down: weaker links keep the factors positive
                store(factors[a], i, to_uint16(to_int32(smaller(scaled, one) * steps)))
                if a > 0:
                    j = i + ahead[a]
                    store(inverse, j, load(inverse, j) - link * scaled)
        inverses[first:last] = inverse[first:last]
    for y in range(start, stop):
        first = node(stride, y, 0)
        for a in range(4):
            for k in range(first, first + lattice.width, LANES):
                store(lattice.rough_links[a], k, narrow(load(lattice.links[a], k)))
