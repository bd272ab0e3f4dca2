# SPDX-License-Identifier: Apache-2.0
"""Stereo calibration as it is usually done with OpenCV: the peer of our planar calibration."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from binocular_recon.calibration.model import StereoCalibration
from binocular_recon.calibration.target.capture import Capture
from binocular_recon.calibration.target.target import Target


def calibrate_in_two_steps(
    captures: Sequence[Capture], target: Target, image_size: tuple[int, int]
) -> StereoCalibration:
    """Calibrate each camera by itself, then the pose between them with the cameras held fixed.

    ``cv2.calibrateCamera`` with k1 k2 p1 p2, then ``cv2.stereoCalibrate`` with
    ``CALIB_FIX_INTRINSIC``. An error of one camera is not corrected by the other one.

    Parameters
    ----------
    captures : sequence of Capture
        Boards with every mark found.
    target : Target
        The boards' nominal geometry.
    image_size : (int, int)
        Width and height, px.

    """
    points = [target.nominal_m.reshape(-1, 3).astype(np.float32)] * len(captures)
    left, right = (
        [marks.reshape(-1, 2).astype(np.float32) for marks in side]
        for side in zip(
            *((capture.left_px, capture.right_px) for capture in captures), strict=True
        )
    )
    (K_left, D_left), (K_right, D_right) = (
        cv2.calibrateCamera(
            points, marks, image_size, np.eye(3), np.zeros(5), flags=cv2.CALIB_FIX_K3
        )[1:3]
        for marks in (left, right)
    )
    cameras = K_left, D_left.ravel(), K_right, D_right.ravel()
    R, T = cv2.stereoCalibrate(
        points, left, right, *cameras, image_size, flags=cv2.CALIB_FIX_INTRINSIC
    )[5:7]
    return StereoCalibration(image_size, *cameras, R, T.ravel())
