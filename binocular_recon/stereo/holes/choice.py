# SPDX-License-Identifier: Apache-2.0
"""Choice: a hole pixel takes the surface that the image continues, where that is clear."""

from __future__ import annotations

import cv2
import numpy as np

from binocular_recon._jit import over_strips
from binocular_recon._simd import LANES
from binocular_recon.images import FloatImage, Mask
from binocular_recon.stereo.holes._choice_kernels import (
    Costs,
    compare_ends_of_columns,
    compare_ends_of_rows,
    take_cheaper,
)

# What the fill costs must exceed the least cost by these factors, in holes that half-occlusion
# explains and in others, and by this constant, before it is replaced.
OCCLUDED, UNEXPLAINED, LEAST = 3.0, 2.0, 0.3
# Standard deviation of the grey levels that costs refer to, so that exposure does not matter.
CONTRAST = 50.0


def follow_image(
    measured_px: FloatImage, filled_px: FloatImage, guide: FloatImage, unexplained: Mask
) -> None:
    """Replace filled disparities, in place, by those of surfaces that the image continues.

    Parameters
    ----------
    measured_px : (H, W) float32
        Disparity; NaN = none.
    filled_px : (H, W) float32
        Disparity of every pixel.
    guide : (H, W) float32
        Grey levels of the left image; NaN = no data.
    unexplained : (H, W) bool
        From `unexplained_holes`.

    Notes
    -----
    The candidates of a pixel are the nearest measured ones in its row and in its column. A
    candidate is cheap if it is near, of a similar grey level, and no edge lies between. A fill of
    which no candidate is nearly as cheap as the cheapest one is replaced by that.

    """
    known = np.isfinite(guide)
    deviation = float(cv2.meanStdDev(guide, mask=known.view(np.uint8))[1].item())
    scale = np.float32(CONTRAST / deviation if deviation > 0 else 1)
    levels = cv2.GaussianBlur(np.where(known, guide, 0) * scale, (3, 3), 0.8)
    (height, width), images = measured_px.shape, (measured_px, filled_px, levels)
    costs = Costs(*(np.empty((height, width + LANES), np.float32) for _ in Costs._fields))
    over_strips(compare_ends_of_rows, height, *images, costs)
    wide = (cv2.copyMakeBorder(image, 0, 0, 0, LANES, cv2.BORDER_CONSTANT) for image in images)
    over_strips(compare_ends_of_columns, width, *wide, costs, strip=128)
    limits = LEAST, OCCLUDED, UNEXPLAINED
    over_strips(take_cheaper, height, measured_px, costs, unexplained, limits, filled_px)
