# SPDX-License-Identifier: Apache-2.0
"""Kernels of conjugate gradients: scalar products and steps on the vectors of a lattice."""

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
    PAD,
    ZERO,
    Lattice,
    Vector,
    flux,
    steps,
)


@inline_kernel
def _larger_size(largest: Any, value: Any) -> Any:
    return larger(largest, larger(value, splat(ZERO) - value))


@inline_kernel
def _sum(vector: Any, space: Vector) -> float:
    store(space, 0, vector)
    total = 0.0
    for i in range(LANES):
        total += float(space[i])
    return total


@inline_kernel
def _largest(vector: Any, space: Vector) -> float:
    store(space, 0, vector)
    largest = 0.0
    for i in range(LANES):
        largest = max(largest, float(space[i]))
    return largest


@kernel
def measure(
    lattice: Lattice, z: Vector, b: Vector, sums: npt.NDArray[np.float64], start: int, stop: int
) -> None:
    """Write z.b and max|z| of a strip into ``sums[strip]``."""
    dot, largest, space = 0.0, splat(ZERO), np.empty(LANES, np.float32)
    for y in range(start, stop):
        first, products = (y + PAD) * lattice.stride + PAD, splat(ZERO)
        for k in range(first, first + lattice.width, LANES):
            value = load(z, k)
            products = products + value * load(b, k)
            largest = _larger_size(largest, value)
        dot += _sum(products, space)
    strip = start // lattice.strip
    sums[strip, 0], sums[strip, 1] = dot, _largest(largest, space)


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
    factor, zero, space = splat(np.float32(share)), splat(ZERO), np.empty(LANES, np.float32)
    pAp, pr, largest = 0.0, 0.0, zero
    for y in range(start, stop):
        ahead, back = steps(lattice.later, y), steps(lattice.earlier, y)
        first, energy, gain = (y + PAD) * lattice.stride + PAD, zero, zero
        for k in range(first, first + lattice.width, LANES):
            value = load(z, k) + factor * load(p, k)
            product = factor * load(Ap, k) - flux(lattice, z, k, ahead, back)
            store(p, k, value)
            store(Ap, k, product)
            energy = energy + value * product
            gain = gain + value * load(residual, k)
            largest = _larger_size(largest, value)
        pAp += _sum(energy, space)
        pr += _sum(gain, space)
    strip = start // lattice.strip
    sums[strip, 0], sums[strip, 1], sums[strip, 2] = pAp, pr, _largest(largest, space)


@kernel
def step(lattice: Lattice, length: float, p: Vector, x: Vector, start: int, stop: int) -> None:
    """Add ``length p`` to x."""
    factor = splat(np.float32(length))
    for y in range(start, stop):
        first = (y + PAD) * lattice.stride + PAD
        for k in range(first, first + lattice.width, LANES):
            store(x, k, load(x, k) + factor * load(p, k))
