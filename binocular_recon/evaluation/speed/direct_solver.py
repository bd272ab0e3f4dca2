# SPDX-License-Identifier: Apache-2.0
"""The exact solution of eq. 13 by SciPy's direct solver: the reference for our filter."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy.sparse as sp
from scipy.sparse.linalg import spsolve

from binocular_recon.evaluation.speed.stages import Bench
from binocular_recon.stereo.filtering import Equations, normal_equations
from binocular_recon.stereo.filtering.wls_filter import filter_disparity


def solve_direct(equations: Equations) -> npt.NDArray[np.float64]:
    """Return f, (H, W), of (C + lambda L_g) f = C b."""
    height, width = equations.data.shape
    pixels = np.arange(height * width).reshape(height, width)
    laplacian = sp.csc_array((height * width, height * width))
    for one, other, link in (
        (pixels[:, :-1], pixels[:, 1:], equations.link_east),
        (pixels[:-1], pixels[1:], equations.link_south),
    ):
        a, b, value = one.ravel(), other.ravel(), link.ravel().astype(np.float64)
        rows, columns = np.concatenate([a, b, a, b]), np.concatenate([a, b, b, a])
        values = np.concatenate([value, value, -value, -value])
        laplacian = laplacian + sp.coo_array((values, (rows, columns)), laplacian.shape)
    c = equations.weight.astype(np.float64).ravel()
    data = np.where(c > 0, equations.data.ravel(), 0).astype(np.float64)
    solution = spsolve((sp.diags(c) + laplacian).tocsc(), c * data)
    result: npt.NDArray[np.float64] = solution.reshape(height, width)
    return result


def compare(bench: Bench, preset: str) -> dict[str, Any]:
    """Compare a preset's filter with the direct solution of the same equations.

    Returns
    -------
    dict
        ``preset``, ``size``, ``direct_s`` (one run of the direct solver), ``filter_s`` (one of
        ours), ``largest_error_px``, ``error_estimate_px`` and ``iterations`` of ours.

    """
    config, matched, guide = bench.config(preset), bench.matches[preset], bench.grey[0]
    limits = config.match.limits_px
    start = time.perf_counter()
    ours = filter_disparity(
        matched.disparity_px, matched.confidence, guide, config.filter, limits_px=limits
    )
    between = time.perf_counter()
    exact = solve_direct(
        normal_equations(matched.disparity_px, matched.confidence, guide, config.filter)
    )
    end = time.perf_counter()
    return {
        'preset': preset,
        'size': str(bench.size),
        'direct_s': end - between,
        'filter_s': between - start,
        'largest_error_px': float(np.abs(ours.disparity_px - exact.clip(*limits)).max()),
        'error_estimate_px': ours.error_estimate_px,
        'iterations': ours.iterations,
    }
