# SPDX-License-Identifier: Apache-2.0
"""The standard deviation of filled pixels.

A filled disparity is right, or wrong by as much as surfaces differ: its errors have two modes and
no noise model. What is known of a hole is how much the measured pixels around it disagree with
what it was filled with, how far they are, and how much depth varies nearby and in the image. The
standard deviation grows with each of these, so that errors over it have an RMS of about 1 on real
scenes, outliers included. All terms scale with the disparities, so no scene sets a unit.
"""

from __future__ import annotations

import cv2
import numpy as np

from binocular_recon._jit import over_strips
from binocular_recon.images import ByteImage, FloatImage, Mask
from binocular_recon.stereo.holes._candidate_kernels import (
    compare_along_columns,
    compare_along_rows,
)
from binocular_recon.stereo.holes.completion import unexplained_holes
from binocular_recon.stereo.validity import Validity

# Factors on the RMS difference from the nearest measured pixels in four directions, on the
# distance from the nearest one, on the spread of disparities nearby, and on that in the image,
# where occlusion explains the hole and where nothing does.
CANDIDATES, DISTANCE, NEARBY, OCCLUDED, UNEXPLAINED = 0.35, 0.27, 0.50, 0.20, 0.50
# Nearby is a square of this share of the image's width.
NEARBY_SHARE = 1 / 8
# Spread nearby is smooth: it is taken from every so many rows and columns.
_STRIDE = 4


def assess_holes(measured_px: FloatImage, filled_px: FloatImage) -> tuple[FloatImage, ByteImage]:
    """Return the variance of filled pixels, and which are filled and which extrapolated.

    Parameters
    ----------
    measured_px : (H, W) float32
        Measured disparity; NaN = none.
    filled_px : (H, W) float32
        Disparity of every pixel.

    Returns
    -------
    variance : (H, W) float32
        Variance of filled pixels, px^2; of measured ones meaningless.
    validity : (H, W) uint8
        `Validity.MEASURED`, ``FILLED`` or ``EXTRAPOLATED``.

    Notes
    -----
    Extrapolated is what no measured pixels enclose, along its row or its column, and a hole that
    occlusion does not explain and that reaches the image's border: sky, a blank wall, water. That
    may lie anywhere behind what is around it, which no standard deviation says.

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
    open_ = _reaching_the_border(unexplained)
    validity = np.full(measured_px.shape, Validity.FILLED, np.uint8)
    validity[open_ | ~_enclosed(~hole)] = Validity.EXTRAPOLATED
    validity[~hole] = Validity.MEASURED
    return variance, validity


def _enclosed(measured: Mask) -> Mask:
    """Return which pixels have measured ones on both sides in their row or in their column."""
    enclosed = np.zeros_like(measured)
    for lines, inside in ((measured, enclosed), (measured.T, enclosed.T)):
        some = np.asarray(lines.any(axis=1))
        first, after = lines.argmax(axis=1), lines[:, ::-1].argmax(axis=1)
        last = lines.shape[1] - 1 - after
        place = np.arange(lines.shape[1])
        inside |= some[:, None] & (place >= first[:, None]) & (place <= last[:, None])
    return enclosed


def _reaching_the_border(region: Mask) -> Mask:
    """Return the connected parts of a region that reach the image's border."""
    # every second row and column are enough to tell, and four times as fast
    _, labels = cv2.connectedComponents(region[::2, ::2].astype(np.uint8), connectivity=4)
    border = np.concatenate([labels[0], labels[-1], labels[:, 0], labels[:, -1]])
    reaching = np.zeros(labels.max() + 1, np.bool_)
    reaching[border] = True
    reaching[0] = False
    coarse = reaching[labels].repeat(2, axis=0).repeat(2, axis=1)
    found: Mask = region & coarse[: region.shape[0], : region.shape[1]]
    return found


def _spread(measured_px: FloatImage) -> tuple[FloatImage, float]:
    """Return the variance of measured disparities around each pixel, and of all, px^2."""
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
