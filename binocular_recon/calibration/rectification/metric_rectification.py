# SPDX-License-Identifier: Apache-2.0
"""The epipolar correction that keeps Z = f T / d: what CameraInfo states as R and P.

Eq. 9 makes rows correspond; for metric depth both corrected cameras must also be K* R* with the
same R*, the same f_x, f_y and c_y, and no skew (eq. 1-2). Free remain f_x, f_y, c_y, the turn
about the baseline and each c_x; they are chosen to resample the recorded images least.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import least_squares

from binocular_recon.calibration.model import StereoCalibration
from binocular_recon.calibration.rectification.epipolar import check_epipoles
from binocular_recon.calibration.rectification.homography import (
    Correction,
    ImageGrid,
    centring,
    check_in_front,
)
from binocular_recon.camera import Camera, FloatArray, StereoRig
from binocular_recon.errors import CalibrationError
from binocular_recon.number_text import significant
from binocular_recon.rotations import quarter_turn, rotation, turned_projection

# The principal points of both cameras are the same, so that a point at infinity has disparity 0,
# unless centring the images would set them apart by more than this share of the width.
OFFSET_LIMIT = 0.1


def metric_rig(calibration: StereoCalibration) -> StereoRig:
    """Return the rig with the rectification R, P that resamples both images least.

    If one camera stands above the other, columns correspond instead of rows: what follows then
    holds for the images turned by ``calibration.turns``.

    Both cameras share R* (its x axis is the baseline), f_x, f_y and c_y; f_x, f_y and the turn
    about the baseline are chosen by least resampling, c_y and c_x by centring. c_x is the same in
    both (disparity 0 at infinity) unless the cameras squint by more than ``OFFSET_LIMIT``.

    Raises
    ------
    CalibrationError
        If an epipole lies inside or close to its image, or the cameras are swapped.

    """
    check_order(calibration)
    check_epipoles(calibration)
    left, right = (ImageGrid.of(calibration, side) for side in ('left', 'right'))
    facing = calibration.facing

    def pair(free: FloatArray) -> Correction:
        K_star = np.diag([free[0], free[1], 1.0])
        return _metric_pair(calibration, K_star, rotation(np.array([free[2], 0, 0])) @ facing)

    def departure(free: FloatArray) -> FloatArray:
        chosen = pair(free)
        return np.concatenate([left.resampling(chosen.H_left), right.resampling(chosen.H_right)])

    focal = (calibration.K_left[:2, :2].trace() + calibration.K_right[:2, :2].trace()) / 4
    best = least_squares(departure, [focal, focal, 0.0], x_scale=[focal, focal, 1.0], method='lm')
    aligned = pair(best.x)
    check_in_front(left.denominators(aligned.H_left), right.denominators(aligned.H_right))
    size = calibration.turned_size
    shifts = centring(aligned, left, right, size)
    K_left, K_right = (shift @ np.diag([best.x[0], best.x[1], 1.0]) for shift in shifts)
    if abs(K_left[0, 2] - K_right[0, 2]) <= OFFSET_LIMIT * size[0]:
        K_left[0, 2] = K_right[0, 2] = (K_left[0, 2] + K_right[0, 2]) / 2
    R_star = rotation(np.array([best.x[2], 0, 0])) @ facing
    P_left = np.column_stack([K_left, np.zeros(3)])
    P_right = np.column_stack([K_right, [-K_right[0, 0] * calibration.baseline_m, 0, 0]])
    return StereoRig(
        _camera(calibration, 'left', R_star, P_left),
        _camera(calibration, 'right', R_star @ calibration.R.T, P_right),
    )


def correction_of(calibration: StereoCalibration, rig: StereoRig) -> Correction:
    """Return the homographies of undistorted to rectified pixels that a rig's R and P state."""
    return Correction(
        rig.left.P[:, :3] @ rig.left.R @ np.linalg.inv(calibration.K_left),
        rig.right.P[:, :3] @ rig.right.R @ np.linalg.inv(calibration.K_right),
    )


def check_order(calibration: StereoCalibration) -> None:
    """Raise a CalibrationError if the right camera stands to the left of the left one."""
    x = calibration.right_centre_m[0]
    if x < 0 and not calibration.turns:
        raise CalibrationError(
            f'left and right are swapped: the right camera stands {significant(-x)} m to the left'
            ' of the left one; exchange the images of the two cameras'
        )


def _metric_pair(
    calibration: StereoCalibration, K_star: FloatArray, R_star: FloatArray
) -> Correction:
    """Return H = K* R* R^T K^-1, so that H M = K* R* [I | -C] for both cameras (eq. 1-2)."""
    return Correction(
        K_star @ R_star @ np.linalg.inv(calibration.K_left),
        K_star @ R_star @ calibration.R.T @ np.linalg.inv(calibration.K_right),
    )


def _camera(calibration: StereoCalibration, side: str, R: FloatArray, P: FloatArray) -> Camera:
    """Return a camera of its upright images, from R and P of them turned."""
    width, height = calibration.image_size
    if turns := calibration.turns:
        R, P = quarter_turn(-turns) @ R, turned_projection(P, -turns, calibration.turned_size)
    model, D = calibration.stated_lens(side)
    return Camera(width, height, calibration.side(side)[0], D, R, P, model)
