# SPDX-License-Identifier: Apache-2.0
"""The standard deviation of filled pixels.

A filled disparity is either right, or wrong by the distance between two surfaces: its errors are
bimodal and follow no noise model. What can be observed is how much disparities vary along the rows
nearby, which is how far such surfaces are apart, and how much the measured pixels around the hole
differ from the filled value. The variance is a sum of these, with weights chosen on real scenes so
that errors divided by sigma have an RMS of about 1, outliers included. Along rows, because a floor
or a road has another disparity in every row without being two surfaces. The terms scale with the
disparities, so the weights do not depend on the scale of a scene.
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

# Weights of the variance along rows nearby and of the mean square difference from the nearest
# measured pixels in four directions, which counts up to a multiple of the former.
ROWS, CANDIDATES, MOST_CANDIDATES = 0.4, 0.6, 2.0
# Factor on both in holes that half-occlusion does not explain. Standard deviation per pixel of
# distance from the nearest measured one, in these and in other extrapolated ones.
UNEXPLAINED, DISTANCE, DISTANCE_BEYOND = 2.0, 2.0, 0.25
# "Nearby": squares of these shares of the image width, each with how much the next larger one, at
# last the image, counts beside a square that is all measured.
NEARBY = (1 / 4, 0.02), (1 / 8, 0.1)
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
    variance /= np.maximum(counts, 1, out=counts)
    nearby = _row_variance(measured_px)
    np.minimum(variance, np.float32(MOST_CANDIDATES) * nearby, out=variance)
    variance *= np.float32(CANDIDATES)
    variance += np.float32(ROWS) * nearby
    hole = np.isnan(measured_px)
    unexplained = unexplained_holes(measured_px)
    extrapolated = _reaching_the_border(unexplained) | ~_enclosed(~hole)
    distance = cv2.distanceTransform(hole.view(np.uint8), cv2.DIST_L2, 3)
    factor = np.where(extrapolated, np.float32(DISTANCE_BEYOND), np.float32(0))
    factor[unexplained] = DISTANCE
    distance *= factor
    variance[unexplained] *= np.float32(UNEXPLAINED)
    variance += distance * distance
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


def _row_variance(measured_px: FloatImage) -> FloatImage:
    """Return the variance of the measured disparities along the rows around each pixel, px^2."""
    samples = measured_px[::_STRIDE, ::_STRIDE]
    known: Mask = np.isfinite(samples)
    if not known.any():
        return np.zeros_like(measured_px)
    values = np.where(known, samples - samples[known].mean(), 0).astype(np.float32)
    images = known.astype(np.float32), values, values * values
    variance = np.full_like(values, values[known].var())
    for share, more in NEARBY:
        side = 2 * round(share * samples.shape[1] / 2) + 1
        count, total, square = (_mean(image, (side, 1)) for image in images)
        scatter = np.maximum(square - total * total / np.maximum(count, 1 / side), 0)
        variance = _mean(scatter, (1, side)) + np.float32(more) * variance
        variance /= _mean(count, (1, side)) + np.float32(more)
    size = measured_px.shape[1], measured_px.shape[0]
    nearby = cv2.resize(variance, size, interpolation=cv2.INTER_LINEAR)
    return np.asarray(nearby, np.float32)


def _mean(image: FloatImage, window: tuple[int, int]) -> FloatImage:
    """Return the mean in a window of (columns, rows) around each pixel."""
    mean = cv2.boxFilter(image, cv2.CV_32F, window, borderType=cv2.BORDER_REFLECT)
    return np.asarray(mean, np.float32)
