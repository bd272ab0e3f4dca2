# SPDX-License-Identifier: Apache-2.0
"""The simulated rig: two raw cameras with distortion whose rows do not correspond."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np

from binocular_recon.camera import Camera, FloatArray, StereoRig
from binocular_recon.errors import CalibrationError
from binocular_recon.inputs.common_size import CommonSize

# Mean row difference of the marks at 5-16 m: 5.5 px (2.3 px without).
TABLE_1_PITCH_RAD = -0.0027


@dataclass(frozen=True, eq=False)
class RawRig:
    """Two unrectified cameras; the reference frame is the left camera's optical frame.

    Attributes
    ----------
    left, right : Camera
        Raw cameras; only size, K and D are used.
    R : (3, 3) float64
        Rotation from the left to the right camera.
    T : (3,) float64
        ``x_right = R x_left + T``, m.

    """

    left: Camera
    right: Camera
    R: FloatArray
    T: FloatArray

    @property
    def baseline_m(self) -> float:
        """Distance between the optical centres, m."""
        return float(np.linalg.norm(self.T))

    def views(self) -> tuple[View, View]:
        """Return the left and the right camera with their poses."""
        return View(self.left, np.eye(3), np.zeros(3)), View(self.right, self.R, self.T)

    def stereo_rig(self) -> StereoRig:
        """Return the rig with the R and P that rectify it (cv2.stereoRectify, alpha 0).

        With a lens that OpenCV's function does not know, P keeps the focal length (alpha -1).
        """
        known = self.left.lens.POLYNOMIAL
        D_left, D_right = (
            camera.D if known else np.zeros(5) for camera in (self.left, self.right)
        )
        right_K = CommonSize(self.left.size, self.right.size).matrix @ self.right.K
        R_left, R_right, P_left, P_right = cv2.stereoRectify(
            self.left.K, D_left, right_K, D_right, self.left.size, self.R,
            self.T.reshape(3, 1), alpha=0.0 if known else -1.0,
        )[:4]  # fmt: skip
        return StereoRig(
            replace(self.left, R=R_left, P=P_left), replace(self.right, R=R_right, P=P_right)
        )

    def to_mapping(self) -> dict[str, Any]:
        """Return the rig's numbers under the keys of ``calibration.json``."""
        return {
            'image_size': list(self.left.size),
            'baseline_m': self.baseline_m,
            'left': {'K': self.left.K.tolist(), 'D': self.left.D.tolist()},
            'right': {'K': self.right.K.tolist(), 'D': self.right.D.tolist()},
            'R': self.R.tolist(),
            'T': self.T.tolist(),
        }


@dataclass(frozen=True, eq=False)
class View:
    """One camera of a rig and its pose: ``x_camera = R x + T``."""

    camera: Camera
    R: FloatArray
    T: FloatArray

    @property
    def centre_xyz(self) -> FloatArray:
        """Optical centre in the rig's reference frame, m."""
        centre: FloatArray = -self.R.T @ self.T
        return centre

    @property
    def numbers(self) -> FloatArray:
        """The camera for the kernels: fx, fy, cx, cy, k1, k2, p1, p2, k3, (9,) float64.

        Raises
        ------
        CalibrationError
            If the lens is not plumb_bob: images of other lenses cannot be drawn.

        """
        K, D = self.camera.K, self.camera.D
        if self.camera.distortion_model != 'plumb_bob':
            raise CalibrationError(
                f'images of a lens {self.camera.distortion_model} cannot be simulated, only its'
                ' marks; draw images with a plumb_bob lens'
            )
        return np.array([K[0, 0], K[1, 1], K[0, 2], K[1, 2], *D, *np.zeros(5 - D.size)])

    def project(self, points_xyz: FloatArray) -> FloatArray:
        """Project points (..., 3) of the reference frame to raw pixels (..., 2).

        A point behind the camera has no image: NaN.
        """
        points = np.asarray(points_xyz, np.float64)
        local = points @ self.R.T + self.T
        ahead = local[..., 2] > 0
        local = np.where(ahead[..., None], local, (0.0, 0.0, 1.0))
        rays = local[..., :2] / local[..., 2:]
        pixels = self.camera.lens.pixels(rays, self.camera.K, self.camera.D)
        return np.where(ahead[..., None], pixels, np.nan)

    def rays(self, pixels: FloatArray) -> FloatArray:
        """Return directions (..., 3) in the reference frame, of camera depth 1, of raw pixels."""
        plane = self.camera.lens.rays(np.asarray(pixels, np.float64), self.camera.K, self.camera.D)
        rays: FloatArray = np.concatenate([plane, np.ones_like(plane[..., :1])], -1) @ self.R
        return rays


def raw_camera(
    size: tuple[int, int], focal_px: tuple[float, float], centre_px: tuple[float, float],
    distortion: tuple[float, ...] = (), lens: str = 'plumb_bob',
) -> Camera:  # fmt: skip
    """Make a raw camera (R = I, P = K) from its intrinsics."""
    K = np.array([[focal_px[0], 0, centre_px[0]], [0, focal_px[1], centre_px[1]], [0, 0, 1.0]])
    P = np.hstack([K, np.zeros((3, 1))])
    return Camera(*size, K, np.asarray(distortion, np.float64), np.eye(3), P, lens)


def survey_rig(scale: float = 1.0, pitch_rad: float = 0.0) -> RawRig:
    """Return the default rig: 1920x1200, f about 1655 px, 1 m baseline, unequal cameras.

    Parameters
    ----------
    scale : float
        Size of the images relative to 1920x1200, for quick tests.
    pitch_rad : float
        Added rotation of the right camera about its x axis, rad; ``TABLE_1_PITCH_RAD`` gives
        the rod marks the row differences of the paper's Table 1.

    """
    size = (round(1920 * scale), round(1200 * scale))
    # pixel centres at integers: the corner of the image, not pixel 0, stays in place
    shift = (scale - 1) / 2
    left = raw_camera(
        size, (1650 * scale, 1652 * scale), (965 * scale + shift, 598 * scale + shift),
        (-0.08, 0.03, 0.0005, -0.0003),
    )  # fmt: skip
    right = raw_camera(
        size, (1662 * scale, 1660 * scale), (950 * scale + shift, 607 * scale + shift),
        (-0.07, 0.02, -0.0004, 0.0002),
    )  # fmt: skip
    R = cv2.Rodrigues(np.array([0.004 + pitch_rad, -0.02, 0.006]))[0]
    return RawRig(left, right, R, -R @ np.array([1.0, 0.004, -0.01]))


def fisheye_rig() -> RawRig:
    """Return a rig of two equidistant cameras: 1920x1200, f about 700 px, 1 m baseline."""
    size = (1920, 1200)
    left = raw_camera(
        size, (700, 701), (965, 598), (-0.02, 0.004, -0.003, 0.0006), 'equidistant'
    )  # fmt: skip
    right = raw_camera(
        size, (706, 705), (950, 607), (-0.015, 0.002, -0.002, 0.0004), 'equidistant'
    )  # fmt: skip
    R = cv2.Rodrigues(np.array([0.004, -0.02, 0.006]))[0]
    return RawRig(left, right, R, -R @ np.array([1.0, 0.004, -0.01]))
