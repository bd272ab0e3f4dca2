# SPDX-License-Identifier: Apache-2.0
"""Intrinsics of two cameras and their relative pose: what calibration estimates."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from binocular_recon.camera import FloatArray
from binocular_recon.errors import CalibrationError

# OpenCV's order of the distortion coefficients.
COEFFICIENTS = ('k1', 'k2', 'p1', 'p2', 'k3', 'k4', 'k5', 'k6')
_SIDE = ('fx', 'fy', 'cx', 'cy', *COEFFICIENTS)
# The parameters in the order of `StereoCalibration.moved` and of covariance matrices. Rotations
# are small turns about the right camera's axes (rad), translations metres.
PARAMETERS = (
    *(f'{name}_left' for name in _SIDE),
    *(f'{name}_right' for name in _SIDE),
    *('turn_x', 'turn_y', 'turn_z', 'T_x', 'T_y', 'T_z'),
)


@dataclass(frozen=True, eq=False)
class StereoCalibration:
    """Both cameras of a rig: ``x_right = R x_left + T``, metres.

    Attributes
    ----------
    image_size : (int, int)
        Width and height, px.
    K_left, K_right : (3, 3) float64
        Intrinsics, px.
    D_left, D_right : (8,) float64
        Distortion, OpenCV's order ``COEFFICIENTS``.
    R : (3, 3) float64
        Rotation from the left to the right camera.
    T : (3,) float64
        Translation, m.

    """

    image_size: tuple[int, int]
    K_left: FloatArray
    D_left: FloatArray
    K_right: FloatArray
    D_right: FloatArray
    R: FloatArray
    T: FloatArray

    def __post_init__(self) -> None:
        """Bring the arrays to shape."""
        for name, shape in (('K', (3, 3)), ('D', (-1,))):
            for side in ('left', 'right'):
                values = np.asarray(getattr(self, f'{name}_{side}'), np.float64).reshape(shape)
                if name == 'D':
                    values = np.pad(values, (0, len(COEFFICIENTS) - values.size))
                object.__setattr__(self, f'{name}_{side}', values)
        object.__setattr__(self, 'R', np.asarray(self.R, np.float64).reshape(3, 3))
        object.__setattr__(self, 'T', np.asarray(self.T, np.float64).reshape(3))

    @property
    def baseline_m(self) -> float:
        """Distance between the optical centres, m."""
        return float(np.linalg.norm(self.T))

    @property
    def right_centre_m(self) -> FloatArray:
        """Optical centre of the right camera in the left camera's frame, (3,) m."""
        centre: FloatArray = -self.R.T @ self.T
        return centre

    def side(self, name: str) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return K, D and the pose R, T (from the left camera) of ``'left'`` or ``'right'``."""
        if name == 'left':
            return self.K_left, self.D_left, np.eye(3), np.zeros(3)
        return self.K_right, self.D_right, self.R, self.T

    def moved(self, step: FloatArray) -> StereoCalibration:
        """Return the calibration after a step in the parameters of ``PARAMETERS``, (30,)."""
        left, right, turn, shift = np.split(step, [12, 24, 27])
        return replace(
            self,
            K_left=self.K_left + _intrinsics_step(left),
            D_left=self.D_left + left[4:],
            K_right=self.K_right + _intrinsics_step(right),
            D_right=self.D_right + right[4:],
            R=rotation(turn) @ self.R,
            T=self.T + shift,
        )

    def project(self, points_m: FloatArray, side: str) -> FloatArray:
        """Project points of the left camera's frame, (..., 3) m, to (..., 2) px of a raw image."""
        K, D, R, T = self.side(side)
        turn = cv2.Rodrigues(R)[0]
        pixels = cv2.projectPoints(
            np.ascontiguousarray(points_m, np.float64).reshape(-1, 1, 3), turn, T[:, None], K, D
        )[0]
        return np.asarray(pixels, np.float64).reshape(*points_m.shape[:-1], 2)

    def undistort(self, pixels: FloatArray, side: str) -> FloatArray:
        """Return (..., 2) px of a raw image as px of the same camera without distortion."""
        K, D, _, _ = self.side(side)
        return undistort(pixels, K, D, K)

    def distort(self, pixels: FloatArray, side: str) -> FloatArray:
        """Return (..., 2) px of the camera without distortion as px of its raw image."""
        K = self.side(side)[0]
        rays = np.ones((*pixels.shape[:-1], 3))
        rays[..., :2] = (pixels - K[:2, 2]) / np.diag(K)[:2]
        R, T = self.side(side)[2:]
        return self.project((rays - T) @ R, side)

    def triangulate(self, left_px: FloatArray, right_px: FloatArray) -> FloatArray:
        """Return the points seen at (..., 2) px of both raw images, (..., 3) m, left frame."""
        rays = []
        for side, pixels in (('left', left_px), ('right', right_px)):
            K, D, _, _ = self.side(side)
            rays.append(undistort(pixels, K, D, np.eye(3)).reshape(-1, 2))
        points = cv2.triangulatePoints(
            np.eye(3, 4), np.column_stack([self.R, self.T]), rays[0].T, rays[1].T
        )
        return np.asarray((points[:3] / points[3]).T, np.float64).reshape(*left_px.shape[:-1], 3)


