# SPDX-License-Identifier: Apache-2.0
"""Completion: pixels without a match take the disparity of the background."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
import numpy.typing as npt

from binocular_recon._jit import over_strips
from binocular_recon.images import FloatImage, Mask
from binocular_recon.stereo.holes._hole_kernels import (
    complete_strip,
    continue_slopes,
    fill_background_strip,
    fill_nearest_strip,
    keep_confident,
    mark_unexplained,
    raise_to_columns,
)
from binocular_recon.stereo.holes.choice import follow_image

# Confidence of a completed pixel: a standard deviation of about 1 px (see `stereo.confidence`).
COMPLETED_CONFIDENCE = 0.06
# Half-occluded regions are matched this much too wide, because windows reach across the edge.
OCCLUSION_SLACK_PX = 8
# The slope of a row is taken from this many pixels next to its hole, without those that are off by
# more than the tolerance and the steepest slope; then the median over this many rows.
SLOPE_PX = 30
SLOPE_TOLERANCE_PX = 1.5
STEEPEST_SLOPE = 0.08
SLOPE_ROWS = 61


def complete(
    disparity_px: FloatImage,
    confidence: FloatImage,
    guide: FloatImage | None = None,
    *,
    extrapolate: bool = False,
    unexplained: Mask | None = None,
) -> tuple[FloatImage, FloatImage]:
    """Complete a disparity map before it is filtered.

    Parameters
    ----------
    disparity_px : (H, W) float32
        Disparity; NaN = none.
    confidence : (H, W) float32
        Confidence of each pixel; 0 or NaN = none, above 1 counts as 1.
    guide : (H, W) float32, optional
        Grey levels of the left image, for `choice.follow_image`.
    extrapolate : bool
        Whether columns that the right camera does not see continue the slope of the surface next
        to them.
    unexplained : (H, W) bool, optional
        From `unexplained_holes`, if it is known.

    Returns
    -------
    disparity_px : (H, W) float32
        Holes are filled from the background along rows and smoothed across rows by a median;
        measured disparities are kept. In runs that half-occlusion does not explain, the background
        along the column is taken where it is nearer; where the image clearly continues another
        surface, that one. All NaN if nothing was measured.
    confidence : (H, W) float32
        `COMPLETED_CONFIDENCE` in holes.

    """
    rows, measured = len(disparity_px), np.empty_like(disparity_px)
    over_strips(keep_confident, rows, disparity_px, confidence, measured)
    filled = fill_from_background(measured)
    if unexplained is None:
        unexplained = unexplained_holes(measured)
    over_strips(raise_to_columns, filled.shape[1], measured, unexplained, filled, strip=128)
    if np.isnan(filled[0, 0]):
        return filled, np.zeros_like(confidence)
    if guide is not None:
        follow_image(measured, filled, guide, unexplained)
    if extrapolate:
        _extrapolate(measured, filled)
    smooth, weight = cv2.medianBlur(filled, 5), np.empty_like(filled)
    images = measured, confidence, smooth, COMPLETED_CONFIDENCE, filled, weight
    over_strips(complete_strip, rows, *images)
    return filled, weight


def fill_from_background(disparity_px: FloatImage) -> FloatImage:
    """Fill holes along rows.

    Parameters
    ----------
    disparity_px : (H, W) float32
        Disparity; NaN = none.

    Returns
    -------
    filled_px : (H, W) float32
        Each hole of a row has the smaller disparity of its two ends, at the image border that of
        its only one, because half-occluded surfaces lie behind what occludes them. A row without
        any disparity is a copy of the nearest row with one; all NaN if there is none.

    """
    return _filled_rows(fill_background_strip, disparity_px)


def fill_from_nearest(disparity_px: FloatImage) -> FloatImage:
    """Fill each hole with the nearest disparity of its row; of two equally near, the left one.

    Takes and returns the same arrays as `fill_from_background`, also for rows without disparities.
    """
    return _filled_rows(fill_nearest_strip, disparity_px)


def _filled_rows(fill_strip: Callable[..., None], disparity_px: FloatImage) -> FloatImage:
    disparity_px = np.ascontiguousarray(disparity_px)
    filled = np.empty_like(disparity_px)
    over_strips(fill_strip, len(filled), disparity_px, filled)
    copy_nearest_rows(filled, empty=np.isnan(filled[:, 0]))
    return filled


def copy_nearest_rows(image: FloatImage, *, empty: Mask) -> None:
    """Replace empty rows, in place, by copies of the nearest other row."""
    rows, gaps = np.flatnonzero(~empty), np.flatnonzero(empty)
    if gaps.size and rows.size:
        image[gaps] = image[rows[np.abs(gaps[:, None] - rows).argmin(axis=1)]]


def unexplained_holes(disparity_px: FloatImage) -> Mask:
    """Return where holes are wider, along rows, than half-occlusion explains.

    Parameters
    ----------
    disparity_px : (H, W) float32
        Disparity; NaN = none.

    Returns
    -------
    unexplained : (H, W) bool
        A half-occluded region is as wide as the disparity rises from its left end to its right
        end. Holes that are wider by more than `OCCLUSION_SLACK_PX` have another cause, most often
        low texture.

    """
    unexplained = np.empty(disparity_px.shape, np.bool_)
    rows, disparity_px = len(unexplained), np.ascontiguousarray(disparity_px)
    over_strips(mark_unexplained, rows, disparity_px, OCCLUSION_SLACK_PX, unexplained)
    return unexplained


def _extrapolate(measured_px: FloatImage, filled_px: FloatImage) -> None:
    """Continue slopes, in place, into the columns on the left that the right camera does not see.

    The slope is the median of nearby rows, reduced as these differ, down to 0 where their spread
    (1.48 times the median absolute deviation, a robust standard deviation) reaches it.
    """
    known = ~np.isnan(measured_px)
    first = known.argmax(axis=1)
    start = np.take_along_axis(measured_px, first[:, None], 1)[:, 0]
    rows = np.flatnonzero((first > 0) & (first <= start + OCCLUSION_SLACK_PX))
    if not rows.size:
        return
    from scipy.ndimage import median_filter  # slow to import, and seldom needed

    slopes = _row_slopes(measured_px[rows], first[rows])
    slope = median_filter(slopes, SLOPE_ROWS)
    spread = 1.48 * median_filter(np.abs(slopes - slope), SLOPE_ROWS)
    slope *= 1 - np.minimum(spread / np.maximum(np.abs(slope), 1e-6), 1) ** 2
    limits = np.array([filled_px.min(), filled_px.max()])  # those of what was measured
    continue_slopes(rows, first[rows], start[rows], slope, limits, filled_px)


def _row_slopes(measured_px: FloatImage, first: npt.NDArray[np.intp]) -> FloatImage:
    """Return the slope of each row in the pixels from ``first`` on; 0 where these are too few."""
    x = np.arange(SLOPE_PX, dtype=np.float32)
    columns = first[:, None] + np.arange(SLOPE_PX)
    inside = columns < measured_px.shape[1]
    values = np.take_along_axis(measured_px, np.where(inside, columns, first[:, None]), 1)
    step = values - values[:, :1]
    used = inside & (np.abs(step) <= SLOPE_TOLERANCE_PX + STEEPEST_SLOPE * x)
    count = np.count_nonzero(used, axis=1)
    step = np.where(used, step, 0)
    mean_x, mean_step = np.where(used, x, 0).sum(1) / count, step.sum(1) / count
    spread = np.where(used, x * x, 0).sum(1) / count - mean_x**2
    shared = (step * x).sum(1) / count - mean_x * mean_step
    slopes = np.where(count >= SLOPE_PX // 2, shared / np.maximum(spread, 1), 0)
    return slopes.astype(np.float32)
