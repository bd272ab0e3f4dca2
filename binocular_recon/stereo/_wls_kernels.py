# SPDX-License-Identifier: Apache-2.0
"""Kernels of the filter's solver: a lattice's equations, their smoother and vectors on them.

A lattice is a grid of nodes, each with an excess (what ties it to the data) and links to later
nodes, kept as flat arrays of padded rows: node (y, x) is at ``(y + PAD) * stride + x + PAD`` and
pads are zero, so that no kernel needs to know where a picture ends. Its matrix A has
``(A x)_p = excess_p x_p + sum_q link_pq (x_p - x_q)``: never forming the diagonal keeps float32
exact to the last digits of x although links span five decades and more.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from binocular_recon._jit import kernel, ordered_kernel

Vector = npt.NDArray[np.float32]
Quad = tuple[np.float32, np.float32, np.float32, np.float32]

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


@kernel
def _add_product(out: Vector, a: Vector, b: Vector) -> None:
    for i in range(len(out)):
        out[i] += a[i] * b[i]


@kernel
def _add_flux(out: Vector, link: Vector, there: Vector, here: Vector) -> None:
    for i in range(len(out)):
        out[i] += link[i] * (there[i] - here[i])


@kernel
def _add_positive(out: Vector, link: Vector) -> None:
    for i in range(len(out)):
        out[i] += max(link[i], _ZERO)


@ordered_kernel
def _compose(row: Vector, factor: Vector, i: int) -> tuple[Quad, Quad]:
    """Return a, b with ``row[i + j]`` to become ``b[j] + a[j] * last``."""
    a0, b0 = factor[i], row[i]
    a1, b1 = factor[i + 1] * a0, row[i + 1] + factor[i + 1] * b0
    a2, b2 = factor[i + 2] * a1, row[i + 2] + factor[i + 2] * b1
    a3, b3 = factor[i + 3] * a2, row[i + 3] + factor[i + 3] * b2
    return (a0, a1, a2, a3), (b0, b1, b2, b3)


@ordered_kernel
def _solve_recurrence(row: Vector, factor: Vector) -> None:
    """Replace row[i] by row[i] + factor[i] * row[i - 1], in turn.

    Eight at a time, so that only two multiplications in eight wait for the one before.
    """
    last = _ZERO
    whole = len(row) - len(row) % 8
    for i in range(0, whole, 8):
        a, b = _compose(row, factor, i)
        c, d = _compose(row, factor, i + 4)
        middle = b[3] + a[3] * last
        row[i], row[i + 1] = b[0] + a[0] * last, b[1] + a[1] * last
        row[i + 2], row[i + 3] = b[2] + a[2] * last, middle
        last = d[3] + c[3] * middle
        row[i + 4], row[i + 5] = d[0] + c[0] * middle, d[1] + c[1] * middle
        row[i + 6], row[i + 7] = d[2] + c[2] * middle, last
    for i in range(whole, len(row)):
        last = row[i] + factor[i] * last
        row[i] = last


@kernel
def _subtract_product_row(lattice: Lattice, x: Vector, y: int, out: Vector) -> None:
    """Subtract row y of A x."""
    links, n = lattice.links, len(out)
    k = (y + PAD) * lattice.stride + PAD
    here, excess = x[k : k + n], lattice.excess[k : k + n]
    for i in range(n):
        out[i] -= excess[i] * here[i]
    for a in range(4):
        there = k + lattice.later[y & 1, a]
        _add_flux(out, links[a, k : k + n], x[there : there + n], here)
        there = k - lattice.earlier[y & 1, a]
        _add_flux(out, links[a, there : there + n], x[there : there + n], here)


@kernel
def residual(
    lattice: Lattice, right: Vector, x: Vector, out: Vector, start: int, stop: int
) -> None:
    """Write ``right - A x``."""
    n = lattice.stride - 2 * PAD
    for y in range(start, stop):
        k = (y + PAD) * lattice.stride + PAD
        out[k : k + n] = right[k : k + n]
        _subtract_product_row(lattice, x, y, out[k : k + n])


@kernel
def _load_strip(lattice: Lattice, factors: Vector, top: int, bottom: int) -> None:
    """Copy a strip's matrix; a negative link is left out, which makes the matrix larger."""
    stride, n = lattice.stride, lattice.stride - 2 * PAD
    for y in range(top, bottom):
        k, i = (y + PAD) * stride + PAD, (y - top + PAD) * stride + PAD
        diagonal = factors[4, i : i + n]
        diagonal[:] = lattice.excess[k : k + n]
        for a in range(4):
            link = lattice.links[a, k : k + n]
            factors[a, i : i + n] = _ZERO
            _add_positive(factors[a, i : i + n], link)
            _add_positive(diagonal, link)
            before = k - lattice.earlier[y & 1, a]
            _add_positive(diagonal, lattice.links[a, before : before + n])


