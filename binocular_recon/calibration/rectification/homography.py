# SPDX-License-Identifier: Apache-2.0
"""Homographies of a pair of images, and how much they resample them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from binocular_recon.calibration.model import StereoCalibration
from binocular_recon.camera import FloatArray
from binocular_recon.errors import CalibrationError
from binocular_recon.images import Mask

# Points per side of the grid over an image on which resampling is measured.
_GRID = 9
# Distortion must be invertible in this share of the image.
_LEAST_USABLE = 0.5
# Distortion of a lens changes the local scale by less than a factor of 3 (its logarithm).
_TORN = np.log(3)


@dataclass(frozen=True, eq=False)
class Correction:
    """A pair of correcting homographies, acting on undistorted pixels.

    Attributes
    ----------
    H_left, H_right : (3, 3) float64
        Undistorted to corrected pixels.

    """

    H_left: FloatArray
    H_right: FloatArray

    def side(self, name: str) -> FloatArray:
        """Return the homography of ``'left'`` or ``'right'``."""
        return self.H_left if name == 'left' else self.H_right


@dataclass(frozen=True, eq=False)
class ImageGrid:
    """What the choice of a homography needs to know of one raw image.

    Attributes
    ----------
    points_px : (N, 2) float64
        A grid over the raw image, undistorted, px. Points at which the distortion is not
        invertible are left out (few boards may leave it so in the corners), and those that a
        fisheye lens sees so far out that a rectified image would stretch them threefold.
    jacobians : (N, 2, 2) float64
        Derivative of the undistorted by the raw position at each point.
    usable_share : float
        Share of the grid at which the distortion is invertible, of that which is less than 90
        degrees from the optical axis.

    """

    points_px: FloatArray
    jacobians: FloatArray
    usable_share: float

    @classmethod
    def of(cls, calibration: StereoCalibration, side: str) -> ImageGrid:
        """Make the grid over the image of ``'left'`` or ``'right'``."""
        width, height = calibration.image_size
        axes = np.linspace(0, width - 1, _GRID), np.linspace(0, height - 1, _GRID)
        raw = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
        points = calibration.undistort(raw, side)
        jacobians = _jacobians(calibration, raw, side)
        K, D, _, _ = calibration.side(side)
        lens = calibration.lens_model
        expected = lens.in_front((raw - K[:2, 2]) / np.diag(K)[:2], D)
        rays = (points - K[:2, 2]) / np.diag(K)[:2]
        # compared with the ideal lens: next to a fold the image is torn apart
        own, ideal = (lens.derivatives(rays, d, np.ones(2))[1] for d in (D, np.zeros_like(D)))
        usable = _scales_little(own @ np.linalg.inv(ideal))
        # where even an ideal fisheye lens stretches a lot, a rectified image is of little use
        kept = usable & _scales_little(jacobians)
        share = float(usable[expected].mean())
        if share < _LEAST_USABLE:
            raise CalibrationError(
                f'the distortion of the {side} camera is not invertible in {1 - share:.0%} of the'
                ' image; capture boards in more of the image'
            )
        return cls(points[kept], jacobians[kept], share)

    def resampling(self, homography: FloatArray) -> FloatArray:
        """Return how far each singular value of raw -> corrected departs from 1, (2 N,)."""
        mapped = np.column_stack([self.points_px, np.ones(len(self.points_px))]) @ homography.T
        w = mapped[:, 2:, None]
        projective = (homography[:2, :2] * w - mapped[:, :2, None] * homography[2, :2]) / w**2
        values = np.linalg.svd(projective @ self.jacobians, compute_uv=False)
        return np.asarray(values.ravel() - 1, np.float64)

    def denominators(self, homography: FloatArray) -> FloatArray:
        """Return the third homogeneous coordinate of the mapped grid, (N,)."""
        w: FloatArray = self.points_px @ homography[2, :2] + homography[2, 2]
        return w


def _jacobians(calibration: StereoCalibration, raw: FloatArray, side: str) -> FloatArray:
    """Return the derivatives of undistorted by raw positions (N, 2), (N, 2, 2); NaN = none."""
    columns = [
        calibration.undistort(raw + s, side) - calibration.undistort(raw - s, side)
        for s in 0.5 * np.eye(2)
    ]
    return np.stack(columns, axis=-1)


def _scales_little(jacobians: FloatArray) -> Mask:
    """Return which matrices (N, 2, 2) scale by less than ``_TORN`` in any direction, (N,)."""
    known: Mask = np.all(np.isfinite(jacobians), axis=(1, 2))
    scales = np.full((len(known), 2), np.inf)
    scales[known] = np.linalg.svd(jacobians[known], compute_uv=False)
    little: Mask = np.all(np.abs(np.log(scales)) < _TORN, axis=-1)
    return little


def apply(homography: FloatArray, pixels: FloatArray) -> FloatArray:
    """Map (..., 2) px by a homography; NaN stays NaN."""
    mapped = pixels @ homography[:, :2].T + homography[:, 2]
    result: FloatArray = mapped[..., :2] / mapped[..., 2:]
    return result


def apply_inverse(homography: FloatArray, pixels: FloatArray) -> FloatArray:
    """Map (..., 2) px by the inverse of a homography."""
    inverse: FloatArray = np.linalg.inv(homography).astype(np.float64, copy=False)
    return apply(inverse, pixels)


def centring(
    aligned: Correction, left: ImageGrid, right: ImageGrid, image_size: tuple[int, int]
) -> tuple[FloatArray, FloatArray]:
    """Return the shifts (l3, r3 and the common u0 of eq. 9) that centre both images."""
    means = [
        apply(H, grid.points_px).mean(axis=0)
        for H, grid in ((aligned.H_left, left), (aligned.H_right, right))
    ]
    x_centre, y_centre = (image_size[0] - 1) / 2, (image_size[1] - 1) / 2
    rows = y_centre - (means[0][1] + means[1][1]) / 2
    shifts = [np.array([[1, 0, x_centre - mean[0]], [0, 1, rows], [0, 0, 1]]) for mean in means]
    return shifts[0], shifts[1]


def check_in_front(*denominators: FloatArray) -> None:
    """Raise a CalibrationError unless a homography maps its whole image in front of the camera."""
    if min(w.min() for w in denominators) <= 0:
        raise CalibrationError(
            'an epipole lies too close to its image for rows to be aligned; mount the cameras'
            ' side by side with their axes nearly parallel'
        )
