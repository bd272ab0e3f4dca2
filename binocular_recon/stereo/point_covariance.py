# SPDX-License-Identifier: Apache-2.0
"""What the covariance of a calibration means for points: their covariance, also between points.

A point is measured by three numbers: column and row of its pixel in the left image, and the
column of its match in the right one. With these held, a change of the calibration moves the
point; the derivatives of that times the covariance of the calibration give that of points. The
calibration is the same for every point, so errors of neighbouring points are nearly equal, and
much of them cancels in the distance between two. Source: error propagation as in Hartley and
Zisserman, "Multiple View Geometry" (2nd ed.), section 5.2.
"""

from __future__ import annotations

import dataclasses
import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from binocular_recon.camera import FloatArray, RigCovariance, StereoRig
from binocular_recon.errors import CalibrationError
from binocular_recon.lenses.lens import Lens
from binocular_recon.lenses.projection import project_derivatives
from binocular_recon.rotations import cross_matrix, quarter_turn
from binocular_recon.stereo.orientation import lying_covariance

# Nodes of the grid of variances over the columns of the left and of the right image and the rows.
_GRID = 41, 41, 25


def joint_covariance(
    points_xyz: FloatArray, rig: StereoRig, disparity_sigma_px: npt.ArrayLike = 0.0
) -> FloatArray:
    """Return the covariance of points with each other.

    Parameters
    ----------
    points_xyz : (N, 3) float64
        Points in the left rectified frame, m.
    rig : StereoRig
        The calibrated or the rectified rig, with its covariance.
    disparity_sigma_px : float or (N,) float64
        One standard deviation of the points' disparities, px; taken as independent, which holds
        for points farther apart than the window of matching.

    Returns
    -------
    (N, 3, N, 3) float64
        m^2: between coordinate j of point i and coordinate l of point k.

    Raises
    ------
    CalibrationError
        If the rig has no covariance.

    """
    points = np.asarray(points_xyz, np.float64)
    derivatives = calibration_derivatives(points, rig)
    known = _known(rig)
    covariance: FloatArray = np.einsum(
        'nip,pq,mjq->nimj', derivatives, known.matrix, derivatives, optimize=True
    )
    along = (
        matching_spread(points, rig) * np.broadcast_to(disparity_sigma_px, len(points))[:, None]
    )
    index = np.arange(len(points))
    covariance[index, :, index, :] += along[:, :, None] * along[:, None, :]
    return covariance


def matching_spread(points_xyz: FloatArray, rig: StereoRig) -> FloatArray:
    """Return how far points move per px of disparity, towards farther: (N, 3) float64, m/px."""
    depth_m = points_xyz[:, 2:]
    moved: FloatArray = points_xyz * depth_m / (rig.focal_px * rig.baseline_m)
    return moved


def calibration_derivatives(points_xyz: FloatArray, rig: StereoRig) -> FloatArray:
    """Return how measured points move with the parameters of the calibration.

    Parameters
    ----------
    points_xyz : (N, 3) float64
        Points in the left rectified frame, m.
    rig : StereoRig
        The calibrated or the rectified rig, with its covariance.

    Returns
    -------
    (N, 3, p) float64
        By ``rig.covariance.parameters``.

    Raises
    ------
    CalibrationError
        If the rig has no covariance.

    """
    turn = quarter_turn(rig.turns)  # to the frame whose x axis is the baseline, and back
    moved: FloatArray = turn.T @ point_derivatives(*_raw_cameras(_known(rig)), points_xyz @ turn.T)
    return moved


def add_covariance(rig: StereoRig, known: RigCovariance | None) -> StereoRig:
    """Return a rig of camera infos with the covariance of the calibration that they come from.

    Raises
    ------
    CalibrationError
        If the covariance is that of another rig.

    """
    if known is None:
        return rig
    calibrated = StereoRig(known.left, known.right)
    # alpha scales the focal length; it leaves the baseline and the places of the cameras
    if not math.isclose(rig.baseline_m, calibrated.baseline_m, rel_tol=1e-6) or (
        rig.left.size != calibrated.left.size
    ):
        raise CalibrationError(
            f'the calibration folder is that of another rig: {calibrated.left.width}x'
            f'{calibrated.left.height} px and a baseline of {calibrated.baseline_m:.6f} m there,'
            f' {rig.left.width}x{rig.left.height} px and {rig.baseline_m:.6f} m in the camera'
            ' infos; use one calibration in all nodes'
        )
    return dataclasses.replace(rig, covariance=known)


def sigma_shares(calibrated: bool) -> str:
    """Return what the standard deviations of points hold, for a person."""
    if calibrated:
        return 'matching and calibration'
    return 'matching only: the covariance of the calibration is not known'


