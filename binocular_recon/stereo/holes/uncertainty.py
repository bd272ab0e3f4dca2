# SPDX-License-Identifier: Apache-2.0
"""The standard deviation of filled pixels.

A filled disparity is either right, or wrong by the distance between two surfaces: its errors are
bimodal and follow no noise model. What can be observed is how much the measured pixels around a
hole differ from the filled value, how far away they are, and how much disparities vary nearby and
in the whole image. The variance is a weighted sum of these terms, with weights chosen on real
scenes so that errors divided by sigma have an RMS of about 1, outliers included. All terms scale
with the disparities, so the weights do not depend on the scale of a scene.
"""

from __future__ import annotations

import cv2
import numpy as np

from binocular_recon._jit import over_strips
from binocular_recon.images import ByteImage, FloatImage, Mask, connected_to_border
from binocular_recon.stereo.holes._candidate_kernels import (
    compare_along_columns,
    compare_along_rows,
)
from binocular_recon.stereo.holes.completion import unexplained_holes
from binocular_recon.stereo.validity import Validity

# Factors on the RMS difference from the nearest measured pixels in four directions, on the
# distance from the nearest one, on the standard deviation of disparities nearby, and on that in
# the image, for holes that half-occlusion explains and for others.
CANDIDATES, DISTANCE, NEARBY, OCCLUDED, UNEXPLAINED = 0.35, 0.27, 0.50, 0.20, 0.50
# "Nearby" is a square of this share of the image width.
NEARBY_SHARE = 1 / 8
# The variance nearby is smooth, so it is computed from every fourth row and column.
_STRIDE = 4


def assess_holes(measured_px: FloatImage, filled_px: FloatImage) -> tuple[FloatImage, ByteImage]:
    """Return the variance of unmatched pixels, and which are filled and which extrapolated.

    Parameters
    ----------
    measured_px : (H, W) float32
        Measured disparity; NaN = none.
    filled_px : (H, W) float32
        Disparity of every pixel.

    Returns
    -------
    variance : (H, W) float32
        Variance of unmatched pixels, px^2; meaningless in measured ones.
    validity : (H, W) uint8
        `Validity.MEASURED`, ``FILLED`` or ``EXTRAPOLATED``.

    Notes
    -----
    A pixel is extrapolated if it is not between measured pixels of its row or of its column, or if
    its hole reaches the image border and half-occlusion does not explain it: sky, a uniform wall,
    water. Such a surface may be anywhere, which no standard deviation can express.

    """
    height, width = measured_px.shape
    variance, counts = np.empty_like(measured_px), np.empty_like(measured_px)
    over_strips(compare_along_rows, height, measured_px, filled_px, variance, counts)
    over_strips(compare_along_columns, width, measured_px, filled_px, variance, counts, strip=256)
    variance *= np.float32(CANDIDATES**2)
    variance /= np.maximum(counts, 1, out=counts)
    hole = np.isnan(measured_px)
    distance = cv2.distanceTransform(hole.view(np.uint8), cv2.DIST_L2, 3)
    variance += np.float32(DISTANCE**2) * np.square(distance, out=distance)
    nearby, overall = _spread(measured_px)
    variance += np.float32(NEARBY**2) * nearby
    unexplained = unexplained_holes(measured_px)
    variance += np.where(
        unexplained, np.float32(UNEXPLAINED**2 * overall), np.float32(OCCLUDED**2 * overall)
    )
    extrapolated = _reaching_the_border(unexplained) | ~_enclosed(~hole)
    validity = np.full(measured_px.shape, Validity.FILLED, np.uint8)
    validity[extrapolated] = Validity.EXTRAPOLATED
    validity[~hole] = Validity.MEASURED
    return variance, validity


def _enclosed(measured: Mask) -> Mask:
    """Return which pixels have measured ones on both sides in their row or in their column."""
    enclosed = np.zeros_like(measured)
    for lines, inside in ((measured, enclosed), (measured.T, enclosed.T)):
        some = np.asarray(lines.any(axis=1))
        first, after = lines.argmax(axis=1), lines[:, ::-1].argmax(axis=1)
        last = lines.shape[1] - 1 - after
        index = np.arange(lines.shape[1])
        inside |= some[:, None] & (index >= first[:, None]) & (index <= last[:, None])
    return enclosed


def _reaching_the_border(region: Mask) -> Mask:
    """Return the connected parts of a region that reach the image border."""
    # every second row and column suffice, and are four times as fast
    coarse = connected_to_border(region[::2, ::2]).repeat(2, axis=0).repeat(2, axis=1)
    found: Mask = region & coarse[: region.shape[0], : region.shape[1]]
    return found


def _spread(measured_px: FloatImage) -> tuple[FloatImage, float]:
    """Return the variance of the measured disparities around each pixel, and of all, px^2."""
    samples = measured_px[::_STRIDE, ::_STRIDE]
    known: Mask = np.isfinite(samples)
    if not known.any():
        return np.zeros_like(measured_px), 0.0
    mean = float(samples[known].mean())
    values = np.where(known, samples - np.float32(mean), 0)
    side = 2 * round(NEARBY_SHARE * samples.shape[1] / 2) + 1
    count, total, square = (
        cv2.boxFilter(image, cv2.CV_32F, (side, side), borderType=cv2.BORDER_REFLECT)
        for image in (known.astype(np.float32), values, values * values)
    )
    count = np.maximum(count, np.float32(1 / side**2))
    variance = np.maximum(square / count - (total / count) ** 2, 0).astype(np.float32)
    size = measured_px.shape[1], measured_px.shape[0]
    nearby = cv2.resize(variance, size, interpolation=cv2.INTER_LINEAR)
    return np.asarray(nearby, np.float32), float(np.square(values[known]).mean())
