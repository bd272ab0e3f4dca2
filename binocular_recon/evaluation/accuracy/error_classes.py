# SPDX-License-Identifier: Apache-2.0
"""Where errors come from: every pixel with ground truth in one class, by what makes it hard."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from binocular_recon.evaluation.accuracy.scenes import TruthScene
from binocular_recon.images import FloatImage, Mask, to_grey, window_mean, window_range

# In this order: a pixel belongs to the first class that fits.
CLASSES = (
    'out of view', 'occluded', 'depth edge', 'weak texture', 'repetitive', 'slanted', 'other'
)  # fmt: skip
BAD_PX = 2.0

# Depth edge: another true disparity this close differs by more than a slanted surface would.
_EDGE_REACH_PX, _EDGE_STEP_PX = 4, 3.0
# Weak texture: standard deviation of the grey levels (of 255) in a window.
_TEXTURE_SIDE, _WEAK_LEVELS = 7, 2.5
# Repetitive: correlation of the window with another one of its row, not its neighbour.
_REPEAT_SIDE, _REPEAT_SCORE, _LEAST_SHIFT_PX, _MOST_SHIFT_PX = 11, 0.92, 5, 128
# Slanted: slope of the plane through the true disparities of a window.
_SLOPE_REACH_PX, _SLANTED = 4, 0.1


@dataclass(frozen=True)
class ClassErrors:
    """Errors of one method on the pixels of one class.

    Attributes
    ----------
    name : str
        One of `CLASSES`.
    pixels_percent : float
        Share of the pixels with ground truth that belong to the class.
    bad_points : float
        Pixels of the class that are off by more than 2 px or unfilled, in percent of all pixels
        with ground truth: the classes add up to bad-2.0, and so much the truth in this class
        would gain.

    """

    name: str
    pixels_percent: float
    bad_points: float


def classify(scene: TruthScene) -> npt.NDArray[np.int8] | None:
    """Return the class of each pixel, an index into `CLASSES`; None if visibility is unknown.

    Returns
    -------
    (H, W) int8
        -1 where there is no ground truth.

    """
    if scene.visible is None:
        return None
    truth = scene.truth_px
    column = np.arange(truth.shape[1], dtype=np.float32)
    landed = column - truth
    grey = to_grey(scene.left)
    tests = (
        (landed < -0.5) | (landed > truth.shape[1] - 0.5),
        ~scene.visible,
        _beside_step(truth),
        _deviation(grey, _TEXTURE_SIDE) < _WEAK_LEVELS,
        _repeats(grey, scene.max_disparity_px),
        _slope(truth) > _SLANTED,
        np.ones(truth.shape, bool),
    )
    classes = np.full(truth.shape, -1, np.int8)
    for number, hit in enumerate(tests):
        classes[hit & (classes < 0)] = number
    classes[~np.isfinite(truth)] = -1
    return classes


def class_errors(
    classes: npt.NDArray[np.int8], disparity_px: FloatImage, truth_px: FloatImage
) -> tuple[ClassErrors, ...]:
    """Return the errors of an estimate by class; empty if there is no ground truth."""
    counted = classes >= 0
    total = int(counted.sum())
    if not total:
        return ()
    error = np.abs(disparity_px - truth_px)
    bad = counted & ~(error <= BAD_PX)
    return tuple(
        ClassErrors(
            name,
            100.0 * int((classes == number).sum()) / total,
            100.0 * int((bad & (classes == number)).sum()) / total,
        )
        for number, name in enumerate(CLASSES)
    )


def _beside_step(truth: FloatImage) -> Mask:
    smallest, largest = window_range(truth, 2 * _EDGE_REACH_PX + 1)
    with np.errstate(invalid='ignore'):
        return np.asarray(np.maximum(largest - truth, truth - smallest) > _EDGE_STEP_PX)


def _deviation(grey: FloatImage, side: int) -> FloatImage:
    centred = (grey - np.float32(np.nanmean(grey))).astype(np.float32)
    variance = window_mean(centred * centred, side) - window_mean(centred, side) ** 2
    deviation: FloatImage = np.sqrt(np.maximum(variance, 0))
    return deviation


def _repeats(grey: FloatImage, disparity_range: int) -> Mask:
    """Return where the image correlates well with another place of the row within the range."""
    side, width = _REPEAT_SIDE, grey.shape[1]
    centred = (grey - np.float32(np.nanmean(grey))).astype(np.float32)
    mean, deviation = window_mean(centred, side), np.maximum(_deviation(grey, side), 1e-3)
    hit = np.zeros(grey.shape, bool)
    for shift in range(_LEAST_SHIFT_PX, min(disparity_range, _MOST_SHIFT_PX, width - side)):
        here, there = np.s_[:, shift:], np.s_[:, : width - shift]
        product = window_mean(np.ascontiguousarray(centred[here] * centred[there]), side)
        score = (product - mean[here] * mean[there]) / (deviation[here] * deviation[there])
        alike = score > _REPEAT_SCORE
        # near the borders the product sees other pixels than mean and deviation
        alike[:, : side // 2] = alike[:, alike.shape[1] - side // 2 :] = False
        hit[here] |= alike
        hit[there] |= alike
    return hit


def _slope(truth: FloatImage) -> FloatImage:
    """Return the size of the gradient of the plane through the true disparities of a window."""
    known = np.isfinite(truth)
    weight = known.astype(np.float64)
    value = np.where(known, truth, 0).astype(np.float64)
    v, u = np.mgrid[-_SLOPE_REACH_PX : _SLOPE_REACH_PX + 1, -_SLOPE_REACH_PX : _SLOPE_REACH_PX + 1]
    u, v = u.astype(np.float64), v.astype(np.float64)

    def total(
        image: npt.NDArray[np.float64], moment: npt.NDArray[np.float64]
    ) -> npt.NDArray[np.float64]:
        return np.asarray(cv2.filter2D(image, cv2.CV_64F, moment, borderType=cv2.BORDER_CONSTANT))

    one = np.ones_like(u)
    n = np.maximum(total(weight, one), 1)
    mx, my, mv = total(weight, u) / n, total(weight, v) / n, total(value, one) / n
    cxx, cyy = total(weight, u * u) / n - mx * mx, total(weight, v * v) / n - my * my
    cxy = total(weight, u * v) / n - mx * my
    cxv, cyv = total(value, u) / n - mx * mv, total(value, v) / n - my * mv
    spread = cxx * cyy - cxy * cxy
    with np.errstate(invalid='ignore', divide='ignore'):
        across, down = (cxv * cyy - cyv * cxy) / spread, (cyv * cxx - cxv * cxy) / spread
    slope = np.hypot(across, down)
    return np.where((spread > 0.1) & (n >= 5), slope, 0.0).astype(np.float32)
