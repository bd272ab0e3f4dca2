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
    Surroundings,
    Weights,
    compare_along_columns,
    compare_along_rows,
    sum_variance,
)
from binocular_recon.stereo.holes.completion import unexplained_holes
from binocular_recon.stereo.validity import Validity

WEIGHTS = Weights(
    rows=0.4,
    candidates=0.6,
    most_candidates=2.0,
    unexplained=2.0,
    distance=2.0,
    distance_beyond=0.25,
)
_MARKS = int(Validity.MEASURED), int(Validity.FILLED), int(Validity.EXTRAPOLATED)
# "Nearby": squares of these shares of the image width, each with how much the next larger one, at
# last the image, counts beside a square that is all measured.
NEARBY = (1 / 4, 0.02), (1 / 8, 0.1)
# The variance nearby is smooth, so it is computed from every fourth row and column.
_STRIDE = 4


def assess_holes(
    measured_px: FloatImage, filled_px: FloatImage, unexplained: Mask | None = None
) -> tuple[FloatImage, ByteImage]:
    """Return the variance of unmatched pixels, and which are filled and which extrapolated.

    Parameters
    ----------
    measured_px : (H, W) float32
        Measured disparity; NaN = none.
    filled_px : (H, W) float32
        Disparity of every pixel.
    unexplained : (H, W) bool, optional
        From `unexplained_holes`, if it is known.

    Returns
    -------
    variance : (H, W) float32
        Variance of unmatched pixels, px^2; 0 in measured ones.
    validity : (H, W) uint8
        `Validity.MEASURED`, ``FILLED`` or ``EXTRAPOLATED``.

    Notes
    -----
    A pixel is extrapolated if it is not between measured pixels of its row or of its column, or if
    its hole reaches the image border and half-occlusion does not explain it: sky, a uniform wall,
    water. Such a surface may be anywhere, which no standard deviation can express.

    """
    height, width = measured_px.shape
    variance, found = np.empty_like(measured_px), np.empty(measured_px.shape, np.uint8)
    over_strips(compare_along_rows, height, measured_px, filled_px, variance, found)
    over_strips(compare_along_columns, width, measured_px, filled_px, variance, found, strip=256)
    hole = np.isnan(measured_px).view(np.uint8)
    if unexplained is None:
        unexplained = unexplained_holes(measured_px)
    # every second row and column suffice, and are four times as fast
    around = Surroundings(
        found,
        nearby=_row_variance(measured_px),
        distance=np.asarray(cv2.distanceTransform(hole, cv2.DIST_L2, 3)),
        unexplained=unexplained,
        open=connected_to_border(unexplained[::2, ::2]),
    )
    validity = np.empty(measured_px.shape, np.uint8)
    over_strips(sum_variance, height, measured_px, around, WEIGHTS, _MARKS, variance, validity)
    return variance, validity


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
