# SPDX-License-Identifier: Apache-2.0
"""Half resolution: averaging over pixels reduces noise, so that lower texture can be matched."""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np

from binocular_recon._jit import over_strips
from binocular_recon.config import MatchConfig
from binocular_recon.images import FloatImage
from binocular_recon.stereo.holes import copy_from_half, count_hole_pixels, unexplained_holes

# An image has low texture if an unmatched region of this share of it is not half-occluded.
LEAST_REGION = 0.01
# A hole is filled if half resolution covers this share of it: then low texture is its cause,
# because half-occluded pixels have no match at half resolution either.
LEAST_SHARE = 0.5


def has_low_texture(disparity_px: FloatImage) -> bool:
    """Return whether there is a large unmatched region that half-occlusion does not explain.

    Parameters
    ----------
    disparity_px : (H, W) float32
        Disparity; NaN = none.

    """
    # every second row and column suffice for regions of that size
    holes = unexplained_holes(disparity_px)[::2, ::2].astype(np.uint8)
    _, _, regions, _ = cv2.connectedComponentsWithStats(holes, connectivity=4)
    largest = regions[1:, cv2.CC_STAT_AREA].max(initial=0)  # the first is the background
    return bool(largest >= LEAST_REGION * holes.size)


def halve(image: FloatImage) -> FloatImage:
    """Return an image at half resolution; NaN where any pixel of the kernel has no data."""
    half: FloatImage = cv2.pyrDown(image)
    return half


def half_config(config: MatchConfig) -> MatchConfig:
    """Return the options for matching at half resolution."""
    first = config.min_disparity // 2
    last = -(-(config.min_disparity + config.disparity_range - 1) // 2)
    return dataclasses.replace(
        config,
        min_disparity=first,
        disparity_range=last - first + 1,
        speckle_size=config.speckle_size // 4,
        half_resolution=False,
    )


def fill_from_half(
    disparity_px: FloatImage,
    sigma_px: FloatImage,
    half_disparity_px: FloatImage,
    half_sigma_px: FloatImage,
    least_hole: int,
) -> None:
    """Fill holes, in place, from the match at half resolution.

    Parameters
    ----------
    disparity_px, sigma_px : (H, W) float32
        Disparity and its standard deviation; NaN = none.
    half_disparity_px, half_sigma_px : ((H + 1) // 2, (W + 1) // 2) float32
        The same at half resolution, in its pixels.
    least_hole : int
        Holes of fewer pixels are not filled.

    """
    holes = np.isnan(disparity_px).astype(np.uint8)
    count, labels = cv2.connectedComponents(holes, connectivity=4)
    area, covered = np.zeros(count, np.int64), np.zeros(count, np.int64)
    count_hole_pixels(disparity_px, half_disparity_px, labels, area, covered)
    fill = (covered >= LEAST_SHARE * area) & (area >= least_hole)
    fill[0] = False  # label 0 is not a hole
    over_strips(
        lambda start, stop: copy_from_half(
            labels[start:stop],
            fill,
            (half_disparity_px[start // 2 :], half_sigma_px[start // 2 :]),
            (disparity_px[start:stop], sigma_px[start:stop]),
        ),
        len(labels),
        strip=64,
    )
