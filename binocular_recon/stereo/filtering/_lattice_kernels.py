# SPDX-License-Identifier: Apache-2.0
"""Kernels of the filter's solver: a lattice's equations, their smoother and vectors on them.

A lattice is a grid of nodes, each with an excess (what ties it to the data) and links to later
nodes, kept as flat arrays of padded rows: node (y, x) is at ``(y + PAD) * stride + x + PAD`` and
pads are zero, so that no kernel needs to know where a picture ends. Its matrix A has
``(A x)_p = excess_p x_p + sum_q link_pq (x_p - x_q)``: never forming the diagonal keeps float32
exact to the last digits of x although links span five decades and more.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from binocular_recon._jit import inline_kernel, kernel, ordered_kernel
from binocular_recon._simd import (
    LANES,
    at_most,
    first_of,
    larger,
    last_of,
    load,
    slide,
    splat,
    store,
)

Vector = npt.NDArray[np.float32]
Steps = tuple[Any, Any, Any]

PAD = 2
# Rows by which the strips of the smoother overlap: enough that a strip does not see its ends.
OVERLAP = 4
ZERO = np.float32(0)
_ONE = np.float32(1)
_NEGLIGIBLE = np.float32(1e-18)


class Lattice(NamedTuple):
    """The equations of one level.

    Attributes
    ----------
    links : (4, nodes) float32
        To the next node of the row and to three nodes of later rows.
    excess : (nodes,) float32
        What the diagonal has beyond the sum of links.
    factors : (strips, 5, nodes of a strip) float32
        Incomplete Cholesky factors: unit upper triangle by link, inverse diagonal.
    scratch : (strips, nodes of a strip) float32
        Space for the smoother.
    later, earlier : (2, 4) int64
        By the row's parity: how far ahead the four linked nodes are, and how far back the four
        nodes that link here.
    triangles : (4, 3) int64
        Links a and b of a node and the link c that joins their ends.
    rows, width, stride, strip : int
        Rows, columns up to a whole vector, floats per padded row, rows per strip.

    """

    links: Vector
    excess: Vector
    factors: Vector
    scratch: Vector
    later: npt.NDArray[np.int64]
    earlier: npt.NDArray[np.int64]
    triangles: npt.NDArray[np.int64]
    rows: int
    width: int
    stride: int
    strip: int


@inline_kernel
def steps(table: npt.NDArray[np.int64], y: int) -> Steps:
    row = table[y & 1]
    return row[1], row[2], row[3]


@inline_kernel
def flux(lattice: Lattice, x: Vector, k: int, ahead: Steps, back: Steps) -> Any:
    """Return a vector of ``-A x`` from node k."""
    links = lattice.links
    right, one, two, three = links[0], links[1], links[2], links[3]
    here = load(x, k)
    total = load(right, k) * (load(x, k + 1) - here)
    total = total + load(right, k - 1) * (load(x, k - 1) - here)
    total = total + load(one, k) * (load(x, k + ahead[0]) - here)
    total = total + load(one, k - back[0]) * (load(x, k - back[0]) - here)
    total = total + load(two, k) * (load(x, k + ahead[1]) - here)
    total = total + load(two, k - back[1]) * (load(x, k - back[1]) - here)
    total = total + load(three, k) * (load(x, k + ahead[2]) - here)
    total = total + load(three, k - back[2]) * (load(x, k - back[2]) - here)
    return total - load(lattice.excess, k) * here


@inline_kernel
def _coupled(factors: Vector, i: int, z: Vector, j: int, a: int) -> Any:
    return load(factors[a], i) * load(z, j)


@inline_kernel
def _settled(share: Any) -> Any:
    """Return the vector without what is next to nothing and would underflow when multiplied."""
    return at_most(share, splat(_NEGLIGIBLE), splat(ZERO), share)


@inline_kernel
def _solve_forward(z: Vector, factor: Vector, first: int, last: int) -> None:
    """Replace z[i] by z[i] + factor[i - 1] * z[i - 1], in turn.

    A vector at a time by doubling: after the step of ``d``, value and share of a node tell what
    it gets from the ``2 d`` nodes up to it.
    """
    zero, one, before = splat(ZERO), splat(_ONE), splat(ZERO)
    for i in range(first, last, LANES):
        value, share = load(z, i), load(factor, i - 1)
        value = value + share * slide(zero, value, 1)
        share = share * slide(one, share, 1)
        value = value + share * slide(zero, value, 2)
        share = share * slide(one, share, 2)
        value = value + share * slide(zero, value, 4)
        share = _settled(share * slide(one, share, 4))
        value = value + share * slide(zero, value, 8)
        share = _settled(share * slide(one, share, 8))
        value = value + share * slide(zero, value, 16)
        share = share * slide(one, share, 16)
        value = value + share * before
        store(z, i, value)
        before = splat(last_of(value))


@inline_kernel
def _solve_backward(z: Vector, factor: Vector, first: int, last: int) -> None:
    """Replace z[i] by z[i] + factor[i] * z[i + 1], in turn from the last."""
    zero, one, after = splat(ZERO), splat(_ONE), splat(ZERO)
    for i in range(last - LANES, first - 1, -LANES):
        value, share = load(z, i), load(factor, i)
        value = value + share * slide(value, zero, 31)
        share = share * slide(share, one, 31)
        value = value + share * slide(value, zero, 30)
        share = share * slide(share, one, 30)
        value = value + share * slide(value, zero, 28)
        share = _settled(share * slide(share, one, 28))
        value = value + share * slide(value, zero, 24)
        share = _settled(share * slide(share, one, 24))
        value = value + share * slide(value, zero, 16)
        share = share * slide(share, one, 16)
        value = value + share * after
        store(z, i, value)
        after = splat(first_of(value))


@kernel
def residual(
    lattice: Lattice, right: Vector, x: Vector, out: Vector, start: int, stop: int
) -> None:
    """Write ``right - A x``."""
    for y in range(start, stop):
        ahead, back = steps(lattice.later, y), steps(lattice.earlier, y)
        first = (y + PAD) * lattice.stride + PAD
        for k in range(first, first + lattice.width, LANES):
            store(out, k, load(right, k) + flux(lattice, x, k, ahead, back))


@kernel
def _load_strip(lattice: Lattice, factors: Vector, top: int, bottom: int) -> None:
    """Copy a strip's matrix; a negative link is left out, which makes the matrix larger."""
    stride, links, zero = lattice.stride, lattice.links, splat(ZERO)
    diagonal = factors[4]
    for y in range(top, bottom):
        back = lattice.earlier[y & 1]
        k, first = (y + PAD) * stride + PAD, (y - top + PAD) * stride + PAD
        for i in range(first, first + lattice.width, LANES):
            total = load(lattice.excess, k)
            for a in range(4):
                link = larger(load(links[a], k), zero)
                store(factors[a], i, link)
                total = total + link + larger(load(links[a], k - back[a]), zero)
            store(diagonal, i, total)
            k += LANES
    end = (bottom - top + PAD) * stride
    factors[:, end : end + PAD * stride] = ZERO


