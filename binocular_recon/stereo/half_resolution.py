# SPDX-License-Identifier: Apache-2.0
"""Half resolution: where noise hides texture, its average over pixels can still be matched."""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np
import numpy.typing as npt

from binocular_recon.config import MatchConfig

FloatImage = npt.NDArray[np.float32]

# A hole is weak texture if half resolution sees this share of it; what is hidden from one picture
# is hidden at half resolution too.
LEAST_SHARE = 0.5


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
    height, width = disparity_px.shape
    size = (2 * half_disparity_px.shape[1], 2 * half_disparity_px.shape[0])
    disparity, sigma = (
        cv2.resize(2 * half, size, interpolation=cv2.INTER_NEAREST)[:height, :width]
        for half in (half_disparity_px, half_sigma_px)
    )
    count, label, stats, _ = cv2.connectedComponentsWithStats(
        np.isnan(disparity_px).astype(np.uint8), connectivity=4
    )
    seen = np.isfinite(disparity)
    area = stats[:, cv2.CC_STAT_AREA]
    share = np.bincount(label[seen], minlength=count) / np.maximum(area, 1)
    fill = (share >= LEAST_SHARE) & (area >= least_hole)
    fill[0] = False  # no hole
    chosen = fill[label] & seen
    disparity_px[chosen] = disparity[chosen]
    sigma_px[chosen] = sigma[chosen]
