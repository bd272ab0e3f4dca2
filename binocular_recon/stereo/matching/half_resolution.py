# SPDX-License-Identifier: Apache-2.0
"""Half resolution: where noise hides texture, its average over pixels can still be matched."""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np

from binocular_recon._jit import over_strips
from binocular_recon.config import MatchConfig
from binocular_recon.images import FloatImage
from binocular_recon.stereo.holes import count_holes, fill_holes
from binocular_recon.stereo.holes.completion import unexplained_holes

# Texture is weak if a region of this share of the picture has no match and is not hidden.
LEAST_REGION = 0.01
# A hole is weak texture if half resolution sees this share of it; what is hidden from one picture
# is hidden at half resolution too.
LEAST_SHARE = 0.5


def has_weak_texture(disparity_px: FloatImage) -> bool:
    """Whether a region that could not be matched is large and not hidden from the right camera.

    Parameters
    ----------
    disparity_px : (H, W) float32
        Disparity; NaN = none.

    """
    # every second row and column show regions of that size
    holes = unexplained_holes(disparity_px)[::2, ::2].astype(np.uint8)
    _, _, regions, _ = cv2.connectedComponentsWithStats(holes, connectivity=4)
    largest = regions[1:, cv2.CC_STAT_AREA].max(initial=0)  # the first is what has a match
    return bool(largest >= LEAST_REGION * holes.size)


def halve(image: FloatImage) -> FloatImage:
    """Return a picture at half resolution; a pixel near one without data has none."""
    half: FloatImage = cv2.pyrDown(image)
    return half


def half_config(config: MatchConfig) -> MatchConfig:
    """Return the options that match pictures of half resolution."""
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
        Smaller holes stay.

    """
    holes = np.isnan(disparity_px).astype(np.uint8)
    count, labels = cv2.connectedComponents(holes, connectivity=4)
    area, seen = np.zeros(count, np.int64), np.zeros(count, np.int64)
    count_holes(disparity_px, half_disparity_px, labels, area, seen)
    fill = (seen >= LEAST_SHARE * area) & (area >= least_hole)
    fill[0] = False  # no hole
    over_strips(
        lambda start, stop: fill_holes(
            labels[start:stop],
            fill,
            (half_disparity_px[start // 2 :], half_sigma_px[start // 2 :]),
            (disparity_px[start:stop], sigma_px[start:stop]),
        ),
        len(labels),
        strip=64,
    )
