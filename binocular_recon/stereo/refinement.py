# SPDX-License-Identifier: Apache-2.0
"""Refinement: disparities are smoothed along planes."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from binocular_recon._jit import over_strips
from binocular_recon._simd import LANES
from binocular_recon.stereo._refinement_kernels import BORDER, border_strip, plane_strip
from binocular_recon.stereo.completion import fill_from_background

FloatImage = npt.NDArray[np.float32]

# Standard deviation of a smooth disparity: what all pixels share (interpolation, rectification),
# and a factor on what planes leave (errors of neighbours are alike). From Motorcycle, cones and
# teddy, whose pixels' errors rise from 0.15 to 0.45 px with what planes leave.
COMMON_SIGMA_PX = 0.15
RESIDUAL_FACTOR = 1.5
# Samples farther than this from a pixel's disparity belong to another surface.
SAME_SURFACE_PX = 1.5


def smooth(disparity_px: FloatImage) -> tuple[FloatImage, FloatImage]:
    """Replace each disparity by a plane's through its neighbours on the same surface.

    Parameters
    ----------
    disparity_px : (H, W) float32
        Disparity; NaN = none.

    Returns
    -------
    smooth_px : (H, W) float32
        NaN where ``disparity_px`` is.
    sigma_px : (H, W) float32
        Its standard deviation, from what the planes leave; NaN = none.

    Notes
    -----
    A median takes off single errors first. Planes, not means: surfaces are rarely parallel to the
    pictures.

    """
    height, width = disparity_px.shape
    median = cv2.medianBlur(fill_from_background(disparity_px), 5)
    bordered = np.empty((height + 2 * BORDER, width + 2 * BORDER + LANES), np.float32)
    bordered[:BORDER] = bordered[BORDER + height :] = np.nan
    over_strips(
        lambda start, stop: border_strip(disparity_px, median, bordered, start, stop), height
    )
    plane = np.empty((height, width + LANES), np.float32)
    sigma = np.empty((height, width + LANES), np.float32)

    def fit(start: int, stop: int) -> None:
        plane_strip(bordered, SAME_SURFACE_PX, plane, sigma, start, stop)
        rows = sigma[start:stop, :width]
        rows *= np.float32(RESIDUAL_FACTOR**2)
        rows += np.float32(COMMON_SIGMA_PX**2)
        np.sqrt(rows, out=rows)

    over_strips(fit, height)
    return plane[:, :width].copy(), sigma[:, :width].copy()
