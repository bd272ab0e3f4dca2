# SPDX-License-Identifier: Apache-2.0
"""Planes fitted to the cloud: the ground, and faces whose flatness is asked.

A fitted plane is held by three of its points, far apart, as the images would show them: their
errors of matching are independent and those of the calibration are the ones of any point there,
so that what is measured against the plane has the right correlation with it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from binocular_recon.camera import FloatArray
from binocular_recon.errors import MeasurementError
from binocular_recon.measurement.frame import MeasuredFrame
from binocular_recon.measurement.robust_fits import consensus_fit, refined_fit
from binocular_recon.measurement.uncertain import Uncertain
from binocular_recon.number_text import counted

# The camera is held level to this, degrees.
MOST_TILT_DEG = 20.0
# A point agrees with the ground within about this, px of disparity.
SCATTER_PX = 0.15
GROUND_POINTS = 20_000
# What matching leaves of a fitted plane at each of its three points, px: errors of neighbours are
# alike, and the ground is not flat.
PLANE_SIGMA_PX = 0.05


class Plane(NamedTuple):
    """A fitted plane.

    Attributes
    ----------
    inverse : (3,) float64
        ``inverse @ (point / depth)`` is disparity without offset, px: the normal, scaled.
    support : Uncertain
        Three points of the plane, (9,) m.

    """

    inverse: FloatArray
    support: Uncertain


def fitted_ground(frame: MeasuredFrame) -> Plane:
    """Return the ground: the level plane that most of the lower half of the cloud agrees on.

    Raises
    ------
    MeasurementError
        If the cloud shows no ground.

    """
    points = frame.points_xyz
    lower = points[points.shape[0] // 2 :].reshape(-1, 3)
    lower = lower[np.isfinite(lower[:, 2])]
    lower = lower[:: len(lower) // GROUND_POINTS + 1]
    if len(lower) < GROUND_POINTS // 100:
        raise MeasurementError(
            f'the lower half of the cloud has {counted(len(lower), "point")}, too few to find the'
            ' ground; widen the range of depths'
        )
    least = np.cos(np.deg2rad(MOST_TILT_DEG))
    rays, disparity = lower / lower[:, 2:], frame.focal_baseline / lower[:, 2]
    inverse = consensus_fit(
        rays,
        disparity,
        np.ones(len(lower)),
        SCATTER_PX,
        lambda normal: bool(normal[1] > least * np.linalg.norm(normal)),
    )
    if inverse is None:
        raise MeasurementError('the cloud shows no level ground in the lower half of the image')
    agreeing = np.abs(rays @ inverse - disparity) < SCATTER_PX
    return _plane(frame, inverse, rays[agreeing], 'ground', PLANE_SIGMA_PX)


def fitted_plane(frame: MeasuredFrame, points_xyz: FloatArray, name: str) -> Plane:
    """Return the plane through points (N, 3) of the cloud, m; odd ones count little.

    Raises
    ------
    MeasurementError
        If the points do not span a plane.

    """
    rays, disparity = points_xyz / points_xyz[:, 2:], frame.focal_baseline / points_xyz[:, 2]
    if len(points_xyz) < 3 or np.linalg.matrix_rank(rays) < 3:
        raise MeasurementError(
            f'{name}: {counted(len(points_xyz), "point spans", "points span")} no plane; pick'
            ' a larger one'
        )
    ones = np.ones(len(rays))
    start = consensus_fit(rays, disparity, ones, 2 * SCATTER_PX)
    if start is None:
        raise MeasurementError(f'{name}: the points span no plane; pick a larger one')
    inverse = refined_fit(rays, disparity, ones, 2 * SCATTER_PX, start)
    return _plane(frame, inverse, rays, name, PLANE_SIGMA_PX)


def _plane(
    frame: MeasuredFrame, inverse: FloatArray, rays: FloatArray, name: str, sigma_px: float
) -> Plane:
    """Return a plane with three points around the middle of those that it was fitted to."""
    middle = rays.mean(axis=0)
    _, spread, axes = np.linalg.svd(rays - middle, full_matrices=False)
    step = axes[:2] * spread[:2, None] / np.sqrt(len(rays))
    # an equilateral triangle whose spread is that of the points
    corners = np.array([[0.0, 1.0], [np.sqrt(0.75), -0.5], [-np.sqrt(0.75), -0.5]]) * np.sqrt(2)
    chosen = middle + corners @ step
    disparity = chosen @ inverse
    points = chosen * (frame.focal_baseline / disparity)[:, None]
    per_px = -points / disparity[:, None]
    matching = np.zeros((9, 3))
    for i in range(3):
        matching[3 * i : 3 * i + 3, i] = sigma_px * per_px[i]
    support = Uncertain(points.ravel(), {('matching', name): matching})
    return Plane(inverse, frame.calibrated(support))


def normal_of(support: FloatArray) -> FloatArray:
    """Return the unit normal (3,) of the plane through three points (9,), towards the camera."""
    first, second, third = support.reshape(3, 3)
    normal = np.cross(second - first, third - first)
    normal /= np.linalg.norm(normal)
    return normal if normal @ first < 0 else -normal


def height_above(support: FloatArray, point: FloatArray) -> float:
    """Return how far a point (3,) is on the camera's side of the plane (9,), m."""
    return float(normal_of(support) @ (point - support[:3]))