def undistort(pixels: FloatArray, K: FloatArray, D: FloatArray, P: FloatArray) -> FloatArray:
    """Return (..., 2) px of a camera (K, D) as px of the distortion-free camera P; NaN stays."""
    # the default five iterations leave up to 0.1 px in the corners of a wide lens
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 50, 1e-12)
    flat = np.ascontiguousarray(pixels, np.float64).reshape(-1, 1, 2)
    if hasattr(cv2, 'undistortPointsIter'):  # OpenCV 4; OpenCV 5 takes the criteria directly
        straight = cv2.undistortPointsIter(flat, K, D, np.eye(3), P, criteria)
    else:
        straight = cv2.undistortPoints(flat, K, D, R=np.eye(3), P=P, criteria=criteria)
    return np.asarray(straight, np.float64).reshape(pixels.shape)


def rotation(turn: FloatArray) -> FloatArray:
    """Return the rotation matrices (..., 3, 3) of rotation vectors (..., 3), rad (Rodrigues)."""
    angle = np.linalg.norm(turn, axis=-1)[..., None, None]
    generator = cross_matrix(turn)
    # sinc is exact at 0
    first = np.sinc(angle / np.pi)
    second = 0.5 * np.sinc(angle / (2 * np.pi)) ** 2
    result: FloatArray = np.eye(3) + first * generator + second * generator @ generator
    return result


def cross_matrix(vector: FloatArray) -> FloatArray:
    """Return the matrices (..., 3, 3) that form the cross product with vectors (..., 3)."""
    x, y, z = np.moveaxis(vector, -1, 0)
    zero = np.zeros_like(x)
    rows = [[zero, -z, y], [z, zero, -x], [-y, x, zero]]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def check_finite(calibration: StereoCalibration) -> None:
    """Raise a CalibrationError if a parameter is not finite or a focal length not positive."""
    values = [calibration.K_left, calibration.D_left, calibration.K_right, calibration.D_right]
    values += [calibration.R, calibration.T]
    focal = [K[i, i] for K in (calibration.K_left, calibration.K_right) for i in (0, 1)]
    if not all(np.isfinite(value).all() for value in values) or min(focal) <= 0:
        raise CalibrationError(
            'no calibration fits the marks (the solution diverged); check that rods.yaml states'
            ' the rods in the pictures, and capture boards at more distances and angles'
        )


def _intrinsics_step(step: FloatArray) -> FloatArray:
    fx, fy, cx, cy = step[:4]
    return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 0]])
