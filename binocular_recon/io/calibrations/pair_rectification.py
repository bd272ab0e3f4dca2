# SPDX-License-Identifier: Apache-2.0
"""R and P of two calibrated cameras, for files that state their pose only."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import cv2
import numpy as np

from binocular_recon.camera import Camera, FloatArray
from binocular_recon.errors import CalibrationError
from binocular_recon.inputs.common_size import CommonSize
from binocular_recon.io.calibrations.values import pose_of

# With alpha 0, OpenCV enlarges images of strongly distorting lenses without bounds.
_MOST_ENLARGED, _MOST_REDUCED = 2.0, 0.5
_ROUNDING = 1e-9
# Points per side of the image that are undistorted.
_GRID = 9


@dataclass(frozen=True, eq=False)
class Rectification:
    """R and P of both cameras.

    Attributes
    ----------
    R_left, R_right : (3, 3) float64
        From the camera's to the rectified frame.
    P_left, P_right : (3, 4) float64
        Projection of rectified points, px and px m.
    stated : bool
        Whether the images could be rectified like this already.

    """

    R_left: FloatArray
    P_left: FloatArray
    R_right: FloatArray
    P_right: FloatArray
    stated: bool = False

    def shift(self) -> FloatArray:
        """Return the left camera in the rectified frame of the right one, (3,) m."""
        left, right = (np.linalg.solve(P[:, :3], P[:, 3]) for P in (self.P_left, self.P_right))
        return np.asarray(right - left, np.float64)

    def pose(self) -> FloatArray:
        """Return the pose (4, 4) of the right camera from the left one."""
        return pose_of(self.R_right.T @ self.R_left, self.R_right.T @ self.shift())

    def exchanged(self) -> Rectification:
        """Return the same with left and right exchanged."""
        P_left = np.column_stack([self.P_right[:, :3], np.zeros(3)])
        P_right = np.column_stack([self.P_left[:, :3], self.P_left[:, :3] @ -self.shift()])
        return Rectification(self.R_right, P_left, self.R_left, P_right, stated=self.stated)

    def scaled(self, factor: float) -> Rectification:
        """Return the same with another unit of length."""
        scale = np.array([1, 1, 1, factor])
        P_left, P_right = self.P_left * scale, self.P_right * scale
        return Rectification(self.R_left, P_left, self.R_right, P_right, stated=self.stated)


def rectify_pair(left: Camera, right: Camera, pose: FloatArray) -> Rectification:
    """Return the rectification that OpenCV's ``stereoRectify`` makes, with alpha 0.

    Cameras that are rectified already stay as they are. With a wide-angle lens, or where alpha 0
    would enlarge or reduce the images too much, the focal length is that of the raw images and
    their middle stays in the middle.

    Parameters
    ----------
    left, right : Camera
        Cameras as calibrated; their R and P do not count.
    pose : (4, 4) float64
        From the left camera's frame to that of the right one, m.

    Raises
    ------
    CalibrationError
        If OpenCV cannot rectify them.

    """
    sizes = CommonSize(left.size, right.size)
    if sizes.differs:  # both rectified images have the size of the left one
        width, height = left.size
        right = dataclasses.replace(right, width=width, height=height, K=sizes.matrix @ right.K)
    done = _rectified_already(left, right, pose)
    if done is not None:
        return done
    polynomial = left.lens.POLYNOMIAL and right.lens.POLYNOMIAL
    D = (left.D, right.D) if polynomial else (np.zeros(5), np.zeros(5))
    try:
        R_left, R_right, P_left, P_right, *_ = cv2.stereoRectify(
            left.K, D[0], right.K, D[1], left.size, pose[:3, :3], pose[:3, 3:].copy(),
            flags=cv2.CALIB_ZERO_DISPARITY, alpha=-1,
        )  # fmt: skip
        if polynomial:
            scale = max(_scale(left, R_left, P_left), _scale(right, R_right, P_right))
            zoom = np.array([[scale, 1, 1, scale], [1, scale, 1, scale], [1, 1, 1, 1]])
            P_left, P_right = P_left * zoom, P_right * zoom
    except cv2.error as error:
        raise CalibrationError(
            f'the cameras cannot be rectified: {error.err}; calibrate again'
        ) from error
    focal = float(np.mean([left.K[0, 0], left.K[1, 1], right.K[0, 0], right.K[1, 1]]))
    usual = np.isfinite([P_left, P_right]).all() and (
        _MOST_REDUCED * focal <= P_left[0, 0] <= _MOST_ENLARGED * focal
    )
    if not (polynomial and usual):
        centre = np.mean([_centred(left, R_left, focal), _centred(right, R_right, focal)], axis=0)
        K = np.array([[focal, 0, centre[0]], [0, focal, centre[1]], [0, 0, 1.0]])
        P_left = np.column_stack([K, np.zeros(3)])
        P_right = np.column_stack([K, K @ _along(R_right @ pose[:3, 3])])
    return Rectification(R_left, P_left, R_right, P_right)


def _scale(camera: Camera, R: FloatArray, P: FloatArray) -> float:
    """Return the factor on the focal length that leaves no pixel without data (alpha 0).

    As OpenCV 5 finds it; OpenCV 4.6 takes the image for one pixel larger, so that its focal length
    differs in the fifth digit.
    """
    last = np.array(camera.size) - 1.0
    shares = np.linspace(0, 1, _GRID)
    grid = np.stack(np.meshgrid(shares * last[0], shares * last[1]), axis=-1)
    points = cv2.undistortPoints(
        grid.reshape(-1, 1, 2).astype(np.float32), camera.K, camera.D, R=R, P=P[:, :3]
    ).reshape(_GRID, _GRID, 2)
    near = np.array([points[:, 0, 0].max(), points[0, :, 1].max()])
    far = np.array([points[:, -1, 0].min(), points[-1, :, 1].min()])
    centre = P[:2, 2]
    with np.errstate(divide='ignore', invalid='ignore'):
        return float(np.max([centre / (centre - near), (last - centre) / (far - centre)]))


def _along(shift: FloatArray) -> FloatArray:
    """Return a vector without its rounding across the baseline."""
    return np.where(np.abs(shift) == np.abs(shift).max(), shift, 0.0)


def _centred(camera: Camera, R: FloatArray, focal: float) -> FloatArray:
    """Return the principal point that keeps the middle of the raw image in the middle."""
    middle = (np.array(camera.size) - 1) / 2
    ray = camera.lens.rays(middle[None], camera.K, camera.D)[0]
    if not np.isfinite(ray).all():
        return np.asarray(middle, np.float64)
    turned = R @ [*ray, 1.0]
    return np.asarray(middle - focal * turned[:2] / turned[2], np.float64)


def _rectified_already(left: Camera, right: Camera, pose: FloatArray) -> Rectification | None:
    """Return R and P of cameras without distortion whose rows or columns correspond, or None."""
    shift = pose[:3, 3]
    straight = np.abs(pose[:3, :3] - np.eye(3)).max() < _ROUNDING
    along = _along(shift)
    across = int(np.argmax(np.abs(shift)) == 0)  # 1: rows correspond, 0: columns do
    same = (
        abs(left.K[0, 0] - right.K[0, 0]) < _ROUNDING * left.K[0, 0]
        and abs(left.K[1, 1] - right.K[1, 1]) < _ROUNDING * left.K[1, 1]
        and abs(left.K[across, 2] - right.K[across, 2]) < 1e-6
    )
    if (
        not (straight and same)
        or np.abs(shift - along).max() > _ROUNDING * np.abs(shift).max()
        or along[2]
        or any(camera.D.any() or camera.lens.WIDE_ANGLE for camera in (left, right))
        or any(camera.K[0, 1] for camera in (left, right))
    ):
        return None
    P_left = np.column_stack([left.K, np.zeros(3)])
    P_right = np.column_stack([right.K, right.K @ along])
    return Rectification(np.eye(3), P_left, np.eye(3), P_right, stated=True)
