# SPDX-License-Identifier: Apache-2.0
"""Inversion of functions that grow, and the small matrices that Newton's method needs."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from binocular_recon.lenses.lens import FloatArray

_STEPS, _ROUNDING = 80, 4e-16
# Functions are evaluated this closely to their limit, which may be a pole, as a share of it.
_INSIDE = 1 - 1e-9


def inverse(
    target: FloatArray,
    function: Callable[[FloatArray], FloatArray],
    derivative: Callable[[FloatArray], FloatArray],
    limit: float,
) -> FloatArray:
    """Invert a function that grows from 0 to ``limit``; NaN where it does not reach the target.

    Newton's method, with bisection wherever that leaves the bracket.
    """
    low = np.zeros_like(target)
    high = np.full_like(target, _INSIDE * limit)
    if math.isinf(limit):
        high = np.maximum(2 * target, 1.0)
        for _ in range(_STEPS):
            short = function(high) < target
            if not short.any():
                break
            high = np.where(short, 2 * high, high)
    target = np.where(function(high) >= target, target, np.nan)
    found = np.where(target < high, target, 0.5 * high)
    last = high
    for _ in range(_STEPS):
        off = function(found) - target
        low, high = np.where(off <= 0, found, low), np.where(off >= 0, found, high)
        with np.errstate(divide='ignore', invalid='ignore'):
            step = off / derivative(found)
        newton = (found - step >= low) & (found - step <= high)
        # steps that do not shrink would circle an inflection; at rounding level they need not
        newton &= (np.abs(step) < 0.5 * last) | (np.abs(off) <= 1e-14 * target)
        following = np.where(newton, found - step, 0.5 * (low + high))
        found, last = following, np.abs(following - found)
        if not (last > _ROUNDING * found).any():
            break
    return np.where(np.isnan(target), np.nan, found)


def least_root(coefficients: FloatArray) -> float:
    """Return the least positive root of a polynomial of ascending powers, inf without one.

    It is 0 where the coefficients are beyond the range of float64: no lens has such.
    """
    trimmed = np.trim_zeros(coefficients, 'b')
    if trimmed.size < 2:
        return math.inf
    with np.errstate(over='ignore', invalid='ignore'):
        if not np.isfinite(trimmed[:-1] / trimmed[-1]).all():
            return 0.0
    roots = np.polynomial.polynomial.polyroots(trimmed)
    real = roots.real[(np.abs(roots.imag) <= 1e-9 * np.abs(roots)) & (roots.real > 0)]
    return float(real.min()) if real.size else math.inf


def matrices(a: FloatArray, b: FloatArray, c: FloatArray, d: FloatArray) -> FloatArray:
    result = np.empty((*a.shape, 2, 2))
    result[..., 0, 0], result[..., 0, 1], result[..., 1, 0], result[..., 1, 1] = a, b, c, d
    return result


def determinant(m: FloatArray) -> FloatArray:
    value: FloatArray = m[..., 0, 0] * m[..., 1, 1] - m[..., 0, 1] * m[..., 1, 0]
    return value


def solve(m: FloatArray, rhs: FloatArray) -> FloatArray:
    """Solve 2 x 2 systems; inf or NaN where a matrix is singular."""
    x = m[..., 1, 1] * rhs[..., 0] - m[..., 0, 1] * rhs[..., 1]
    y = m[..., 0, 0] * rhs[..., 1] - m[..., 1, 0] * rhs[..., 0]
    return np.stack([x, y], -1) / determinant(m)[..., None]
