# SPDX-License-Identifier: Apache-2.0
"""Refinement: disparities are smoothed along planes."""

from __future__ import annotations

import cv2
import numpy as np

from binocular_recon._jit import over_strips
from binocular_recon._simd import LANES
from binocular_recon.images import FloatImage
from binocular_recon.stereo.holes.completion import fill_from_background
from binocular_recon.stereo.matching._layout import exposure_gain
from binocular_recon.stereo.matching._refinement_kernels import (
    BORDER,
    MEDIAN_BORDER,
    plane_strip,
    put_inside,
    weighted_median_strip,
)

# Standard deviation of a smooth disparity: what all pixels share (interpolation, rectification),
# and a factor on what planes leave (errors of neighbours are alike). From Motorcycle, cones and
# teddy, whose pixels' errors rise from 0.15 to 0.45 px with what planes leave.
COMMON_SIGMA_PX = 0.15
RESIDUAL_FACTOR = 1.5
# Samples farther than this from a pixel's disparity belong to another surface.
SAME_SURFACE_PX = 1.5
# Weighted median: step of grey level that halves a weight, and from where a disparity is wrong.
SAME_OBJECT_LEVELS = 16.0
WRONG_PX = 1.0


def smooth(disparity_px: FloatImage, left: FloatImage) -> tuple[FloatImage, FloatImage]:
    """Replace each disparity by a plane's through its neighbours on the same surface.

    Parameters
    ----------
    disparity_px : (H, W) float32
        Disparity; NaN = none.
    left : (H, W) float32
        Left picture.

    Returns
    -------
    smooth_px : (H, W) float32
        NaN where ``disparity_px`` is.
    sigma_px : (H, W) float32
        Its standard deviation, from what the planes leave; NaN = none.

    Notes
    -----
    Medians come first. One takes off single errors. The other weighs pixels by how like in grey
    level they are, which moves borders of objects, widened by correlation windows, to where the
    picture has them (Z. Ma et al., "Constant time weighted median filtering for stereo matching
    and beyond", ICCV 2013). Planes, not means: surfaces are rarely parallel to the pictures.

    """
    height, width = disparity_px.shape
    filled = cv2.medianBlur(fill_from_background(disparity_px), 5)
    # levels of a picture whose contrast does not change with the exposure
    softness = SAME_OBJECT_LEVELS / exposure_gain(left)
    values = _inside(filled, filled, MEDIAN_BORDER)
    guide = _inside(left, left, MEDIAN_BORDER)
    median = np.empty((height, width + LANES), np.float32)
    over_strips(
        lambda start, stop: weighted_median_strip(
            values, guide, softness, WRONG_PX, median, start, stop
        ),
        height,
    )
    samples = _inside(median[:, :width], disparity_px, BORDER)
    plane = np.empty((height, width + LANES), np.float32)
    sigma = np.empty((height, width + LANES), np.float32)

    def fit(start: int, stop: int) -> None:
        plane_strip(samples, SAME_SURFACE_PX, plane, sigma, start, stop)
        rows = sigma[start:stop, :width]
        rows *= np.float32(RESIDUAL_FACTOR**2)
        rows += np.float32(COMMON_SIGMA_PX**2)
        np.sqrt(rows, out=rows)

    over_strips(fit, height)
    return plane[:, :width].copy(), sigma[:, :width].copy()


def _inside(values: FloatImage, shown: FloatImage, border: int) -> FloatImage:
    """Return values, where ``shown`` is not NaN, inside a border of NaN and spare lanes."""
    height, width = values.shape
    bordered = np.empty((height + 2 * border, width + 2 * border + LANES), np.float32)
    over_strips(
        lambda start, stop: put_inside(values, shown, border, bordered, start, stop), height
    )
    return bordered
