# SPDX-License-Identifier: Apache-2.0
"""Accuracy of a disparity map, and whether its standard deviation is calibrated.

Pure functions on arrays. Everywhere ``disparity_px`` is raw, x_left - x_right, NaN = unfilled;
``truth_px`` is the ground truth, NaN = unknown; a mask is True where a pixel counts.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from binocular_recon.images import FloatImage, Mask

BAD_THRESHOLDS_PX = (1.0, 2.0, 3.0)
DEPTH_BANDS_M = ((0.0, 5.0), (5.0, 10.0), (10.0, 20.0), (20.0, 50.0))
# Beyond this error a pixel is a mismatch, about which a standard deviation says nothing.
MISMATCH_PX = 1.0
# A ground truth may be rounded to steps of up to a pixel; fewer distinct values do not tell.
LARGEST_STEP_PX, LEAST_STEP_PX, LEAST_VALUES = 1.0, 1e-3, 16
SIGMA_EDGES_PX = (0.0, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.6, 1.0, np.inf)


@dataclass(frozen=True)
class Accuracy:
    """Errors of a disparity map over one set of pixels.

    Attributes
    ----------
    pixels : int
        Pixels with ground truth in the set; the other members are NaN if there is none.
    bad_percent : tuple of float
        Share of pixels whose error exceeds 1, 2, 3 px; an unfilled pixel is bad.
    measured_error_px : float
        Mean absolute error of the filled pixels.
    mean_error_px : float
        Mean absolute error of all pixels, an unfilled one counting as disparity 0.
    density_percent : float
        Share of filled pixels.

    """

    pixels: int
    bad_percent: tuple[float, ...]
    measured_error_px: float
    mean_error_px: float
    density_percent: float


@dataclass(frozen=True)
class DepthError:
    """Depth error of the pixels whose true depth lies in a band.

    Attributes
    ----------
    near_m, far_m : float
        The band: near <= true depth < far.
    pixels : int
        Pixels with ground truth in the band; the other members are NaN if there is none.
    median_m, p90_m : float
        Median and 90th percentile of the absolute error; a pixel without depth counts as
        infinitely wrong.
    bias_m : float
        Median of estimated minus true depth over the pixels that have a depth.

    """

    near_m: float
    far_m: float
    pixels: int
    median_m: float
    p90_m: float
    bias_m: float


@dataclass(frozen=True)
class SigmaBin:
    """Predicted against measured error of the pixels in one range of predicted sigma.

    Attributes
    ----------
    low_px, high_px : float
        The range: low <= sigma < high.
    pixels : int
        Pixels with ground truth, mismatches included.
    mismatched_percent : float
        Share of them whose error is not below `MISMATCH_PX`.
    predicted_px, measured_px : float
        Root mean square of sigma and of the error over the other pixels.

    """

    low_px: float
    high_px: float
    pixels: int
    mismatched_percent: float
    predicted_px: float
    measured_px: float


def accuracy(
    disparity_px: FloatImage,
    truth_px: FloatImage,
    mask: Mask | None = None,
    thresholds_px: tuple[float, ...] = BAD_THRESHOLDS_PX,
) -> Accuracy:
    """Compare a disparity map with the ground truth.

    Parameters
    ----------
    disparity_px, truth_px : (H, W) float32
        Estimate and ground truth.
    mask : (H, W) bool, optional
        Pixels that count; all if not given.
    thresholds_px : tuple of float
        Errors beyond which a pixel is bad, px.

    Notes
    -----
    D. Scharstein, R. Szeliski, "A taxonomy and evaluation of dense two-frame stereo
    correspondence algorithms", IJCV 2002, eq. 10-11, with unfilled pixels counted as bad.

    """
    counted = np.isfinite(truth_px) if mask is None else np.isfinite(truth_px) & mask
    truth = truth_px[counted].astype(np.float64)
    if truth.size == 0:
        nan = float('nan')
        return Accuracy(0, (nan,) * len(thresholds_px), nan, nan, nan)
    estimate = disparity_px[counted].astype(np.float64)
    filled = np.isfinite(estimate)
    error = np.abs(np.where(filled, estimate, 0.0) - truth)
    return Accuracy(
        pixels=truth.size,
        bad_percent=tuple(
            100.0 * float(np.mean(~filled | (error > limit))) for limit in thresholds_px
        ),
        measured_error_px=float(error[filled].mean()) if filled.any() else float('nan'),
        mean_error_px=float(error.mean()),
        density_percent=100.0 * float(filled.mean()),
    )


def depth_from_disparity(
    disparity_px: FloatImage, focal_baseline: float, offset_px: float
) -> FloatImage:
    """Return depth f B / (d - o), metres, NaN where there is none or it lies behind the rig.

    Parameters
    ----------
    disparity_px : (H, W) float32
        Raw disparity.
    focal_baseline : float
        Focal length times baseline, px m.
    offset_px : float
        ``cx_left - cx_right``, the raw disparity of a point at infinity.

    """
    shifted = np.where(disparity_px > offset_px, disparity_px - offset_px, np.nan)
    return (focal_baseline / shifted).astype(np.float32)


def depth_errors(
    depth_m: FloatImage,
    truth_m: FloatImage,
    bands_m: tuple[tuple[float, float], ...] = DEPTH_BANDS_M,
) -> list[DepthError]:
    """Compare depths with the true ones, by bands of true depth.

    Parameters
    ----------
    depth_m, truth_m : (H, W) float32
        Estimated and true depth, metres; NaN = none.
    bands_m : tuple of (near, far)
        Bands of true depth, metres.

    """
    result = []
    for near, far in bands_m:
        band = (truth_m >= near) & (truth_m < far)
        error = depth_m[band].astype(np.float64) - truth_m[band]
        found = error[np.isfinite(error)]
        if error.size == 0:
            median = p90 = float('nan')
        else:
            # 'higher' picks a measured value: interpolating towards infinity would be NaN
            size = np.where(np.isfinite(error), np.abs(error), np.inf)
            median, p90 = np.quantile(size, (0.5, 0.9), method='higher')
        bias = float(np.median(found)) if found.size else float('nan')
        result.append(DepthError(near, far, error.size, float(median), float(p90), bias))
    return result


def truth_step_px(truth_px: FloatImage) -> float:
    """Return the step to which a ground truth is rounded, px; 0 if it is not.

    The smallest difference of its distinct values. Those that were scaled after rounding are in
    steps of a fraction of a pixel.

    Parameters
    ----------
    truth_px : (H, W) float32
        Ground truth; NaN = unknown.

    """
    values = np.unique(truth_px[np.isfinite(truth_px)].astype(np.float64))
    if len(values) < LEAST_VALUES:
        return 0.0
    step = float(np.diff(values).min())
    return step if LEAST_STEP_PX <= step <= LARGEST_STEP_PX else 0.0


def sigma_against(sigma_px: FloatImage, step_px: float) -> FloatImage:
    """Return one standard deviation of an estimate less a truth that is rounded to steps, px.

    The rounding is uniform within half a step: it adds a variance of ``step_px**2 / 12``.
    """
    return np.hypot(sigma_px, np.float32(step_px / 12**0.5))


def normalised_error_rms(
    disparity_px: FloatImage, sigma_px: FloatImage, truth_px: FloatImage, mask: Mask | None = None
) -> float:
    """Return the root mean square of error / sigma over correctly matched pixels.

    1 means that sigma is calibrated, more that it is too small. Pixels whose error is not below
    `MISMATCH_PX` are left out, as are those without sigma. NaN if there is no pixel.
    """
    error, sigma = _paired(disparity_px, sigma_px, truth_px, mask)
    correct = np.abs(error) < MISMATCH_PX
    if not correct.any():
        return float('nan')
    return float(np.sqrt(np.mean((error[correct] / sigma[correct]) ** 2)))


def sigma_bins(
    disparity_px: FloatImage,
    sigma_px: FloatImage,
    truth_px: FloatImage,
    mask: Mask | None = None,
    edges_px: tuple[float, ...] = SIGMA_EDGES_PX,
) -> list[SigmaBin]:
    """Compare predicted with measured error, by ranges of predicted sigma.

    Parameters
    ----------
    disparity_px, sigma_px, truth_px : (H, W) float32
        Estimate, its standard deviation and the ground truth.
    mask : (H, W) bool, optional
        Pixels that count; all if not given.
    edges_px : tuple of float
        Borders of the ranges, ascending, px.

    """
    error, sigma = _paired(disparity_px, sigma_px, truth_px, mask)
    result = []
    for low, high in pairwise(edges_px):
        chosen = (sigma >= low) & (sigma < high)
        correct = chosen & (np.abs(error) < MISMATCH_PX)
        pixels, kept = int(chosen.sum()), int(correct.sum())
        nan = float('nan')
        result.append(
            SigmaBin(
                low,
                high,
                pixels,
                100.0 * (1.0 - kept / pixels) if pixels else nan,
                float(np.sqrt(np.mean(sigma[correct] ** 2))) if kept else nan,
                float(np.sqrt(np.mean(error[correct] ** 2))) if kept else nan,
            )
        )
    return result


def _paired(
    disparity_px: FloatImage, sigma_px: FloatImage, truth_px: FloatImage, mask: Mask | None
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Return error and sigma of the pixels that have both."""
    error = disparity_px.astype(np.float64) - truth_px
    usable = np.isfinite(error) & np.isfinite(sigma_px) & (sigma_px > 0)
    if mask is not None:
        usable &= mask
    return error[usable], sigma_px[usable].astype(np.float64)
