# SPDX-License-Identifier: Apache-2.0
"""Intrinsics of two cameras and their relative pose: what calibration estimates."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from binocular_recon.camera import FloatArray, parameter_names
from binocular_recon.errors import CalibrationError
from binocular_recon.lenses.lens import Lens
from binocular_recon.lenses.registry import LENSES
from binocular_recon.rotations import rotation

DEFAULT_LENS = 'plumb_bob'


def calibrated_lenses() -> tuple[str, ...]:
    """Return the names of the lenses that a calibration can choose."""
    return tuple(name for name, lens in LENSES.items() if lens.COEFFICIENTS)


def lens_text() -> str:
    """Return the description of the option that chooses one of them."""
    wide = [name for name in calibrated_lenses() if LENSES[name].WIDE_ANGLE]
    return f'lens of both cameras; {" and ".join(wide)} for a fisheye'


def parameters_of(lens: str) -> tuple[str, ...]:
    """Return the parameters of a lens in the order of `StereoCalibration.moved`."""
    return parameter_names(LENSES[lens].COEFFICIENTS)


def check_lens(lens: str) -> None:
    """Raise a CalibrationError unless cameras with this lens can be calibrated."""
    lenses = calibrated_lenses()
    if lens in lenses:
        return
    known = ' or '.join(lenses)
    if lens in LENSES:
        raise CalibrationError(
            f'a {lens} lens cannot be chosen for a calibration; choose {known}'
            ' (plumb_bob becomes rational_polynomial where the marks call for it)'
        )
    raise CalibrationError(f'lens {lens!r} is unknown; choose {known}')


@dataclass(frozen=True, eq=False)
class StereoCalibration:
    """Both cameras of a rig: ``x_right = R x_left + T``, metres.

    Attributes
    ----------
    image_size : (int, int)
        Width and height, px.
    K_left, K_right : (3, 3) float64
        Intrinsics, px.
    D_left, D_right : (n,) float64
        Distortion, all of the lens' ``COEFFICIENTS``.
    R : (3, 3) float64
        Rotation from the left to the right camera.
    T : (3,) float64
        Translation, m.
    lens : str
        Lens of both cameras, one of `calibrated_lenses`.

    """

    image_size: tuple[int, int]
    K_left: FloatArray
    D_left: FloatArray
    K_right: FloatArray
    D_right: FloatArray
    R: FloatArray
    T: FloatArray
    lens: str = DEFAULT_LENS

    def __post_init__(self) -> None:
        """Bring the arrays to shape."""
        count = len(self.lens_model.COEFFICIENTS)
        for name, shape in (('K', (3, 3)), ('D', (-1,))):
            for side in ('left', 'right'):
                values = np.asarray(getattr(self, f'{name}_{side}'), np.float64).reshape(shape)
                if name == 'D':
                    values = np.pad(values, (0, count - values.size))
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

    @property
    def turns(self) -> int:
        """Quarter turns of the images that bring the baseline into rows, as `StereoRig.turns`."""
        x, y, _ = self.right_centre_m
        if abs(y) <= abs(x):
            return 0
        return 1 if y > 0 else -1

    @property
    def turned_size(self) -> tuple[int, int]:
        """Width and height of the images turned by `turns`, px."""
        width, height = self.image_size
        return (height, width) if self.turns else (width, height)

    @property
    def facing(self) -> FloatArray:
        """Rotation from the left camera to x along the baseline and z the mean view, (3, 3).

        If one camera stands above the other, that is the frame of the images turned by `turns`.
        """
        x = self.right_centre_m / self.baseline_m
        view = np.array([0, 0, 1.0]) + self.R.T[:, 2]
        y = np.cross(view, x)
        y /= np.linalg.norm(y)
        return np.stack([x, y, np.cross(x, y)])

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the parameters of `moved`, (p,)."""
        return parameters_of(self.lens)

    @property
    def lens_model(self) -> Lens:
        """Projection of both lenses."""
        return LENSES[self.lens]

    def side(self, name: str) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return K, D and the pose R, T (from the left camera) of ``'left'`` or ``'right'``."""
        if name == 'left':
            return self.K_left, self.D_left, np.eye(3), np.zeros(3)
        return self.K_right, self.D_right, self.R, self.T

    def moved(self, step: FloatArray) -> StereoCalibration:
        """Return the calibration after a step in all ``parameters``, (p,)."""
        count = 4 + len(self.lens_model.COEFFICIENTS)
        left, right, turn, shift = np.split(step, [count, 2 * count, 2 * count + 3])
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
        local = points_m @ R.T + T
        return self.lens_model.pixels(local[..., :2] / local[..., 2:], K, D)

    def undistort(self, pixels: FloatArray, side: str) -> FloatArray:
        """Return (..., 2) px of a raw image as px of a pinhole camera with the same K.

        NaN where the lens model does not invert.
        """
        K, D, _, _ = self.side(side)
        return np.diag(K)[:2] * self.lens_model.rays(pixels, K, D) + K[:2, 2]

    def distort(self, pixels: FloatArray, side: str) -> FloatArray:
        """Return (..., 2) px of a pinhole camera with the same K as px of the raw image."""
        K, D, _, _ = self.side(side)
        return self.lens_model.pixels((pixels - K[:2, 2]) / np.diag(K)[:2], K, D)

    def stated_lens(self, side: str) -> tuple[str, FloatArray]:
        """Return the ``distortion_model`` of a camera and its D, as camera files state them."""
        return self.lens_model.stated(self.side(side)[1])

    def triangulate(self, left_px: FloatArray, right_px: FloatArray) -> FloatArray:
        """Return the points seen at (..., 2) px of both raw images, (..., 3) m, left frame.

        NaN where the lens model does not invert.
        """
        rays = [
            self.lens_model.rays(pixels, *self.side(side)[:2]).reshape(-1, 2)
            for side, pixels in (('left', left_px), ('right', right_px))
        ]
        seen = np.all(np.isfinite(rays), axis=(0, 2)).ravel()
        points = np.full((len(seen), 3), np.nan)
        if seen.any():
            found = cv2.triangulatePoints(
                np.eye(3, 4), np.column_stack([self.R, self.T]), *(r[seen].T for r in rays)
            )
            points[seen] = (found[:3] / found[3]).T
        return points.reshape(*left_px.shape[:-1], 3)


def check_finite(calibration: StereoCalibration) -> None:
    """Raise a CalibrationError if a parameter is not finite or a focal length not positive."""
    values = [calibration.K_left, calibration.D_left, calibration.K_right, calibration.D_right]
    values += [calibration.R, calibration.T]
    focal = [K[i, i] for K in (calibration.K_left, calibration.K_right) for i in (0, 1)]
    if not all(np.isfinite(value).all() for value in values) or min(focal) <= 0:
        raise CalibrationError(
            'no calibration fits the marks (the solution diverged); check that rods.yaml states'
            ' the rods in the images, and capture boards at more distances and angles'
        )


def _intrinsics_step(step: FloatArray) -> FloatArray:
    fx, fy, cx, cy = step[:4]
    return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 0]])
