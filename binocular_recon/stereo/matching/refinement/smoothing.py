# SPDX-License-Identifier: Apache-2.0
"""Smoothing: medians, then planes through the disparities of a surface."""

from __future__ import annotations

import cv2
import numpy as np

from binocular_recon._jit import over_strips
from binocular_recon._simd import LANES
from binocular_recon.images import ByteImage, FloatImage
from binocular_recon.stereo.holes.completion import fill_from_background
from binocular_recon.stereo.matching._preparation import exposure_gain
from binocular_recon.stereo.matching.refinement._smoothing_kernels import (
    BORDER,
    MEDIAN_BORDER,
    MEDIAN_SPACING,
    WIDE_SPACING,
    plane_strip,
    weighted_median_strip,
)

# Standard deviation of a smoothed disparity: a constant (interpolation, rectification), and a
# factor on the residuals of the plane (errors of neighbours are correlated). Measured on
# Motorcycle, cones and teddy, where errors rise from 0.15 to 0.45 px with the residuals.
COMMON_SIGMA_PX = 0.15
RESIDUAL_FACTOR = 1.5
# Of 3x3 windows, which do not overlap at the spacing of the samples: errors are not correlated.
RESIDUAL_FACTOR_3X3 = 1.0
# Samples whose disparity differs by more than this belong to another surface.
SAME_SURFACE_PX = 1.5
# Weighted median: difference of grey levels that halves a weight, and the difference from the
# median above which a disparity is replaced.
SAME_OBJECT_LEVELS = 16.0
WRONG_PX = 1.0
WRONG_SIDE_PX = 2.0


def smooth(
    disparity_px: FloatImage, left: FloatImage, near_edges: ByteImage | None = None
) -> tuple[FloatImage, FloatImage]:
    """Replace each disparity by the value of a plane through its neighbours on the same surface.

    Parameters
    ----------
    disparity_px : (H, W) float32
        Disparity; NaN = none.
    left : (H, W) float32
        Left image, grey levels.
    near_edges : ((H + 1) // 2, (W + 1) // 2) uint8, optional
        At half resolution, 1 where disparities may be on the wrong side of an edge. Given, only
        these are replaced by the weighted median, and only if they differ from it by more than
        `WRONG_SIDE_PX`; and disparities are those of windows of 3x3 px.

    Returns
    -------
    smooth_px : (H, W) float32
        NaN where ``disparity_px`` is.
    sigma_px : (H, W) float32
        Its standard deviation, from the residuals of the planes; NaN = none.

    Notes
    -----
    Two medians come first. One removes single errors. The other weights pixels by the similarity
    of their grey levels, which moves the edges of objects, widened by the correlation window, to
    where the image has them (Z. Ma et al., "Constant time weighted median filtering for stereo
    matching and beyond", ICCV 2013). Planes and not means, because surfaces are rarely parallel to
    the image plane.

    """
    height, width = disparity_px.shape
    if near_edges is None:
        side, spacing, wrong, factor = 5, MEDIAN_SPACING, WRONG_PX, RESIDUAL_FACTOR
        where = np.empty((0, 0), np.uint8)  # everywhere
    else:
        side, spacing, wrong, factor = 3, WIDE_SPACING, WRONG_SIDE_PX, RESIDUAL_FACTOR_3X3
        where = near_edges
    filled = cv2.medianBlur(fill_from_background(disparity_px), side)
    # relative to the contrast of the image, so that the exposure does not matter
    softness = SAME_OBJECT_LEVELS / exposure_gain(left)
    images = _bordered(filled), _bordered(left), disparity_px
    samples = np.empty((height + 2 * BORDER, width + 2 * BORDER + LANES), np.float32)
    over_strips(weighted_median_strip, height, images, where, spacing, softness, wrong, samples)
    results = np.empty((height, width), np.float32), np.empty((height, width), np.float32)
    terms = factor**2, COMMON_SIGMA_PX**2
    over_strips(plane_strip, height, samples, SAME_SURFACE_PX, terms, results)
    return results


def _bordered(image: FloatImage) -> FloatImage:
    """Return an image with a border of NaN for the windows of medians, and spare lanes."""
    borders = MEDIAN_BORDER, MEDIAN_BORDER, MEDIAN_BORDER, MEDIAN_BORDER + 2 * LANES
    bordered = cv2.copyMakeBorder(image, *borders, cv2.BORDER_CONSTANT, value=np.nan)
    return np.asarray(bordered, np.float32)