@lru_cache(maxsize=4)
def variance_grid(rig: StereoRig) -> npt.NDArray[np.float32]:
    """Return the calibration's share of the variance of points, divided by the depth^4.

    That is smooth over both images and finite up to infinity, so a point's variance can be
    interpolated: linearly, to about 1 % of its standard deviation, and to larger values beyond 60
    degrees from the axis of a fisheye.

    Parameters
    ----------
    rig : StereoRig
        The rectified rig; its rows correspond (`lying_rig`).

    Returns
    -------
    (columns, columns, rows, 3) float32
        Over the width of the left image, of the right image, and over their height: variances of
        x, y and z, 1/m^2. Empty if the rig has no covariance.

    """
    known = rig.covariance
    if known is None:
        return np.empty((0, 0, 0, 3), np.float32)
    P = rig.left.P
    left, right, row = np.meshgrid(
        *(
            np.linspace(0, length - 1, count)
            for length, count in zip(
                (rig.left.width, rig.right.width, rig.left.height), _GRID, strict=True
            )
        ),
        indexing='ij',
    )
    rays = np.stack([(left - P[0, 2]) / P[0, 0], (row - P[1, 2]) / P[1, 1]], axis=-1)
    inverse_depth = (left - right - rig.disparity_offset_px) / (rig.focal_px * rig.baseline_m)
    derivatives = scaled_derivatives(
        *_raw_cameras(known), rays.reshape(-1, 2), inverse_depth.ravel()
    )
    variances = np.einsum('nip,nip->ni', derivatives @ known.matrix, derivatives)
    grid: npt.NDArray[np.float32] = variances.reshape(*_GRID, 3).astype(np.float32)
    return grid


def _known(rig: StereoRig) -> RigCovariance:
    if rig.covariance is None:
        raise CalibrationError(
            'the covariance of this calibration is not known: camera infos do not carry it; use'
            ' the folder of a calibration with calibration.json'
        )
    return rig.covariance


def _raw_cameras(known: RigCovariance) -> tuple[RawCamera, RawCamera, float]:
    """Return the cameras of a calibrated rig and its baseline, m; its x axis is the baseline."""
    known = lying_covariance(known)
    left, right = (
        RawCamera(camera.lens, camera.K, known.distortion(camera), camera.R)
        for camera in (known.left, known.right)
    )
    return left, right, StereoRig(known.left, known.right).baseline_m


class RawCamera(NamedTuple):
    """A camera whose parameters may change: lens, K, all calibrated D, and R that rectifies it."""

    lens: Lens
    K: FloatArray
    D: FloatArray
    R: FloatArray


def point_derivatives(
    left: RawCamera, right: RawCamera, baseline_m: float, points_xyz: FloatArray
) -> FloatArray:
    """Return how measured points (N, 3), m, move with the parameters of the cameras, (N, 3, p).

    The points are in the left rectified frame; cameras and parameters as in
    `scaled_derivatives`.
    """
    inverse_depth = 1 / points_xyz[:, 2]
    rays = points_xyz[:, :2] * inverse_depth[:, None]
    scaled = scaled_derivatives(left, right, baseline_m, rays, inverse_depth)
    derivatives: FloatArray = scaled / inverse_depth[:, None, None] ** 2
    return derivatives


def scaled_derivatives(
    left: RawCamera,
    right: RawCamera,
    baseline_m: float,
    rays: FloatArray,
    inverse_depth: FloatArray,
) -> FloatArray:
    """Return the derivatives of measured points by the parameters, divided by the depth^2.

    That is finite at infinity, too.

    Parameters
    ----------
    left, right : RawCamera
        Both with a rectified frame whose x axis is the baseline.
    baseline_m : float
    rays : (N, 2) float64
        X / Z and Y / Z in the left rectified frame.
    inverse_depth : (N,) float64
        1 / Z, 1/m.

    Returns
    -------
    (N, 3, p) float64
        1/m per unit of each of `parameter_names`.

    """
    ahead = np.concatenate([rays, np.ones_like(rays[:, :1])], axis=-1)

    # the left ray: its pixel stays where it is
    _, by_point, by_left = project_derivatives(ahead @ left.R, left.lens, left.K, left.D)
    ray_steps = -np.linalg.solve((by_point @ left.R.T)[..., :2], by_left)

    # the match stays in its rectified column; along it, rows may change
    seen = ahead - np.array([baseline_m, 0, 0]) * inverse_depth[:, None]
    _, by_point, by_right = project_derivatives(seen @ right.R, right.lens, right.K, right.D)
    to_column = np.linalg.inv((by_point @ right.R.T)[..., :2])[:, :1]
    by_turn = -by_point @ cross_matrix(ahead @ right.R)
    by_shift = by_point * inverse_depth[:, None, None]
    column_steps = (to_column @ np.concatenate([by_right, by_turn, by_shift], axis=-1))[:, 0]

    count = by_left.shape[-1]
    # of the inverse depth
    depth_steps = np.concatenate([ray_steps[:, 0], column_steps], axis=-1) / baseline_m
    scaled: FloatArray = -ahead[:, :, None] * depth_steps[:, None, :]
    scaled[:, :2, :count] += ray_steps * inverse_depth[:, None, None]
    return scaled
