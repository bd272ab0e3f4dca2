# SPDX-License-Identifier: Apache-2.0
"""Completion: pixels without a match take the background's disparity."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from binocular_recon._jit import over_strips
from binocular_recon.stereo._refinement_kernels import (
    fill_strip,
    mark_unexplained,
    raise_to_columns,
)

FloatImage = npt.NDArray[np.float32]

# Confidence of a completed pixel: a standard deviation of about 1 px (see `matching`).
COMPLETED_CONFIDENCE = 0.06
# How much wider than its cause a run of hidden pixels is: windows see a border from afar.
HIDDEN_SLACK_PX = 8


def complete(disparity_px: FloatImage, confidence: FloatImage) -> tuple[FloatImage, FloatImage]:
    """Complete a disparity map before it is filtered.

    Parameters
    ----------
    disparity_px : (H, W) float32
        Disparity; NaN = none.
    confidence : (H, W) float32
        Confidence of each pixel; 0 = none.

    Returns
    -------
    disparity_px : (H, W) float32
        Holes filled from the background along rows and smoothed across them by a median; measured
        disparities are kept. A run wider than what the step between its ends hides takes the
        background along the column if that is nearer. All NaN if nothing was measured.
    confidence : (H, W) float32
        `COMPLETED_CONFIDENCE` in holes.

    """
    holes = np.isnan(disparity_px) | ~(confidence > 0)
    measured = np.where(holes, np.float32(np.nan), disparity_px)
    filled = fill_from_background(measured)
    unexplained = np.empty(filled.shape, np.bool_)
    over_strips(
        lambda start, stop: mark_unexplained(measured, HIDDEN_SLACK_PX, unexplained, start, stop),
        len(filled),
    )
    over_strips(
        lambda start, stop: raise_to_columns(measured, unexplained, filled, start, stop),
        filled.shape[1],
        strip=128,
    )
    if np.isnan(filled[0, 0]):
        return filled, np.zeros_like(confidence)
    smooth = np.where(holes, cv2.medianBlur(filled, 5), filled)
    return smooth, np.where(holes, np.float32(COMPLETED_CONFIDENCE), confidence)


def fill_from_background(disparity_px: FloatImage) -> FloatImage:
    """Fill holes along rows.

    Parameters
    ----------
    disparity_px : (H, W) float32
        Disparity; NaN = none.

    Returns
    -------
    filled_px : (H, W) float32
        Each run of holes has the smaller disparity of its two ends, at the picture's border that
        of its only one: what a pair does not see twice lies behind what hides it. A row without
        any disparity takes the nearest row that has one; all NaN if there is none.

    """
    filled = np.empty_like(disparity_px)
    over_strips(lambda start, stop: fill_strip(disparity_px, filled, start, stop), len(filled))
    empty = np.isnan(filled[:, 0])
    if empty.any() and not empty.all():
        rows = np.flatnonzero(~empty)
        nearest = np.abs(np.flatnonzero(empty)[:, None] - rows).argmin(axis=1)
        filled[empty] = filled[rows[nearest]]
    return filled
