# SPDX-License-Identifier: Apache-2.0
"""What the covariance of a calibration means for depth over the field of view."""

from __future__ import annotations

import numpy as np

from binocular_recon.calibration.model import StereoCalibration
from binocular_recon.camera import FloatArray
from binocular_recon.images import Mask
from binocular_recon.stereo.point_covariance import RawCamera, point_derivatives

# Depth is judged over the middle half of the image's width and height.
FIELD_SHARE = 0.5
_FIELD_POINTS = 7, 5


def field_of_view(
    calibration: StereoCalibration, depth_m: float, share: float = FIELD_SHARE
) -> FloatArray:
    """Return a grid of points at one depth in the middle of the left image.

    Parameters
    ----------
    calibration : StereoCalibration
        Both cameras.
    depth_m : float
        Distance along the left camera's optical axis, m.
    share : float
        Share of width and of height that the grid covers.

    Returns
    -------
    (N, 3) float64
        Points that the right camera sees too, left frame, m; none if the images do not overlap.

    """
    width, height = calibration.image_size
    margin = (1 - share) / 2
    axes = [
        np.linspace(margin, 1 - margin, count) * (length - 1)
        for count, length in zip(_FIELD_POINTS, (width, height), strict=True)
    ]
    pixels = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
    points = points_at(calibration, pixels, depth_m)
    right = calibration.project(points, 'right')
    visible = ((right >= 0) & (right <= [width - 1, height - 1])).all(axis=-1)
    return points[visible]


def points_at(calibration: StereoCalibration, pixels: FloatArray, depth_m: float) -> FloatArray:
    """Return the points seen at (..., 2) px of the raw left image at a depth, (..., 3) m."""
    K = calibration.K_left
    plane = (calibration.undistort(pixels, 'left') - K[:2, 2]) / np.diag(K)[:2]
    return np.concatenate([plane, np.ones_like(plane[..., :1])], axis=-1) * depth_m


def depth_derivatives(
    calibration: StereoCalibration, free: Mask, points_m: FloatArray
) -> FloatArray:
    """Return by how much the depth of measured points changes with each free parameter, (N, n).

    The points are those of the left camera's frame, (N, 3) m, and so is their depth.
    """
    R = calibration.facing
    left, right = (
        RawCamera(calibration.lens_model, *calibration.side(side)[:2], turned)
        for side, turned in (('left', R), ('right', R @ calibration.R.T))
    )
    moved = point_derivatives(left, right, calibration.baseline_m, points_m @ R.T)
    derivatives: FloatArray = np.einsum('nip,i->np', moved, R[:, 2])
    return derivatives[:, free]


def depth_sigma_m(
    calibration: StereoCalibration, free: Mask, covariance: FloatArray, points_m: FloatArray
) -> FloatArray:
    """Return one standard deviation of each point's depth due to the calibration, (N,) m."""
    derivatives = depth_derivatives(calibration, free, points_m)
    variance = np.einsum('ni,ij,nj->n', derivatives, covariance, derivatives)
    sigma: FloatArray = np.sqrt(variance)
    return sigma


def matching_sigma_m(
    focal_px: float, baseline_m: float, depth_m: FloatArray, disparity_sigma_px: float
) -> FloatArray:
    """Return one standard deviation of depth due to noise of the disparity, m (section 2.4)."""
    sigma: FloatArray = depth_m**2 / (focal_px * baseline_m) * disparity_sigma_px
    return sigma


def baseline_sigma_m(calibration: StereoCalibration, free: Mask, covariance: FloatArray) -> float:
    """Return one standard deviation of the baseline, m."""
    direction = np.zeros(len(calibration.parameters))
    direction[-3:] = calibration.T / calibration.baseline_m
    return float(np.sqrt(direction[free] @ covariance @ direction[free]))
