# SPDX-License-Identifier: Apache-2.0
"""What both cameras see, by the ground truth of one image or of both."""

from __future__ import annotations

import numpy as np

from binocular_recon.images import FloatImage, Mask


def visible_from_truth(truth_px: FloatImage, tolerance_px: float = 1.0) -> Mask:
    """Return which pixels the right camera sees too, as far as a dense ground truth tells.

    A pixel is occluded if it falls outside the right image or if a pixel of its row with a
    disparity larger by more than ``tolerance_px`` falls on the same place of the right image.

    Parameters
    ----------
    truth_px : (H, W) float32
        Ground truth of the left image.
    tolerance_px : float
        Smaller steps of disparity do not hide anything.

    Returns
    -------
    (H, W) bool
        False also where the ground truth is unknown.

    """
    rows, width = truth_px.shape
    row, column = np.nonzero(np.isfinite(truth_px))
    truth = truth_px[row, column].astype(np.float64)
    target = column - truth
    # the nearest surface at each pixel of the right image; a point covers both its neighbours
    nearest = np.full((rows, width + 1), -np.inf)
    low = np.floor(target).astype(np.intp)
    inside = (target >= -0.5) & (target <= width - 0.5)
    for cell in (low, low + 1):
        usable = inside & (cell >= 0) & (cell <= width)
        np.maximum.at(nearest, (row[usable], cell[usable]), truth[usable])
    cell = np.clip(np.rint(target).astype(np.intp), 0, width)
    visible = np.zeros(truth_px.shape, bool)
    visible[row, column] = inside & (nearest[row, cell] <= truth + tolerance_px)
    return visible


def visible_from_both(
    truth_px: FloatImage, right_truth_px: FloatImage, tolerance_px: float = 1.0
) -> Mask:
    """Return which pixels the right camera sees too: the ground truth of both images agrees there.

    Parameters
    ----------
    truth_px, right_truth_px : (H, W) float32
        Ground truth x_left - x_right of the pixels of the left and of the right image.
    tolerance_px : float
        Largest difference of the two.

    Returns
    -------
    (H, W) bool
        False also where a ground truth is unknown.

    """
    landed = np.arange(truth_px.shape[1]) - truth_px
    inside = (landed > -0.5) & (landed < truth_px.shape[1] - 0.5)
    cell = np.rint(np.where(inside, landed, 0)).astype(np.intp)
    there = np.take_along_axis(right_truth_px, cell, axis=1)
    return np.asarray(inside & (np.abs(there - truth_px) <= tolerance_px))
