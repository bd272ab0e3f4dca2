# SPDX-License-Identifier: Apache-2.0
"""The frames of a rig that stands still, averaged pixel by pixel.

Noise of the images differs from frame to frame, and its share of the error falls with their
number. What the matching makes of the texture, and the calibration, are the same in all frames:
these shares stay. How much a disparity varies from frame to frame says which share is which.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from binocular_recon._jit import over_strips
from binocular_recon.images import FloatImage, Mask
from binocular_recon.merging._over_time_kernels import average_pixels

# The variance over time is a mean over squares of so many pixels a side: that of one pixel in few
# frames says little.
POOL_PX = 9
_STRIP = 4096


@dataclass(frozen=True, eq=False)
class TimeAverage:
    """The largest group of agreeing values of each pixel.

    Attributes
    ----------
    disparity_px : (h, W) float32
        Their mean; NaN = no value.
    variance_px2, stated_px2 : (h, W) float32
        Their variance, and the mean of what was stated for them.
    agreeing, count : (h, W) float32
        How many they are, and how many values there are.

    """

    disparity_px: FloatImage
    variance_px2: FloatImage
    stated_px2: FloatImage
    agreeing: FloatImage
    count: FloatImage

    def most_of(self, count: FloatImage | int) -> Mask:
        """Return where more than half of so many values agree, (h, W) bool."""
        most: Mask = 2 * self.agreeing > count
        return most


def average(disparities_px: FloatImage, sigmas_px: FloatImage) -> TimeAverage:
    """Average those values of each pixel that agree within their standard deviations.

    Parameters
    ----------
    disparities_px, sigmas_px : (n, h, W) float32
        Of n frames; NaN = none.

    """
    frames, *shape = disparities_px.shape
    found = np.empty((5, int(np.prod(shape))), np.float32)
    values, sigmas = (one.reshape(frames, -1) for one in (disparities_px, sigmas_px))
    over_strips(average_pixels, found.shape[1], values, sigmas, found, strip=_STRIP)
    return TimeAverage(*(part.reshape(shape) for part in found))


def sigma_of(found: TimeAverage, known: Mask) -> FloatImage:
    """Return one standard deviation of the averages where they are ``known``, (H, W) float32, px.

    Notes
    -----
    Of the stated variance s^2 the part r^2 that the values show over time is random, the rest
    systematic: sigma^2 = s^2 - r^2 + r^2 / n, with r^2 the mean over nearby pixels, at most s^2.

    """
    freedom = np.where(known, found.agreeing - 1, 0).astype(np.float32)
    squares = np.where(known, found.variance_px2, 0) * freedom
    size = (POOL_PX, POOL_PX)
    pooled, weight = (
        cv2.boxFilter(one, cv2.CV_32F, size, normalize=False, borderType=cv2.BORDER_CONSTANT)
        for one in (squares, freedom)
    )
    random = np.minimum(pooled / np.maximum(weight, 1), found.stated_px2)
    variance = found.stated_px2 - random + random / np.maximum(found.agreeing, 1)
    sigma: FloatImage = np.sqrt(variance).astype(np.float32)
    return sigma
