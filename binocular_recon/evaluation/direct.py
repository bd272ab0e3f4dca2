# SPDX-License-Identifier: Apache-2.0
"""The exact solution of eq. 13 by SciPy's direct solver: what our filter is held against."""

from __future__ import annotations

import dataclasses
import time
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy.sparse as sp
from scipy.sparse.linalg import spsolve

from binocular_recon.config import FilterConfig
from binocular_recon.evaluation.metrics import FloatImage
from binocular_recon.evaluation.stages import Bench
from binocular_recon.stereo.filtering import filter_disparity


def solve_direct(
    data_px: FloatImage, weight: FloatImage, guide: FloatImage, config: FilterConfig
) -> npt.NDArray[np.float64]:
    """Solve (C + lambda L_g) f = C b.

    Parameters
    ----------
    data_px, weight : (H, W) float32
        b and the diagonal of C; where the weight is 0 the data are not used.
    guide : (H, W) float32
        Grey levels of 255.
    config : FilterConfig
        lambda, alpha, epsilon.

    """
    height, width = data_px.shape
    log_luminance = np.log(guide.astype(np.float64) / 255 + 1 / 255)
    pixels = np.arange(height * width).reshape(height, width)
    laplacian = sp.csc_array((height * width, height * width))
    neighbours = ((pixels[:-1], pixels[1:]), (pixels[:, :-1], pixels[:, 1:]))
    for axis, (one, other) in enumerate(neighbours):
        step = np.abs(np.diff(log_luminance, axis=axis)).ravel()
        link = 1 / (step**config.wls_alpha + config.wls_epsilon)  # eq. 12
        a, b = one.ravel(), other.ravel()
        rows, columns = np.concatenate([a, b, a, b]), np.concatenate([a, b, b, a])
        values = np.concatenate([link, link, -link, -link])
        laplacian = laplacian + sp.coo_array((values, (rows, columns)), laplacian.shape)
    c = weight.astype(np.float64).ravel()
    b = np.where(weight > 0, data_px, 0).astype(np.float64).ravel()
    solution = spsolve((sp.diags(c) + config.wls_lambda * laplacian).tocsc(), c * b)
    result: npt.NDArray[np.float64] = solution.reshape(height, width)
    return result


def compare(bench: Bench, preset: str) -> dict[str, Any]:
    """Hold a preset's filter against the direct solution.

    Returns
    -------
    dict
        ``preset``, ``size``, ``direct_s`` (one run of the direct solver), ``filter_s`` (one of
        ours), ``largest_error_px``, ``error_estimate_px`` and ``iterations`` of ours.

    """
    config, matched = bench.config(preset), bench.matches[preset]
    limits = config.match.limits_px
    data_px, weight, guide = matched.disparity_px, matched.confidence, bench.grey[0]
    if not config.filter.wls_use_confidence:
        # without weights the filter fills holes first, which is not what is compared
        data_px = np.nan_to_num(data_px, nan=float(np.nanmedian(data_px)))
        weight = np.ones_like(data_px)
    # eq. 13 with holes and the guide's weights alone
    plain = dataclasses.replace(config.filter, wls_complete=False, wls_disparity_steps=0.0)
    start = time.perf_counter()
    ours = filter_disparity(data_px, weight, guide, plain, limits_px=limits)
    between = time.perf_counter()
    exact = solve_direct(data_px, weight, guide, plain)
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
