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
from binocular_recon._simd import LANES, larger, load, splat, store

Vector = npt.NDArray[np.float32]
Quad = tuple[np.float32, np.float32, np.float32, np.float32]
Steps = tuple[Any, Any, Any]

PAD = 2
# Rows by which the strips of the smoother overlap: enough that a strip does not see its ends.
OVERLAP = 4
_ZERO = np.float32(0)
_ONE = np.float32(1)


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
    rows, stride, strip : int
        Rows, floats per padded row, rows per strip.

    """

    links: Vector
    excess: Vector
    factors: Vector
    scratch: Vector
    later: npt.NDArray[np.int64]
    earlier: npt.NDArray[np.int64]
    triangles: npt.NDArray[np.int64]
    rows: int
    stride: int
    strip: int


@inline_kernel
def _steps(table: npt.NDArray[np.int64], y: int) -> Steps:
    row = table[y & 1]
    return row[1], row[2], row[3]


@inline_kernel
def _flux(lattice: Lattice, x: Vector, k: int, ahead: Steps, back: Steps) -> Any:
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


@ordered_kernel
def _compose(z: Vector, i: int, factor: Vector, k: int, way: int) -> tuple[Quad, Quad]:
    """Return a, b with ``z[i + way * j]`` to become ``b[j] + a[j] * before``."""
    f1, f2, f3 = factor[k + way], factor[k + 2 * way], factor[k + 3 * way]
    a0, b0 = factor[k], z[i]
    a1, b1 = f1 * a0, z[i + way] + f1 * b0
    a2, b2 = f2 * a1, z[i + 2 * way] + f2 * b1
    a3, b3 = f3 * a2, z[i + 3 * way] + f3 * b2
    return (a0, a1, a2, a3), (b0, b1, b2, b3)


@ordered_kernel
def _solve_forward(z: Vector, factor: Vector, first: int, last: int) -> None:
    """Replace z[i] by z[i] + factor[i - 1] * z[i - 1], in turn.

    Eight at a time, so that only two multiplications in eight wait for the one before.
    """
    before = _ZERO
    for i in range(first, last, 8):
        a, b = _compose(z, i, factor, i - 1, 1)
        c, d = _compose(z, i + 4, factor, i + 3, 1)
        middle = b[3] + a[3] * before
        z[i], z[i + 1] = b[0] + a[0] * before, b[1] + a[1] * before
        z[i + 2], z[i + 3] = b[2] + a[2] * before, middle
        before = d[3] + c[3] * middle
        z[i + 4], z[i + 5] = d[0] + c[0] * middle, d[1] + c[1] * middle
        z[i + 6], z[i + 7] = d[2] + c[2] * middle, before


@ordered_kernel
def _solve_backward(z: Vector, factor: Vector, first: int, last: int) -> None:
    """Replace z[i] by z[i] + factor[i] * z[i + 1], in turn from the last."""
    before = _ZERO
    for i in range(last - 1, first - 1, -8):
        a, b = _compose(z, i, factor, i, -1)
        c, d = _compose(z, i - 4, factor, i - 4, -1)
        middle = b[3] + a[3] * before
        z[i], z[i - 1] = b[0] + a[0] * before, b[1] + a[1] * before
        z[i - 2], z[i - 3] = b[2] + a[2] * before, middle
        before = d[3] + c[3] * middle
        z[i - 4], z[i - 5] = d[0] + c[0] * middle, d[1] + c[1] * middle
        z[i - 6], z[i - 7] = d[2] + c[2] * middle, before


@kernel
def residual(
    lattice: Lattice, right: Vector, x: Vector, out: Vector, start: int, stop: int
) -> None:
    """Write ``right - A x``."""
    for y in range(start, stop):
        ahead, back = _steps(lattice.later, y), _steps(lattice.earlier, y)
        first = (y + PAD) * lattice.stride + PAD
        for k in range(first, first + lattice.stride - PAD, LANES):
            store(out, k, load(right, k) + _flux(lattice, x, k, ahead, back))


@kernel
def _load_strip(lattice: Lattice, factors: Vector, top: int, bottom: int) -> None:
    """Copy a strip's matrix; a negative link is left out, which makes the matrix larger."""
    stride, links, zero = lattice.stride, lattice.links, splat(_ZERO)
    diagonal = factors[4]
    for y in range(top, bottom):
        back = lattice.earlier[y & 1]
        k, first = (y + PAD) * stride + PAD, (y - top + PAD) * stride + PAD
        for i in range(first, first + stride - PAD, LANES):
            total = load(lattice.excess, k)
            for a in range(4):
                link = larger(load(links[a], k), zero)
                store(factors[a], i, link)
                total = total + link + larger(load(links[a], k - back[a]), zero)
            store(diagonal, i, total)
            k += LANES


