# SPDX-License-Identifier: Apache-2.0
"""Rejection: speckles and flying pixels are dropped."""

from __future__ import annotations

import cv2
import numpy as np

from binocular_recon._jit import over_strips
from binocular_recon._simd import LANES
from binocular_recon.config import MatchConfig
from binocular_recon.images import FloatImage
from binocular_recon.stereo.matching.refinement._rejection_kernels import (
    drop_between_strip,
    drop_negative,
    quantise,
)

# Flying pixels: radius of the window, the least step of disparity within it that makes it an edge,
# and the largest difference of pixels on the same surface.
WINDOW_PX, EDGE_PX, ALIKE_PX = 3, 2.0, 1.5


def drop_speckles(disparity_px: FloatImage, config: MatchConfig) -> None:
    """Set connected regions of fewer than ``speckle_size`` pixels to NaN, in place."""
    if config.speckle_size == 0:
        return
    # cv2.filterSpeckles takes int16: as many steps per px as let every disparity fit
    steps = min(16, 32000 // config.disparity_range)
    whole = np.empty(disparity_px.shape, np.int16)
    over_strips(quantise, len(whole), disparity_px, config.min_disparity - 1.0, steps, whole)
    cv2.filterSpeckles(whole, -1, config.speckle_size, config.speckle_range * steps)
    over_strips(drop_negative, len(whole), whole, disparity_px)


def drop_flying(disparity_px: FloatImage, sigma_px: FloatImage, config: MatchConfig) -> None:
    """Set pixels between the two surfaces of an edge to NaN, in place.

    Where a window sees two surfaces, its best match may lie between them. Such pixels have fewer
    than ``edge_support`` others of similar disparity around, on an edge of disparity.
    """
    if config.edge_support == 0:
        return
    border = 4 * [WINDOW_PX]
    border[3] += 2 * LANES
    padded = cv2.copyMakeBorder(disparity_px, *border, cv2.BORDER_CONSTANT, value=np.nan)
    limits = WINDOW_PX, EDGE_PX, ALIKE_PX, config.edge_support
    rows = len(disparity_px)
    over_strips(drop_between_strip, rows, padded, limits, disparity_px, sigma_px)
