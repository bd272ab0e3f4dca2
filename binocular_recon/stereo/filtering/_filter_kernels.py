# SPDX-License-Identifier: Apache-2.0
"""Kernels of the filter around its solver: links and the variance of pixels."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from binocular_recon._jit import Array, kernel

REACH = 3  # of the window in which the data's scatter around the solution is taken
_ZERO = np.float32(0)
_WHOLE = np.float32(1e-3)


class SigmaTerms(NamedTuple):
    """What the variance of pixels is made of; images are (H, W) float32.

    Attributes
    ----------
    measured, filtered : disparity, NaN = none in the first.
    confidence : of matches, above 0.
    unit, least : variance of a match whose confidence is 1/2, and of every pixel.
    rounding : least variance of the scatter.
    holes : variance of pixels without a match.

    """

    measured: Array
    filtered: Array
    confidence: Array
    unit: float
    least: float
    rounding: float
    holes: Array


@kernel
def all_whole(values: Array) -> bool:
    """Return whether all but NaN are whole numbers, to the rounding of float32."""
    for y in range(values.shape[0]):
        for value in values[y]:
            if abs(value - np.rint(value)) > _WHOLE:
                return False
    return True


@kernel
def _size_of_step(one: Array, other: Array, out: Array) -> None:
    for i in range(len(out)):
        step = abs(one[i] - other[i])
        out[i] = _ZERO if np.isnan(step) else step


@kernel
def size_of_steps(values: Array, right: Array, down: Array, start: int, stop: int) -> None:
    """Write the size of the step to the right and to the lower neighbour, 0 where it is NaN."""
    for y in range(start, stop):
        _size_of_step(values[y - start, 1:], values[y - start, :-1], right[y])
        if y < len(down):
            _size_of_step(values[y - start + 1], values[y - start], down[y])


@kernel
def _weigh(
    one: Array, other: Array, gradient: Array, strength: float, steps: float, epsilon: float
) -> None:
    share, kappa, least = np.float32(strength), np.float32(steps), np.float32(epsilon)
    for i in range(len(gradient)):
        step = one[i] - other[i]
        gradient[i] = share / (gradient[i] + kappa * step * step + least)


@kernel
def weigh_links(
    data: Array,
    right: Array,
    down: Array,
    options: tuple[float, float, float],
    start: int,
    stop: int,
) -> None:
    """Replace the gradient term of links by ``lambda / (gradient + kappa step^2 + epsilon)``."""
    strength, steps, epsilon = options
    for y in range(start, stop):
        _weigh(data[y, 1:], data[y, :-1], right[y], strength, steps, epsilon)
        if y < len(down):
            _weigh(data[y + 1], data[y], down[y], strength, steps, epsilon)


@kernel
def _add(out: Array, values: Array) -> None:
    for i in range(len(out)):
        out[i] += values[i]


@kernel
def _compare(measured: Array, filtered: Array, square: Array, count: Array) -> None:
    for i in range(len(measured)):
        difference = measured[i] - filtered[i]
        valid = not np.isnan(difference)
        square[i] += difference * difference if valid else _ZERO
        count[i] += np.float32(1) if valid else _ZERO


@kernel
def _spread_along_row(padded: Array, out: Array) -> None:
    out[:] = _ZERO
    for shift in range(2 * REACH + 1):
        _add(out, padded[shift : shift + len(out)])


@kernel
def _add_variances(
    evidence: SigmaTerms, y: int, squares: Array, counts: Array, out: Array
) -> None:
    measured, level, hole = evidence.measured[y], evidence.confidence[y], evidence.holes[y]
    one, unit, least = np.float32(1), np.float32(evidence.unit), np.float32(evidence.least)
    rounding = np.float32(evidence.rounding)
    for x in range(len(out)):
        matched = unit * (one / min(level[x], one) - one)
        variance = least + (hole[x] if np.isnan(measured[x]) else matched)
        variance += max(squares[x] / max(counts[x], one), rounding)
        out[x] = np.sqrt(variance)


@kernel
def standard_deviation(evidence: SigmaTerms, sigma: Array, start: int, stop: int) -> None:
    """Write the root of a constant, the match's or the hole's variance and the data's scatter."""
    measured, filtered = evidence.measured, evidence.filtered
    height, width = measured.shape
    columns = np.zeros((2, width + 2 * REACH), np.float32)
    squares, counts = np.empty(width, np.float32), np.empty(width, np.float32)
    for y in range(start, stop):
        columns[:] = _ZERO
        for near in range(max(0, y - REACH), min(height, y + REACH + 1)):
            inside = slice(REACH, REACH + width)
            _compare(measured[near], filtered[near], columns[0, inside], columns[1, inside])
        _spread_along_row(columns[0], squares)
        _spread_along_row(columns[1], counts)
        _add_variances(evidence, y, squares, counts, sigma[y])
