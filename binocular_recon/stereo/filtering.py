# SPDX-License-Identifier: Apache-2.0
"""Weighted least squares filter: measured disparities become a dense map (eq. 11-15)."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from binocular_recon.config import FilterConfig
from binocular_recon.errors import ImageError
from binocular_recon.stereo._wls_solver import System

FloatImage = npt.NDArray[np.float32]

# Distance kept from the limits: more than two float32 steps of any disparity up to 4096 px.
LIMIT_MARGIN_PX = 2.0**-10


@dataclass(frozen=True, eq=False)
class Filtered:
    """Dense disparity map with its uncertainty.

    Attributes
    ----------
    disparity_px : (H, W) float32
        Raw disparity of every pixel, strictly inside the limits.
    sigma_px : (H, W) float32
        One standard deviation of it.
    iterations : int
        Iterations of the solver.
    error_estimate_px : float
        Estimated largest difference from the exact solution.

    """

    disparity_px: FloatImage
    sigma_px: FloatImage
    iterations: int
    error_estimate_px: float


def filter_disparity(
    disparity_px: FloatImage,
    confidence: FloatImage,
    guide: FloatImage,
    config: FilterConfig,
    *,
    limits_px: tuple[float, float],
    initial: FloatImage | None = None,
) -> Filtered:
    """Denoise a disparity map and fill its holes, preserving the guide's edges.

    Parameters
    ----------
    disparity_px : (H, W) float32
        Raw disparity x_left - x_right; NaN, infinite or outside ``limits_px`` = none.
    confidence : (H, W) float32
        Confidence of the match in [0, 1]; 0 or NaN = none.
    guide : (H, W) float32
        Left picture in grey levels of 255; not used if ``config.wls_guide`` is 'disparity'.
    config : FilterConfig
        Weights and tolerance.
    limits_px : (float, float)
        Smallest and largest disparity searched.
    initial : (H, W) float32, optional
        A first guess, such as the last frame's result.

    Returns
    -------
    Filtered
        Disparity and standard deviation of every pixel.

    Raises
    ------
    ImageError
        If the sizes differ or no pixel has a disparity.

    Notes
    -----
    Minimises eq. 11; the normal equations (C + lambda L_g) f = C b (eq. 13) are solved exactly.

    """
    _check_sizes(disparity_px, confidence=confidence, guide=guide, initial=initial)
    low, high = limits_px
    with np.errstate(invalid='ignore'):
        valid = (disparity_px >= low) & (disparity_px <= high) & (confidence > 0)
    if not valid.any():
        raise ImageError(
            f'no pixel has a disparity within {low:g}..{high:g} px and a confidence above 0;'
            ' check that the pictures overlap, are rectified and have texture, and the disparity'
            ' range'
        )
    data, weight = _data_term(disparity_px, confidence, valid, config)
    luminance = guide / np.float32(255) if config.wls_guide == 'left' else _unit_range(data)
    guide_log = _log_luminance(luminance)
    system = System(weight, *_links(guide_log, config))
    if initial is not None and not np.isfinite(initial).all():
        initial = None
    solution = system.solve(data, config.wls_tolerance_px, initial)
    sigma = _sigma(system, data, solution.values)
    margin = min(LIMIT_MARGIN_PX, (high - low) / 2)
    filtered = np.clip(solution.values, low + margin, high - margin).astype(np.float32)
    return Filtered(filtered, sigma, solution.iterations, solution.error_estimate)


def _data_term(
    disparity_px: FloatImage,
    confidence: FloatImage,
    valid: npt.NDArray[np.bool_],
    config: FilterConfig,
) -> tuple[FloatImage, FloatImage]:
    """Return b without gaps and c of eq. 13."""
    data = _nearest_in_row(disparity_px, valid).astype(np.float32)
    if not config.wls_use_confidence:
        return data, np.ones_like(data)
    return data, np.where(valid, confidence, 0).clip(0, 1).astype(np.float32)


def _sigma(system: System, data: FloatImage, filtered: FloatImage) -> FloatImage:
    """Return the standard deviation of the filtered disparity: the spread of what supports it."""
    spread = system.solve((data - filtered) ** 2, np.inf).values
    sigma: FloatImage = np.sqrt(np.maximum(spread, 0))
    return sigma


def _check_sizes(disparity_px: FloatImage, **others: FloatImage | None) -> None:
    if disparity_px.ndim != 2 or 0 in disparity_px.shape:
        raise ImageError(f'disparity must be (rows, columns), got shape {disparity_px.shape}')
    for name, image in others.items():
        if image is not None and image.shape != disparity_px.shape:
            raise ImageError(
                f'disparity is {disparity_px.shape} and {name} {image.shape} (rows, columns);'
                ' both must come from the same picture'
            )


def _nearest_in_row(disparity_px: FloatImage, valid: npt.NDArray[np.bool_]) -> FloatImage:
    """Give each pixel without a value the nearest in its row; an empty row the nearest row."""
    height, width = valid.shape
    columns = np.where(valid, np.arange(width), -2 * width)
    before = np.maximum.accumulate(columns, axis=1)
    columns = np.where(valid, np.arange(width), 3 * width)
    after = np.minimum.accumulate(columns[:, ::-1], axis=1)[:, ::-1]
    here = np.arange(width)
    source = np.where(here - before <= after - here, before, after).clip(0, width - 1)
    filled = np.take_along_axis(disparity_px, source, axis=1)
    rows = np.flatnonzero(valid.any(axis=1))
    nearest = rows[np.abs(np.arange(height)[:, None] - rows[None, :]).argmin(axis=1)]
    result: FloatImage = filled[nearest]
    return result


def _unit_range(image: FloatImage) -> FloatImage:
    """Scale to [0, 1]; a constant image is 0."""
    low, high = image.min(), image.max()
    result: FloatImage = (image - low) / max(high - low, np.finfo(np.float32).tiny)
    return result


def _log_luminance(luminance: FloatImage) -> FloatImage:
    """Return l = ln(Y + 1/255), NaN where there is no picture."""
    result: FloatImage = np.log(np.clip(luminance, 0, None) + np.float32(1 / 255))
    return result


def _links(guide_log: FloatImage, config: FilterConfig) -> tuple[FloatImage, FloatImage]:
    """Return lambda a_x (H, W - 1) and lambda a_y (H - 1, W) of eq. 12."""
    return (
        _link(guide_log[:, 1:], guide_log[:, :-1], config),
        _link(guide_log[1:], guide_log[:-1], config),
    )


def _link(one: FloatImage, other: FloatImage, config: FilterConfig) -> FloatImage:
    step = np.abs(one - other)
    if step.size:  # OpenCV refuses empty arrays
        step = cv2.pow(cv2.patchNaNs(step, 0), config.wls_alpha)  # no picture, no edge
    link: FloatImage = np.float32(config.wls_lambda) / (step + np.float32(config.wls_epsilon))
    return link
