# SPDX-License-Identifier: Apache-2.0
"""Linear fits to data of which a part belongs to something else."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from binocular_recon.camera import FloatArray

SAMPLES, STEPS = 300, 20


def consensus_fit(
    design: FloatArray,
    values: FloatArray,
    weight: FloatArray,
    scatter: float,
    acceptable: Callable[[FloatArray], bool] = lambda _: True,
) -> FloatArray | None:
    """Fit ``design @ x = values`` to the data that agree with each other.

    Random minimal samples are fitted exactly and scored by the weight that agrees (RANSAC); the
    best is refined by weighted least squares with Geman-McClure weights. The same data give the
    same result.

    Parameters
    ----------
    design : (N, k) float64
    values, weight : (N,) float64
    scatter : float
        Residual at which a datum counts a quarter, in the unit of ``values``.
    acceptable : callable
        Tells whether a solution (k,) may be taken.

    Returns
    -------
    x : (k,) float64 or None
        None if no sample had an acceptable solution, or no datum a weight.

    """
    if not weight.any():
        return None
    rng = np.random.default_rng(0)
    count = design.shape[1]
    ends = np.cumsum(weight)
    best, most = None, 0.0
    for _ in range(SAMPLES):
        drawn = np.searchsorted(ends, rng.uniform(0, ends[-1], count), 'right')
        chosen = np.minimum(drawn, len(values) - 1)
        try:
            x = np.linalg.solve(design[chosen], values[chosen])
        except np.linalg.LinAlgError:  # the same datum twice
            continue
        if not acceptable(x):
            continue
        miss = (values - design @ x) / scatter
        agreed = float(weight @ np.maximum(0.0, 1 - miss**2))
        if agreed > most:
            best, most = x, agreed
    return None if best is None else refined_fit(design, values, weight, scatter, best)


def refined_fit(
    design: FloatArray, values: FloatArray, weight: FloatArray, scatter: float, x: FloatArray
) -> FloatArray:
    """Improve a solution (k,) by weighted least squares with Geman-McClure weights."""
    for _ in range(STEPS):
        miss = (values - design @ x) / scatter
        trust = weight / (1 + miss**2) ** 2
        normal = design.T @ (trust[:, None] * design)
        x = np.asarray(np.linalg.solve(normal, design.T @ (trust * values)), np.float64)
    return x