@ordered_kernel
def _invert_pivots(diagonal: Vector, right: Vector, first: int, last: int) -> None:
    """Replace a row's diagonal by 1 / pivots: each node but the last changes the next one's."""
    taken = _ZERO
    for i in range(first, last):
        pivot = diagonal[i] - taken
        inverse = _ONE / pivot if pivot > 0 else _ZERO
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
        last = first + stride - PAD
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
    stride, n = lattice.stride, lattice.stride - PAD
    factors, z = lattice.factors[start // lattice.strip], lattice.scratch[start // lattice.strip]
    top, bottom = max(0, start - OVERLAP), min(lattice.rows, stop + OVERLAP)
    for y in range(top, bottom):
        ahead, back = _steps(lattice.later, y), _steps(lattice.earlier, y)
        k, first = (y + PAD) * stride + PAD, (y - top + PAD) * stride + PAD
        for i in range(first, first + n, LANES):
            value = load(right, k)
            if correct:
                value = value + _flux(lattice, x, k, ahead, back)
            value = value + _coupled(factors, i - back[0], z, i - back[0], 1)
            value = value + _coupled(factors, i - back[1], z, i - back[1], 2)
            value = value + _coupled(factors, i - back[2], z, i - back[2], 3)
            store(z, i, value)
            k += LANES
        _solve_forward(z, factors[0], first, first + n)
    for y in range(bottom - 1, top - 1, -1):
        ahead = _steps(lattice.later, y)
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


@kernel
def _dot(a: Vector, b: Vector) -> np.float32:
    total = _ZERO
    for i in range(len(a)):
        total += a[i] * b[i]
    return total


@kernel
def _largest(row: Vector) -> np.float32:
    largest = _ZERO
    for i in range(len(row)):
        largest = max(largest, abs(row[i]))
    return largest


@kernel
def measure(
    lattice: Lattice, z: Vector, b: Vector, sums: npt.NDArray[np.float64], start: int, stop: int
) -> None:
    """Write z.b and max|z| of a strip into ``sums[strip]``."""
    dot, largest = 0.0, _ZERO
    for y in range(start, stop):
        row = slice((y + PAD) * lattice.stride, (y + PAD + 1) * lattice.stride)
        dot += float(_dot(z[row], b[row]))
        largest = max(largest, _largest(z[row]))
    strip = start // lattice.strip
    sums[strip, 0], sums[strip, 1] = dot, largest


@kernel
def turn(
    lattice: Lattice,
    z: Vector,
    share: float,
    residual: Vector,
    p: Vector,
    Ap: Vector,
    sums: npt.NDArray[np.float64],
    start: int,
    stop: int,
) -> None:
    """Write z + share p over p, A p alike; p.Ap, p.residual and max|p| into ``sums[strip]``."""
    n, factor = lattice.stride - PAD, splat(np.float32(share))
    pAp, pr, largest = 0.0, 0.0, _ZERO
    for y in range(start, stop):
        ahead, back = _steps(lattice.later, y), _steps(lattice.earlier, y)
        first = (y + PAD) * lattice.stride + PAD
        for k in range(first, first + n, LANES):
            store(p, k, load(z, k) + factor * load(p, k))
            store(Ap, k, factor * load(Ap, k) - _flux(lattice, z, k, ahead, back))
        row = p[first : first + n]
        pAp += float(_dot(row, Ap[first : first + n]))
        pr += float(_dot(row, residual[first : first + n]))
        largest = max(largest, _largest(row))
    strip = start // lattice.strip
    sums[strip, 0], sums[strip, 1], sums[strip, 2] = pAp, pr, largest


@kernel
def step(lattice: Lattice, length: float, p: Vector, x: Vector, start: int, stop: int) -> None:
    """Add ``length p`` to x."""
    factor = np.float32(length)
    for i in range((start + PAD) * lattice.stride, (stop + PAD) * lattice.stride):
        x[i] += factor * p[i]
