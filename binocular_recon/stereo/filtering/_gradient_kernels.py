# SPDX-License-Identifier: Apache-2.0
"""Kernels of conjugate gradients: dot products and updates of the vectors of a lattice."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from binocular_recon._jit import inline_kernel, kernel
from binocular_recon._simd import (
    LANES,
    larger,
    load,
    splat,
    store,
)
from binocular_recon.stereo.filtering._lattice_kernels import (
    ZERO,
    Lattice,
    Vector,
    minus_product,
    node,
    offsets,
)


@inline_kernel
def _larger_size(largest: Any, value: Any) -> Any:
    return larger(largest, larger(value, splat(ZERO) - value))


@inline_kernel
def _sum(vector: Any, scratch: Vector) -> float:
    store(scratch, 0, vector)
    total = 0.0
    for i in range(LANES):
        total += float(scratch[i])
    return total


@inline_kernel
def _largest(vector: Any, scratch: Vector) -> float:
    store(scratch, 0, vector)
    largest = 0.0
    for i in range(LANES):
        largest = max(largest, float(scratch[i]))
    return largest


@kernel
def dot_and_largest(
    lattice: Lattice, z: Vector, b: Vector, sums: npt.NDArray[np.float64], start: int, stop: int
) -> None:
    """Write z.b and max|z| of a strip into ``sums[strip]``."""
    dot, largest, scratch = 0.0, splat(ZERO), np.empty(LANES, np.float32)
    for y in range(start, stop):
        first, products = node(lattice.stride, y, 0), splat(ZERO)
        for k in range(first, first + lattice.width, LANES):
            value = load(z, k)
            products = products + value * load(b, k)
            largest = _larger_size(largest, value)
        dot += _sum(products, scratch)
    strip = start // lattice.strip
    sums[strip, 0], sums[strip, 1] = dot, _largest(largest, scratch)


@kernel
def update_direction(
    lattice: Lattice,
    z: Vector,
    beta: float,
    residual: Vector,
    p: Vector,
    Ap: Vector,
    sums: npt.NDArray[np.float64],
    start: int,
    stop: int,
) -> None:
    """Replace p by z + beta p, and A p likewise.

    Writes p.Ap, p.residual and max|p| of a strip into ``sums[strip]``.
    """
    factor, zero, scratch = splat(np.float32(beta)), splat(ZERO), np.empty(LANES, np.float32)
    pAp, pr, largest = 0.0, 0.0, zero
    for y in range(start, stop):
        ahead, back = offsets(lattice.later, y), offsets(lattice.earlier, y)
        first, row_pAp, row_pr = node(lattice.stride, y, 0), zero, zero
        for k in range(first, first + lattice.width, LANES):
            value = load(z, k) + factor * load(p, k)
            product = factor * load(Ap, k) - minus_product(
                lattice.links, lattice.excess, z, k, ahead, back
            )
            store(p, k, value)
            store(Ap, k, product)
            row_pAp = row_pAp + value * product
            row_pr = row_pr + value * load(residual, k)
            largest = _larger_size(largest, value)
        pAp += _sum(row_pAp, scratch)
        pr += _sum(row_pr, scratch)
    strip = start // lattice.strip
    sums[strip, 0], sums[strip, 1], sums[strip, 2] = pAp, pr, _largest(largest, scratch)


@kernel
def update_solution(
    lattice: Lattice, alpha: float, p: Vector, x: Vector, start: int, stop: int
) -> None:
    """Add ``alpha p`` to x."""
    factor = splat(np.float32(alpha))
    for y in range(start, stop):
        first = node(lattice.stride, y, 0)
        for k in range(first, first + lattice.width, LANES):
            store(x, k, load(x, k) + factor * load(p, k))
