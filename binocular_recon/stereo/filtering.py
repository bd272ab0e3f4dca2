# SPDX-License-Identifier: Apache-2.0
"""Weighted least squares filter: measured disparities become a dense map (eq. 11-15)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from binocular_recon.config import FilterConfig
from binocular_recon.errors import ImageError
from binocular_recon.stereo._wls_solver import System
from binocular_recon.stereo.completion import (
    COMPLETED_CONFIDENCE,
    complete,
    fill_from_background,
)
from binocular_recon.stereo.matching import sigma_from_confidence

FloatImage = npt.NDArray[np.float32]

# Distance kept from the limits: more than two float32 steps of any disparity up to 4096 px.
LIMIT_MARGIN_PX = 2.0**-10
# Standard deviation that no disparity falls below.
LEAST_SIGMA_PX = 0.05
# Window in which the data's scatter around the solution is taken.
SCATTER_WINDOW_PX = 7
# A pixel without a match: what it may be off by, as a share of the difference between the two
# ends of its hole, and for each pixel of distance from the nearest match.
HOLE_SPREAD_SHARE = 0.25
HOLE_DISTANCE_SHARE = 0.03


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


class Equations(NamedTuple):
    """The normal equations (C + lambda L_g) f = C b of eq. 13.

    Attributes
    ----------
    data : (H, W) float32
        b, without gaps.
    weight : (H, W) float32
        c, the diagonal of C.
    link_x : (H, W - 1) float32
        lambda a_x between horizontal neighbours.
    link_y : (H - 1, W) float32
        lambda a_y between vertical neighbours.

    """

    data: FloatImage
    weight: FloatImage
    link_x: FloatImage
    link_y: FloatImage


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
    Minimises eq. 11; its normal equations (C + lambda L_g) f = C b (eq. 13) are solved to
    ``config.wls_tolerance_px``. Departures from the paper, each with an option that turns it
    off: c is the confidence of the match; pixels without a match take part with a small
    confidence in what lies behind them; the gradient term of eq. 12 grows with steps of the
    disparity too, since objects often border on a background of the same grey.

    The variance of a pixel is that of its match, plus the scatter of the data around the solution
    nearby; without a match it grows with the difference between the two ends of the hole and with
    the distance from the nearest match.

    """
    _check_sizes(disparity_px, confidence=confidence, guide=guide, initial=initial)
    measured = _measured(disparity_px, confidence, limits_px)
    equations = normal_equations(measured, confidence, guide, config)
    system = System(equations.weight, equations.link_x, equations.link_y)
    if initial is not None and not np.isfinite(initial).all():
        initial = None
    solution = system.solve(equations.data, config.wls_tolerance_px, initial)
    sigma = _sigma(measured, confidence, solution.values)
    low, high = limits_px
    margin = min(LIMIT_MARGIN_PX, (high - low) / 2)
    filtered = np.clip(solution.values, low + margin, high - margin).astype(np.float32)
    return Filtered(filtered, sigma, solution.iterations, solution.error_estimate)


def normal_equations(
    measured_px: FloatImage, confidence: FloatImage, guide: FloatImage, config: FilterConfig
) -> Equations:
    """Return the equations that the filter solves.

    Parameters
    ----------
    measured_px : (H, W) float32
        Raw disparity; NaN = none.
    confidence, guide : (H, W) float32
        As for `filter_disparity`.
    config : FilterConfig
        Weights.

    """
    data, weight = _data_term(measured_px, confidence, config)
    return Equations(data, weight, *_links(data, guide, config))


def _measured(
    disparity_px: FloatImage, confidence: FloatImage, limits_px: tuple[float, float]
) -> FloatImage:
    """Return the disparity, NaN where there is none to be used."""
    low, high = limits_px
    valid = (disparity_px >= low) & (disparity_px <= high) & (confidence > 0)
    if not valid.any():
        raise ImageError(
            f'no pixel has a disparity within {low:g}..{high:g} px and a confidence above 0;'
            ' check that the pictures overlap, are rectified and have texture, and the disparity'
            ' range'
        )
    return np.where(valid, disparity_px, np.float32(np.nan)).astype(np.float32)


def _data_term(
    measured: FloatImage, confidence: FloatImage, config: FilterConfig
) -> tuple[FloatImage, FloatImage]:
    """Return b without gaps and c of eq. 13."""
    valid = np.isfinite(measured)
    if not config.wls_use_confidence:
        return _nearest_in_row(measured, valid), np.ones_like(measured)
    weight = np.where(valid, confidence, 0).clip(0, 1).astype(np.float32)
    data, completed = complete(measured, weight)
    return data, completed if config.wls_complete else weight


def _sigma(measured: FloatImage, confidence: FloatImage, filtered: FloatImage) -> FloatImage:
    """Return the standard deviation of every pixel."""
    valid = np.isfinite(measured)
    scatter = _local_mean(np.where(valid, np.square(measured - filtered), 0), valid)
    level = np.where(valid, np.clip(confidence, 0, 1), np.float32(COMPLETED_CONFIDENCE))
    variance = LEAST_SIGMA_PX**2 + sigma_from_confidence(level) ** 2 + scatter
    holes = ~valid
    if holes.any():
        spread = -fill_from_background(-measured) - fill_from_background(measured)
        distance = cv2.distanceTransform(holes.astype(np.uint8), cv2.DIST_L2, 3)
        variance += np.square(HOLE_SPREAD_SHARE * spread)
        variance += np.square(HOLE_DISTANCE_SHARE * distance)
    sigma: FloatImage = np.sqrt(variance).astype(np.float32)
    return sigma


def _local_mean(image: FloatImage, valid: npt.NDArray[np.bool_]) -> FloatImage:
    """Return the mean of the valid pixels of a window; 0 where there is none."""
    window = (SCATTER_WINDOW_PX, SCATTER_WINDOW_PX)
    total = cv2.blur(image.astype(np.float32), window)
    share = cv2.blur(valid.astype(np.float32), window)
    mean: FloatImage = np.maximum(total, 0) / np.maximum(share, np.float32(1e-3))
    return mean


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
    result: FloatImage = np.log(np.maximum(luminance, 0) + np.float32(1 / 255))
    return result


def _links(
    data: FloatImage, guide: FloatImage, config: FilterConfig
) -> tuple[FloatImage, FloatImage]:
    """Return lambda a_x (H, W - 1) and lambda a_y (H - 1, W) of eq. 12."""
    luminance = guide / np.float32(255) if config.wls_guide == 'left' else _unit_range(data)
    guide_log = _log_luminance(luminance)

    def link(after: tuple[slice, ...], before: tuple[slice, ...]) -> FloatImage:
        step = np.abs(guide_log[after] - guide_log[before])
        if step.size == 0:  # OpenCV refuses it
            return np.zeros_like(step)
        # no picture, no edge
        gradient: FloatImage = cv2.pow(cv2.patchNaNs(step, 0), config.wls_alpha)
        if config.wls_disparity_steps:
            gradient += np.float32(config.wls_disparity_steps) * np.square(
                data[after] - data[before]
            )
        smoothness: FloatImage = np.float32(config.wls_lambda) / (
            gradient + np.float32(config.wls_epsilon)
        )
        return smoothness

    all_of, first, last = slice(None), slice(1, None), slice(None, -1)
    return link((all_of, first), (all_of, last)), link((first, all_of), (last, all_of))