@kernel
def factorise(lattice: Lattice, start: int, stop: int) -> None:
    """Factorise a strip's matrix by incomplete Cholesky, IC(0), row by row."""
    factors, stride = lattice.factors[start // lattice.strip], lattice.stride
    top, bottom = max(0, start - OVERLAP), min(lattice.rows, stop + OVERLAP)
    _load_strip(lattice, factors, top, bottom)
    for y in range(top, bottom):
        ahead = lattice.later[y & 1]
        first = (y - top + PAD) * stride + PAD
        for i in range(first, first + stride - 2 * PAD):
            pivot = factors[4, i]
            inverse = _ONE / pivot if pivot > 0 else _ZERO
            for t in range(4):
                a, b, c = lattice.triangles[t]
                factors[c, i + ahead[a]] += factors[a, i] * factors[b, i] * inverse
            for a in range(4):
                scaled = factors[a, i] * inverse
                factors[4, i + ahead[a]] -= factors[a, i] * scaled
                factors[a, i] = scaled
            factors[4, i] = inverse


@kernel
def smooth(
    lattice: Lattice, right: Vector, x: Vector, out: Vector, correct: bool, start: int, stop: int
) -> None:
    """Solve approximately by the incomplete factors.

    Writes ``M^-1 right``, or with ``correct`` ``x + M^-1 (right - A x)``; ``out`` is not ``x``.
    """
    stride, n = lattice.stride, lattice.stride - 2 * PAD
    factors, z = lattice.factors[start // lattice.strip], lattice.scratch[start // lattice.strip]
    top, bottom = max(0, start - OVERLAP), min(lattice.rows, stop + OVERLAP)
    for y in range(top, bottom):
        k, i = (y + PAD) * stride + PAD, (y - top + PAD) * stride + PAD
        row = z[i : i + n]
        row[:] = right[k : k + n]
        if correct:
            _subtract_product_row(lattice, x, y, row)
        for a in range(1, 4):
            before = i - lattice.earlier[y & 1, a]
            _add_product(row, factors[a, before : before + n], z[before : before + n])
        _solve_recurrence(row, factors[0, i - 1 : i - 1 + n])
    for y in range(bottom - 1, top - 1, -1):
        k, i = (y + PAD) * stride + PAD, (y - top + PAD) * stride + PAD
        row, inverse = z[i : i + n], factors[4, i : i + n]
        for j in range(n):
            row[j] *= inverse[j]
        for a in range(1, 4):
            after = i + lattice.later[y & 1, a]
            _add_product(row, factors[a, i : i + n], z[after : after + n])
        _solve_recurrence(row[::-1], factors[0, i : i + n][::-1])
        if start <= y < stop:
            out[k : k + n] = row
            if correct:
                out[k : k + n] += x[k : k + n]


@kernel
def _dot(a: Vector, b: Vector) -> np.float32:
    total = _ZERO
    for i in range(len(a)):
        total += a[i] * b[i]
    return total


@kernel
def measure(
    lattice: Lattice, z: Vector, b: Vector, sums: npt.NDArray[np.float64], start: int, stop: int
) -> None:
    """Write z.b and max|z| of a strip into ``sums[strip]``."""
    dot, largest = 0.0, _ZERO
    for y in range(start, stop):
        row = slice((y + PAD) * lattice.stride, (y + PAD + 1) * lattice.stride)
        dot += float(_dot(z[row], b[row]))
        for value in z[row]:
            largest = max(largest, abs(value))
    strip = start // lattice.strip
    sums[strip, 0], sums[strip, 1] = dot, largest


@kernel
def apply(
    lattice: Lattice,
    p: Vector,
    residual: Vector,
    Ap: Vector,
    sums: npt.NDArray[np.float64],
    start: int,
    stop: int,
) -> None:
    """Write A p, and p.Ap and p.residual of a strip into ``sums[strip]``."""
    n = lattice.stride - 2 * PAD
    pAp, pr = 0.0, 0.0
    for y in range(start, stop):
        k = (y + PAD) * lattice.stride + PAD
        out = Ap[k : k + n]
        out[:] = _ZERO
        _subtract_product_row(lattice, p, y, out)
        for i in range(n):
            out[i] = -out[i]
        pAp += float(_dot(p[k : k + n], out))
        pr += float(_dot(p[k : k + n], residual[k : k + n]))
    strip = start // lattice.strip
    sums[strip, 0], sums[strip, 1] = pAp, pr


@kernel
def turn(lattice: Lattice, z: Vector, share: float, p: Vector, start: int, stop: int) -> None:
    """Write ``z + share p`` over p."""
    factor = np.float32(share)
    for i in range((start + PAD) * lattice.stride, (stop + PAD) * lattice.stride):
        p[i] = z[i] + factor * p[i]


@kernel
def step(lattice: Lattice, length: float, p: Vector, x: Vector, start: int, stop: int) -> None:
    """Add ``length p`` to x."""
    factor = np.float32(length)
    for i in range((start + PAD) * lattice.stride, (stop + PAD) * lattice.stride):
        x[i] += factor * p[i]
