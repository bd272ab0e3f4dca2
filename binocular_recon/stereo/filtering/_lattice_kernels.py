# SPDX-License-Identifier: Apache-2.0
"""Kernels of the filter's solver: the equations on a lattice, and their smoother.

A lattice is a grid of nodes, each with links to later nodes and an excess (its weight of the
data). All are flat arrays of padded rows; `node` gives the place of a node. The padding is zero,
so that no kernel has to treat the image border. The matrix A of a lattice is given by
``(A x)_p = excess_p x_p + sum_q link_pq (x_p - x_q)``. It is computed in this form, never with the
diagonal, because links span five decades and more: float32 would lose the last digits of x.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from binocular_recon._jit import inline_kernel, kernel
from binocular_recon._simd import (
    LANES,
    at_most,
    first_of,
    last_of,
    load,
    slide,
    splat,
    store,
    to_float32,
    widen,
)

Vector = npt.NDArray[np.float32]
Halves = npt.NDArray[np.uint16]
Offsets = tuple[Any, Any, Any]

PAD = 2
# Rows by which the strips of the smoother overlap: the error at their ends decays within these.
OVERLAP = 4
ZERO = np.float32(0)
ONE = np.float32(1)
TINY = np.float32(1e-30)  # keeps divisors above zero
# Factors are from 0 to 1. The smoother is bound by memory, so it reads them with 16 bits.
STEPS = np.float32(65535)
_STEP = np.float32(2.0**-16)
_NEGLIGIBLE = np.float32(1e-18)


class Lattice(NamedTuple):
    """The equations of one level.

    Attributes
    ----------
    links : (4, nodes) float32
        To the next node of the row (east) and to three nodes of later rows.
    excess : (nodes,) float32
        Diagonal minus the sum of the links.
    rough_links : (4, nodes) uint16
        The upper bits of the links, see `narrow`: what the preconditioner needs of them.
    factors : (strips, 4, nodes of a strip) uint16
        Incomplete Cholesky factors: the unit upper triangle by link, in `STEPS`.
    inverse : (strips, nodes of a strip) float32
        Their inverse diagonal.
    scratch : (strips, nodes of a strip) float32
        Work space of the smoother.
    later, earlier : (2, 4) int64
        By the parity of the row: how far ahead the four linked nodes are, and how far back the
        four nodes that link to this one.
    triangles : (4, 3) int64
        Links a and b of a node, and the link c between their ends.
    rows, width, stride, strip : int
        Rows, columns rounded up to a whole vector, floats per padded row, rows per strip.

    """

    links: Vector
    excess: Vector
    rough_links: Halves
    factors: Halves
    inverse: Vector
    scratch: Vector
    later: npt.NDArray[np.int64]
    earlier: npt.NDArray[np.int64]
    triangles: npt.NDArray[np.int64]
    rows: int
    width: int
    stride: int
    strip: int


@inline_kernel
def node(stride: int, y: int, x: int) -> int:
    """Return the place of node (y, x) in a flat array of padded rows."""
    return (y + PAD) * stride + x + PAD


@inline_kernel
def offsets(table: npt.NDArray[np.int64], y: int) -> Offsets:
    """Return the last three offsets of row ``y``; the first is always 1."""
    row = table[y & 1]
    return row[1], row[2], row[3]


@inline_kernel
def _pull(links: Any, k: int, x: Vector, j: int, here: Any) -> Any:
    return widen(load(links, k)) * (load(x, j) - here)


@inline_kernel
def minus_product(
    links: Any, excess: Vector, x: Vector, k: int, ahead: Offsets, back: Offsets
) -> Any:
    """Return a vector of ``-A x``, from node k on; ``links`` are the exact or the rough ones."""
    east, one, two, three = links[0], links[1], links[2], links[3]
    here = load(x, k)
    total = _pull(east, k, x, k + 1, here) + _pull(east, k - 1, x, k - 1, here)
    total = total + _pull(one, k, x, k + ahead[0], here)
    total = total + _pull(one, k - back[0], x, k - back[0], here)
    total = total + _pull(two, k, x, k + ahead[1], here)
    total = total + _pull(two, k - back[1], x, k - back[1], here)
    total = total + _pull(three, k, x, k + ahead[2], here)
    total = total + _pull(three, k - back[2], x, k - back[2], here)
    return total - load(excess, k) * here


@inline_kernel
def _factor_times(factors: Halves, i: int, z: Vector, j: int, a: int) -> Any:
    return to_float32(load(factors[a], i)) * load(z, j)


@inline_kernel
def _without_negligible(share: Any) -> Any:
    """Return the vector with zeros for numbers so small that their products would underflow."""
    return at_most(share, splat(_NEGLIGIBLE), splat(ZERO), share)


@inline_kernel
def _solve_forward(z: Vector, factor: Halves, first: int, last: int) -> None:
    """Replace z[i] by z[i] + factor[i - 1] * z[i - 1], in rising order.

    A vector at a time, by doubling: after the step of ``d``, ``value`` of a node holds the
    contributions of the ``2 d`` nodes up to it, and ``share`` is the factor on those before.
    `_solve_backward` is the mirror image; they are written twice because `slide` takes literals.
    """
    zero, one, before, step = splat(ZERO), splat(ONE), splat(ZERO), splat(_STEP)
    for i in range(first, last, LANES):
        value, share = load(z, i), to_float32(load(factor, i - 1)) * step
        value = value + share * slide(zero, value, 1)
        share = share * slide(one, share, 1)
        value = value + share * slide(zero, value, 2)
        share = share * slide(one, share, 2)
        value = value + share * slide(zero, value, 4)
        share = _without_negligible(share * slide(one, share, 4))
        value = value + share * slide(zero, value, 8)
        share = _without_negligible(share * slide(one, share, 8))
        value = value + share * slide(zero, value, 16)
        share = share * slide(one, share, 16)
        value = value + share * before
        store(z, i, value)
        before = splat(last_of(value))


@inline_kernel
def _solve_backward(z: Vector, factor: Halves, first: int, last: int) -> None:
    """Replace z[i] by z[i] + factor[i] * z[i + 1], in falling order."""
    zero, one, after, step = splat(ZERO), splat(ONE), splat(ZERO), splat(_STEP)
    for i in range(last - LANES, first - 1, -LANES):
        value, share = load(z, i), to_float32(load(factor, i)) * step
        value = value + share * slide(value, zero, 31)
        share = share * slide(share, one, 31)
        value = value + share * slide(value, zero, 30)
        share = share * slide(share, one, 30)
        value = value + share * slide(value, zero, 28)
        share = _without_negligible(share * slide(share, one, 28))
        value = value + share * slide(value, zero, 24)
        share = _without_negligible(share * slide(share, one, 24))
        value = value + share * slide(value, zero, 16)
        share = share * slide(share, one, 16)
        value = value + share * after
        store(z, i, value)
        after = splat(first_of(value))


@kernel
def residual(
    lattice: Lattice, links: Any, rhs: Vector, x: Vector, out: Vector, start: int, stop: int
) -> None:
    """Write ``rhs - A x``; ``links`` are the exact or the rough ones of the lattice."""
    for y in range(start, stop):
        ahead, back = offsets(lattice.later, y), offsets(lattice.earlier, y)
        first = node(lattice.stride, y, 0)
        for k in range(first, first + lattice.width, LANES):
            product = minus_product(links, lattice.excess, x, k, ahead, back)
            store(out, k, load(rhs, k) + product)


@kernel
def smooth(
    lattice: Lattice, rhs: Vector, x: Vector, out: Vector, correct: bool, start: int, stop: int
) -> None:
    """Solve approximately, by the incomplete factors M.

    Writes ``M^-1 rhs``, or with ``correct`` ``x + M^-1 (rhs - A x)``; ``out`` must not be ``x``.
    """
    stride, n = lattice.stride, lattice.width
    strip, step = start // lattice.strip, splat(_STEP)
    factors, inverse, z = lattice.factors[strip], lattice.inverse[strip], lattice.scratch[strip]
    top, bottom = max(0, start - OVERLAP), min(lattice.rows, stop + OVERLAP)
    for y in range(top, bottom):
        ahead, back = offsets(lattice.later, y), offsets(lattice.earlier, y)
        k, first = node(stride, y, 0), node(stride, y - top, 0)
        for i in range(first, first + n, LANES):
            value = load(rhs, k)
            if correct:
                value = value + minus_product(
                    lattice.rough_links, lattice.excess, x, k, ahead, back
                )
            inflow = _factor_times(factors, i - back[0], z, i - back[0], 1)
            inflow = inflow + _factor_times(factors, i - back[1], z, i - back[1], 2)
            inflow = inflow + _factor_times(factors, i - back[2], z, i - back[2], 3)
            store(z, i, value + inflow * step)
            k += LANES
        _solve_forward(z, factors[0], first, first + n)
    for y in range(bottom - 1, top - 1, -1):
        ahead = offsets(lattice.later, y)
        k, first = node(stride, y, 0), node(stride, y - top, 0)
        for i in range(first, first + n, LANES):
            inflow = _factor_times(factors, i, z, i + ahead[0], 1)
            inflow = inflow + _factor_times(factors, i, z, i + ahead[1], 2)
            inflow = inflow + _factor_times(factors, i, z, i + ahead[2], 3)
            store(z, i, load(z, i) * load(inverse, i) + inflow * step)
        _solve_backward(z, factors[0], first, first + n)
        if start <= y < stop:
            for i in range(first, first + n, LANES):
                value = load(z, i)
                if correct:
                    value = value + load(x, k)
                store(out, k, value)
                k += LANES