@ordered_kernel
def _invert_pivots(diagonal: Vector, right: Vector, first: int, last: int) -> None:
    """Replace a row's diagonal by 1 / pivots: each node but the last changes the next one's."""
    taken = ZERO
    for i in range(first, last):
        pivot = diagonal[i] - taken
        inverse = _ONE / pivot if pivot > 0 else ZERO
        diagonal[i] = inverse
        taken = right[i] * right[i] * inverse


@kernel
def factorise(lattice: Lattice, start: int, stop: int) -> None:
    """Factorise a strip's matrix by incomplete Cholesky, IC(0), row by row."""
    factors, stride = lattice.factors[start // lattice.strip], lattice.stride
    inverse = factors[4]
    top, bottom = max(0, start - OVERLAP), min(lattice.rows, stop + OVERLAP)
    _load_strip(lattice, factors, top, bottom)
    for y in range(top, bottom):
        ahead, first = lattice.later[y & 1], (y - top + PAD) * stride + PAD
        last = first + lattice.width
        _invert_pivots(inverse, factors[0], first, last)
        for t in range(4):
            a, b, c = lattice.triangles[t]
            for i in range(first, last, LANES):
                fill = load(factors[a], i) * load(factors[b], i) * load(inverse, i)
                j = i + ahead[a]
                store(factors[c], j, load(factors[c], j) + fill)
        for a in range(4):
            for i in range(first, last, LANES):
                link = load(factors[a], i)
                scaled = link * load(inverse, i)
                store(factors[a], i, scaled)
                if a > 0:
                    j = i + ahead[a]
                    store(inverse, j, load(inverse, j) - link * scaled)


@kernel
def smooth(
    lattice: Lattice, right: Vector, x: Vector, out: Vector, correct: bool, start: int, stop: int
) -> None:
    """Solve approximately by the incomplete factors.

    Writes ``M^-1 right``, or with ``correct`` ``x + M^-1 (right - A x)``; ``out`` is not ``x``.
    """
    stride, n = lattice.stride, lattice.width
    factors, z = lattice.factors[start // lattice.strip], lattice.scratch[start // lattice.strip]
    top, bottom = max(0, start - OVERLAP), min(lattice.rows, stop + OVERLAP)
    for y in range(top, bottom):
        ahead, back = steps(lattice.later, y), steps(lattice.earlier, y)
        k, first = (y + PAD) * stride + PAD, (y - top + PAD) * stride + PAD
        for i in range(first, first + n, LANES):
            value = load(right, k)
            if correct:
                value = value + flux(lattice, x, k, ahead, back)
            value = value + _coupled(factors, i - back[0], z, i - back[0], 1)
            value = value + _coupled(factors, i - back[1], z, i - back[1], 2)
            value = value + _coupled(factors, i - back[2], z, i - back[2], 3)
            store(z, i, value)
            k += LANES
        _solve_forward(z, factors[0], first, first + n)
    for y in range(bottom - 1, top - 1, -1):
        ahead = steps(lattice.later, y)
        k, first = (y + PAD) * stride + PAD, (y - top + PAD) * stride + PAD
        for i in range(first, first + n, LANES):
            value = load(z, i) * load(factors[4], i)
            value = value + _coupled(factors, i, z, i + ahead[0], 1)
            value = value + _coupled(factors, i, z, i + ahead[1], 2)
            value = value + _coupled(factors, i, z, i + ahead[2], 3)
            store(z, i, value)
        _solve_backward(z, factors[0], first, first + n)
        if start <= y < stop:
            for i in range(first, first + n, LANES):
                value = load(z, i)
                if correct:
                    value = value + load(x, k)
                store(out, k, value)
                k += LANES
