# SPDX-License-Identifier: Apache-2.0
"""Epipolar correction: homographies that make the rows of both images correspond (eq. 1-9).

Homographies act on undistorted pixels; with F, x_R^T F x_L = 0. What eq. 9 leaves free is chosen
to resample the recorded images least. The pair found here keeps all of eq. 9 free and serves
the paper's Table 1; `metric_rectification` adds what Z = f T / d needs.

Source: the paper, section 2.2; Gluckman and Nayar, "Rectifying transformations that minimize
resampling effects" (CVPR 2001).
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import least_squares

from binocular_recon.calibration.model import StereoCalibration
from binocular_recon.calibration.rectification.homography import (
    Correction,
    ImageGrid,
    apply,
    centring,
    check_in_front,
)
from binocular_recon.camera import FloatArray
from binocular_recon.errors import CalibrationError
from binocular_recon.rotations import cross_matrix, quarter_turn

# eq. 5, the fundamental matrix of a pair whose rows correspond
F_STAR = np.array([[0.0, 0, 0], [0, 0, 1], [0, -1, 0]])


def fundamental_matrix(calibration: StereoCalibration) -> FloatArray:
    """Return F of undistorted pixels, (3, 3): x_R^T F x_L = 0, unit norm."""
    essential = cross_matrix(calibration.T) @ calibration.R
    F = np.linalg.inv(calibration.K_right).T @ essential @ np.linalg.inv(calibration.K_left)
    unit: FloatArray = F / np.linalg.norm(F)
    return unit


def epipoles(calibration: StereoCalibration) -> tuple[FloatArray, FloatArray]:
    """Return the homogeneous epipoles (3,) of the undistorted left and right image."""
    left = calibration.K_left @ calibration.R.T @ calibration.T
    right = calibration.K_right @ calibration.T
    return left / np.linalg.norm(left), right / np.linalg.norm(right)


def row_aligning_pair(calibration: StereoCalibration) -> Correction:
    """Return the basic pair of eq. 6-8: rows correspond, what eq. 9 leaves free is not chosen.

    Corrected images are those turned by ``calibration.turns``.

    Raises
    ------
    CalibrationError
        If an epipole lies inside its image: no homography makes its lines parallel.

    """
    check_epipoles(calibration)
    width, height = calibration.image_size
    centred = np.array([[1, 0, -(width - 1) / 2], [0, 1, -(height - 1) / 2], [0, 0, 1]])
    turns = calibration.turns
    left, right = (
        _epipole_to_infinity(centred @ e, turns) @ centred for e in epipoles(calibration)
    )
    F_hat = np.linalg.inv(right).T @ fundamental_matrix(calibration) @ np.linalg.inv(left)
    (a, b), (c, d) = F_hat[1:, 1:]  # eq. 7
    H_S = np.array([[a * d - b * c, 0, 0], [0, -c, -d], [0, a, b]])  # eq. 8
    return Correction(H_S @ left, right)


def free_pair(calibration: StereoCalibration) -> Correction:
    """Return the row-aligning pair that resamples both images least, all of eq. 9 free.

    Corrected images are those turned by ``calibration.turns``. Depth from their disparities is
    not metric: use ``metric_rig`` for that.

    Raises
    ------
    CalibrationError
        If an epipole lies inside or close to its image.

    """
    basic = _normalised(row_aligning_pair(calibration), calibration)
    left, right = (ImageGrid.of(calibration, side) for side in ('left', 'right'))
    size = calibration.turned_size

    def pair(free: FloatArray) -> Correction:
        l1, l2, r1, r2, s, q = free
        common = [0, s, 0], [0, q / size[1], 1]
        return Correction(
            np.array([[l1, l2, 0], *common]) @ basic.H_left,
            np.array([[r1, r2, 0], *common]) @ basic.H_right,
        )

    def departure(free: FloatArray) -> FloatArray:
        chosen = pair(free)
        return np.concatenate([left.resampling(chosen.H_left), right.resampling(chosen.H_right)])

    best = least_squares(departure, np.array([1.0, 0, 1, 0, 1, 0]), method='lm')
    aligned = pair(best.x)
    check_in_front(left.denominators(aligned.H_left), right.denominators(aligned.H_right))
    shift_left, shift_right = centring(aligned, left, right, size)
    return Correction(shift_left @ aligned.H_left, shift_right @ aligned.H_right)


def check_epipoles(calibration: StereoCalibration) -> None:
    """Raise a CalibrationError if a camera sees the other one (forward motion)."""
    for side, epipole in zip(('left', 'right'), epipoles(calibration), strict=True):
        outline = ImageGrid.of(calibration, side).points_px
        # inside the bounding box of the image, written so that e3 = 0 (infinitely far) works
        low, high = outline.min(axis=0), outline.max(axis=0)
        scaled = epipole[:2] * np.sign(epipole[2])
        w = abs(epipole[2])
        if (scaled > low * w).all() and (scaled < high * w).all():
            x, y = epipole[:2] / epipole[2]
            raise CalibrationError(
                f'the epipole of the {side} image lies inside it, at ({x:.0f}, {y:.0f}) px: one'
                ' camera stands in the view of the other; mount them side by side'
            )


def _epipole_to_infinity(e: FloatArray, turns: int) -> FloatArray:
    """Return eq. 6 for an epipole in coordinates about the image's centre, safe for e3 = 0.

    ``turns`` tells where the epipole goes to the right: 0 from beside, 1 from below, -1 above.
    """
    e1, e2, e3 = e if (turns * e[1] if turns else e[0]) >= 0 else -e
    length = np.hypot(e1, e2)
    return np.array(
        [
            [e1 / length, e2 / length, 0],
            [-e2 / length, e1 / length, 0],
            [-e1 * e3 / length**2, -e2 * e3 / length**2, 1],
        ]
    )


def _normalised(basic: Correction, calibration: StereoCalibration) -> Correction:
    """Scale a pair within eq. 9 so that the left centre stays upright and about as large."""
    centre = (np.array(calibration.image_size) - 1) / 2
    back = quarter_turn(calibration.turns)[:2, :2].T
    H_left, H_right = (H / (H[2, :2] @ centre + H[2, 2]) for H in (basic.H_left, basic.H_right))
    # derivatives of the corrected by the undistorted position at the centre, turned alike
    scales = []
    for H in (H_left, H_right):
        mapped = apply(H, centre)
        scales.append((H[:2, :2] - mapped[:, None] * H[2, :2]) @ back)
    s = 1 / scales[0][1, 1]
    left, right = (np.diag([1 / scale[0, 0], s, 1.0]) for scale in scales)
    return Correction(left @ H_left, right @ H_right)
