# SPDX-License-Identifier: Apache-2.0
"""Check disparities that others computed against the images, and give each a confidence."""

from __future__ import annotations

import cv2
import numpy as np

from binocular_recon.config import MatchConfig
from binocular_recon.images import FloatImage, Mask, window_mean
from binocular_recon.stereo.confidence import confidence_from_sigma
from binocular_recon.stereo.matching.matcher import SUBPIXEL_STEP_PX, Match
from binocular_recon.stereo.validity import Validity

# Standard deviation of a disparity: a constant, the difference between the disparities from the
# left and from the right image, and a factor on what the images do not have in common, 1 - NCC.
# With these, 68 % of the errors of SPS-Stereo and 71 % of those of StereoSGBM are within one sigma
# on eight real scenes (RMS of error / sigma 0.93 and 0.90).
COMMON_SIGMA_PX = 0.3
DIFFERENCE_FACTOR = 1.0
UNLIKE_SIGMA_PX = 1.0
# Up to this correlation the images contradict the disparity: that of 25 unrelated pixels has a
# standard deviation of as much. It drops 43 % of the errors above 2 px of SPS-Stereo, and 7 % of
# its other disparities; with the left-right check 61 and 9 %.
LEAST_NCC = 0.2


def check_disparity(
    disparity_px: FloatImage,
    left: FloatImage,
    right: FloatImage,
    config: MatchConfig,
    right_disparity_px: FloatImage | None = None,
) -> Match:
    """Return disparities that pass the checks, with their confidence.

    Parameters
    ----------
    disparity_px : (H, W) float32
        x_left - x_right of the pixels of the left image; NaN or infinite = none.
    left, right : (H, W) float32
        Rectified images, grey levels 0..255; NaN = no data.
    config : MatchConfig
        Search range, window of the photometric check, texture threshold below which it says
        nothing, and limit of the left-right check (``disp12_max_diff``, negative = off).
    right_disparity_px : (H, W) float32, optional
        The same of the pixels of the right image; without it there is no left-right check.

    Returns
    -------
    Match
        Disparities within ``config.limits_px`` that the images do not contradict.

    Notes
    -----
    Photometric check: NCC of the window in the left image with that in the right one, moved by
    the disparity of each of its pixels.

    """
    low, high = config.limits_px
    validity = np.full(disparity_px.shape, Validity.MEASURED, np.uint8)
    disparity = np.asarray(disparity_px, np.float32)
    if config.subpixel:  # the step of a DisparityImage
        disparity = np.rint(disparity / SUBPIXEL_STEP_PX, dtype=np.float32) * SUBPIXEL_STEP_PX
    disparity = disparity.astype(np.float32, copy=False)
    outside = (disparity < low) | (disparity > high)
    column = np.arange(disparity.shape[1], dtype=np.float32)
    partner = np.where(np.isfinite(disparity), column - disparity, -1).astype(np.float32)
    out_of_view = (partner < -0.5) | (partner > disparity.shape[1] - 0.5)
    ncc, texture, seen = _agreement(left, right, partner, config.correlation_window_size)
    textured = texture >= config.texture_threshold
    variance = np.full(disparity.shape, COMMON_SIGMA_PX**2, np.float32)
    variance += np.where(textured, UNLIKE_SIGMA_PX * (1 - ncc), UNLIKE_SIGMA_PX) ** 2
    conflict = out_of_view | (textured & (ncc <= LEAST_NCC))
    if right_disparity_px is not None and config.disp12_max_diff >= 0:
        difference = np.abs(_moved(right_disparity_px, partner, cv2.INTER_NEAREST) - disparity)
        conflict |= ~(difference <= config.disp12_max_diff)
        variance += (DIFFERENCE_FACTOR * np.nan_to_num(difference)) ** 2
    validity[conflict] = Validity.CONFLICT
    validity[~np.isfinite(disparity)] = Validity.AMBIGUOUS
    validity[outside] = Validity.AT_LIMIT
    validity[np.isnan(left) | (~seen & ~out_of_view & ~outside)] = Validity.NO_DATA
    rejected = validity != Validity.MEASURED
    sigma = np.where(rejected, np.nan, np.sqrt(variance)).astype(np.float32)
    return Match(
        np.where(rejected, np.float32(np.nan), disparity), confidence_from_sigma(sigma), validity
    )


def _agreement(
    left: FloatImage, right: FloatImage, partner: FloatImage, side: int
) -> tuple[FloatImage, FloatImage, Mask]:
    """Return NCC of the windows, the standard deviation of the left one, and where both have data.

    All (H, W); ``partner`` is the column of each pixel in the right image.
    """
    moved = _moved(right, partner, cv2.INTER_LINEAR)
    seen = np.isfinite(moved)
    known = (np.isfinite(left) & seen).astype(np.float32)
    weight = np.maximum(window_mean(known, side), 1e-6)
    centre = np.float32(np.nanmean(left)) if np.isfinite(left).any() else np.float32(0)
    a, b = (np.where(known > 0, image - centre, 0).astype(np.float32) for image in (left, moved))

    def covariance(first: FloatImage, second: FloatImage) -> FloatImage:
        means = window_mean(first, side) * window_mean(second, side) / weight**2
        value: FloatImage = window_mean(first * second, side) / weight - means
        return value

    own = np.maximum(covariance(a, a), 0)
    other = np.maximum(covariance(b, b), 0)
    ncc = covariance(a, b) / np.sqrt(np.maximum(own * other, 1e-6))
    return np.clip(ncc, -1, 1), np.sqrt(own), seen


def _moved(image: FloatImage, partner: FloatImage, interpolation: int) -> FloatImage:
    """Return the values at the columns ``partner`` of each row; NaN outside of the image."""
    columns = image.shape[1]
    if interpolation == cv2.INTER_NEAREST:
        low = high = np.rint(partner).astype(np.intp)
        share = np.zeros_like(partner)
    else:
        low = np.floor(partner).astype(np.intp)
        high, share = low + 1, partner - low
    inside = (partner >= -0.5) & (partner <= columns - 0.5)
    first, second = (
        np.take_along_axis(image, at.clip(0, columns - 1), axis=1) for at in (low, high)
    )
    value = np.where(share > 0, first + share * (second - first), first)
    return np.where(inside, value, np.float32(np.nan)).astype(np.float32)
