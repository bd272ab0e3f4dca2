# SPDX-License-Identifier: Apache-2.0
"""The paper's third step: calibrate again on marks after epipolar correction (section 2.2).

Errors are mapped back to the original images. In the corrected image they would shrink
wherever the correction shrinks the image, without anything having become more accurate.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from binocular_recon.calibration.adjustment.linearisation import State, predict
from binocular_recon.calibration.adjustment.planar import calibrate_planar
from binocular_recon.calibration.model import StereoCalibration
from binocular_recon.calibration.rectification.homography import Correction, apply, apply_inverse
from binocular_recon.calibration.rectification.metric_rectification import (
    correction_of,
    metric_rig,
)
from binocular_recon.calibration.target.target import Target
from binocular_recon.camera import FloatArray

SIDES = (('left', slice(0, 2)), ('right', slice(2, 4)))


@dataclass(frozen=True, eq=False)
class Recalibration:
    """Calibration of the corrected cameras.

    Attributes
    ----------
    corrected_px : (B, R, M, 4) float64
        Marks after correction.
    state : State
        Corrected cameras and boards.
    predicted_px : (B, R, M, 4) float64
        Where this calibration expects the marks in the original images.

    """

    corrected_px: FloatArray
    state: State
    predicted_px: FloatArray


def recalibrate(
    observed_px: FloatArray, target: Target, planar: StereoCalibration
) -> Recalibration:
    """Correct the marks with a planar calibration and calibrate again.

    Corrected images are those of pinhole cameras, whatever the lens was.

    The metric pair of homographies is used, because the calibrated cameras have no skew.

    Parameters
    ----------
    observed_px : (B, R, M, 4) float64
        Marks in the original images; NaN = not found.
    target : Target
        The boards' nominal geometry, taken as exact.
    planar : StereoCalibration
        Calibration that the correction is computed from.

    Raises
    ------
    CalibrationError
        If rows cannot be aligned or no camera fits the corrected marks.

    """
    correction = correction_of(planar, metric_rig(planar))
    corrected = corrected_marks(observed_px, planar, correction)
    state = calibrate_planar(corrected, target, planar.image_size)
    expected = predict(state, target.exact())
    original = [
        planar.distort(apply_inverse(correction.side(side), expected[..., uv]), side)
        for side, uv in SIDES
    ]
    return Recalibration(corrected, state, np.concatenate(original, axis=-1))


def corrected_marks(
    observed_px: FloatArray, calibration: StereoCalibration, correction: Correction
) -> FloatArray:
    """Return the marks (..., 4) px after undistortion and correction."""
    return np.concatenate(
        [
            apply(correction.side(side), calibration.undistort(observed_px[..., uv], side))
            for side, uv in SIDES
        ],
        axis=-1,
    )
