# SPDX-License-Identifier: Apache-2.0
"""An organised cloud as a frame to measure in, where its disparities are not at hand."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from binocular_recon.camera import Camera, FloatArray, StereoRig
from binocular_recon.cloud_config import CloudConfig
from binocular_recon.errors import MeasurementError
from binocular_recon.measurement.frame import MeasuredFrame
from binocular_recon.stereo.triangulation import triangulate
from binocular_recon.stereo.validity import Validity

# Least share of a standard deviation that is that of matching.
_LEAST_MATCHING = 0.2
_LEAST_POINTS = 100
_ALL = CloudConfig(max_sigma='100%')


def frame_of_cloud(
    points_xyz: npt.NDArray[np.float32],
    sigma_z_m: npt.NDArray[np.float32],
    rig: StereoRig | None = None,
    *,
    with_calibration: bool = False,
) -> MeasuredFrame:
    """Return the frame of an organised cloud in the left rectified frame.

    Parameters
    ----------
    points_xyz : (H, W, 3) float32
        Points, m; NaN = none.
    sigma_z_m : (H, W) float32
        One standard deviation of their depth, m.
    rig : StereoRig, optional
        The calibration that the cloud was made with, for its covariance.
    with_calibration : bool
        Whether ``sigma_z_m`` has the calibration's share, which is then taken out.

    Raises
    ------
    MeasurementError
        If the cloud is not organised, or has too few points.

    """
    height, width = sigma_z_m.shape
    known = np.isfinite(points_xyz).all(axis=-1) & np.isfinite(sigma_z_m)
    rows, columns = np.nonzero(known)
    if min(height, width) < 2 or len(rows) < _LEAST_POINTS:
        raise MeasurementError(
            f'the cloud of {width}x{height} points has {len(rows)} that are valid; measuring needs'
            f' an organised cloud with {_LEAST_POINTS} or more'
        )
    rays = points_xyz[known].astype(np.float64)
    rays = rays[:, :2] / rays[:, 2:]
    fx, cx = _line(rays[:, 0], columns)
    fy, cy = _line(rays[:, 1], rows)
    baseline_m = 1.0 if rig is None else rig.baseline_m
    K = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    left, right = (
        Camera(width, height, K, np.zeros(5), np.eye(3), np.column_stack([K, [-fx * shift, 0, 0]]))
        for shift in (0.0, baseline_m)
    )
    found = StereoRig(left, right, covariance=None if rig is None else rig.covariance)
    depth_m = np.where(known, points_xyz[..., 2], np.nan).astype(np.float64)
    disparity = (fx * baseline_m / depth_m).astype(np.float32)
    validity = np.where(known, Validity.MEASURED, 0).astype(np.uint8)
    variance = sigma_z_m.astype(np.float64) ** 2
    if with_calibration and found.covariance is not None:
        shared = triangulate(disparity, np.zeros_like(disparity), validity, found, _ALL).sigma_z_m
        variance = np.maximum(
            variance - shared.astype(np.float64) ** 2, _LEAST_MATCHING**2 * variance
        )
    sigma = (np.sqrt(variance) * fx * baseline_m / depth_m**2).astype(np.float32)
    image = np.zeros((height, width, 3), np.uint8)
    return MeasuredFrame(found, disparity, sigma, validity, image, limits=_ALL)


def nearest_pixel(points_xyz: npt.NDArray[np.float32], place: FloatArray) -> FloatArray:
    """Return the pixel (2,) of the point of a cloud (H, W, 3) that is nearest to a place (3,).

    Raises a MeasurementError if the cloud has no point.
    """
    away = np.sum((points_xyz - place.astype(np.float32)) ** 2, axis=-1)
    if np.isnan(away).all():
        raise MeasurementError('the cloud has no points; wait for one that has')
    row, column = np.unravel_index(np.nanargmin(away), away.shape)
    return np.array([column, row], np.float64)


def _line(slopes: FloatArray, pixels: npt.NDArray[np.intp]) -> tuple[float, float]:
    """Return focal length and principal point, px, of an axis: ``pixel = f slope + c``."""
    spread = slopes - slopes.mean()
    if not np.any(spread):
        raise MeasurementError('the points of the cloud lie in one line; measuring needs an area')
    focal = float(spread @ pixels / (spread @ spread))
    return focal, float(pixels.mean() - focal * slopes.mean())
