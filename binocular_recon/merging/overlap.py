# SPDX-License-Identifier: Apache-2.0
"""The pose of a station against another one, from what both see.

Features of the left images are points in both clouds. They give a first pose that needs no guess,
and its covariance; the clouds refine it (generalised ICP). Sources: Lowe, "Distinctive image
features from scale-invariant keypoints" (2004); Segal et al., "Generalized-ICP" (2009).
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from binocular_recon.camera import FloatArray
from binocular_recon.errors import MeasurementError
from binocular_recon.images import Mask
from binocular_recon.machine import optional_package
from binocular_recon.measurement.frame import MeasuredFrame
from binocular_recon.number_text import counted
from binocular_recon.rotations import rigid_fit, similarity_derivatives

# A match of features is clear if the second best is farther by this factor.
_RATIO = 0.8
# Features are located to this, px.
_FEATURE_PX = 1.0
LEAST_PAIRS = 12
_SAMPLES, _BATCH = 2000, 100
# Pairs belong to a pose within this many standard deviations.
_WITHIN = 3.0
# The clouds are thinned to this share of the median depth for the refinement, and looked at up to
# this multiple of it.
_CELL, _REACH = 0.004, 5.0
# The refinement may move the points that both see by this many standard deviations.
_MOST_MOVED = 4.0


class Pose(NamedTuple):
    """``x_there = R x_here + t``.

    Attributes
    ----------
    R, t : (3, 3), (3,) float64
    covariance : (6, 6) float64
        Of a small turn about ``centre`` in the axes there, and of the place of the centre.
    centre : (3,) float64
        Middle of what both see, there.
    pairs : int
        Features that agree.

    """

    R: FloatArray
    t: FloatArray
    covariance: FloatArray
    centre: FloatArray
    pairs: int


class _Features(NamedTuple):
    points: FloatArray
    sigmas: FloatArray
    descriptors: FloatArray


def find_pose(here: MeasuredFrame, there: MeasuredFrame) -> Pose:
    """Return the pose of one frame in the frame of another one.

    Raises
    ------
    DependencyError
        If small_gicp is not installed.
    MeasurementError
        If they see too little in common, or features and clouds contradict each other.

    """
    gicp = optional_package('small_gicp', 'stations that are joined by their overlap')
    ours, theirs = _features(here), _features(there)
    pairs = _pairs(ours, theirs)
    a, b = ours.points[pairs[:, 0]], theirs.points[pairs[:, 1]]
    sigma = np.hypot(ours.sigmas[pairs[:, 0]], theirs.sigmas[pairs[:, 1]])
    agree = _consensus(a, b, sigma)
    if agree.sum() < LEAST_PAIRS:
        raise MeasurementError(
            f'only {counted(int(agree.sum()), "feature is", "features are")} seen in both at'
            f' places that fit together, at least {LEAST_PAIRS} are needed; let the stations see'
            ' more of the same from similar directions, or georeference each with control points'
        )
    a, b, sigma = a[agree], b[agree], sigma[agree]
    R, t, covariance = _fit(a, b, sigma)
    cell = _CELL * float(np.median(there.points_xyz[..., 2][there.measured]))
    clouds = [frame.points_xyz[_usable(frame)] for frame in (there, here)]
    start = np.eye(4)
    start[:3, :3], start[:3, 3] = R, t
    found = gicp.align(
        clouds[0], clouds[1], start, downsampling_resolution=cell,
        max_correspondence_distance=_REACH * cell, max_iterations=100,
    )  # fmt: skip
    refined_R = np.asarray(found.T_target_source[:3, :3], np.float64)
    refined_t = np.asarray(found.T_target_source[:3, 3], np.float64)
    centre = b.mean(axis=0)
    moved = float(np.linalg.norm((a @ refined_R.T + refined_t).mean(axis=0) - centre))
    allowed = _MOST_MOVED * float(np.sqrt(np.trace(covariance[3:, 3:]))) + cell
    if not found.converged or moved > allowed:
        raise MeasurementError(
            f'features and surfaces do not fit together: the surfaces are {moved:.3f} m from where'
            f' the features put them, at most {allowed:.3f} m is allowed; let the stations see'
            ' more of the same, or georeference each with control points'
        )
    return Pose(refined_R, refined_t, covariance, centre, len(a))


def surface_distances(points: FloatArray, others: FloatArray, reach_m: float) -> FloatArray:
    """Return how far points, (N, 3), lie from the surface of others, (M, 3), (N,) m.

    Along the normal of the plane through the ten nearest ones; NaN beyond ``reach_m``.
    """
    tree = cKDTree(others)
    nearest, places = tree.query(points, 10, distance_upper_bound=4 * reach_m)
    seen = np.isfinite(nearest).all(axis=1) & (nearest[:, 0] < reach_m)
    distances = np.full(len(points), np.nan)
    patches = others[places[seen]]
    middle = patches.mean(axis=1)
    normals = np.linalg.svd(patches - middle[:, None], full_matrices=False)[2][:, 2]
    distances[seen] = np.einsum('ni,ni->n', points[seen] - middle, normals)
    return distances


def _usable(frame: MeasuredFrame) -> Mask:
    usable: Mask = frame.measured & np.isfinite(frame.points_xyz).all(axis=-1)
    return usable


def _features(frame: MeasuredFrame) -> _Features:
    """Return the features of the left image that have a measured point."""
    grey = cv2.cvtColor(frame.left_bgr, cv2.COLOR_BGR2GRAY)
    keys, descriptors = cv2.SIFT_create(nfeatures=6000).detectAndCompute(grey, None)
    if descriptors is None:
        return _Features(np.empty((0, 3)), np.empty(0), np.empty((0, 128)))
    columns, rows = np.rint([key.pt for key in keys]).astype(int).T
    kept = _usable(frame)[rows, columns]
    columns, rows = columns[kept], rows[kept]
    points = frame.points_xyz[rows, columns]
    depth = points[:, 2]
    sigma_z = depth**2 / frame.focal_baseline * frame.sigma_px[rows, columns]
    sigmas = np.hypot(sigma_z, _FEATURE_PX * depth / frame.rig.focal_px)
    return _Features(points, sigmas, np.asarray(descriptors)[kept])


def _pairs(ours: _Features, theirs: _Features) -> npt.NDArray[np.intp]:
    """Return the indices of features that are clearly the same, (n, 2)."""
    if min(len(ours.points), len(theirs.points)) < 2:
        return np.empty((0, 2), int)
    found = cv2.BFMatcher().knnMatch(ours.descriptors, theirs.descriptors, 2)
    clear = [one for one, two in found if one.distance < _RATIO * two.distance]
    return np.array([(one.queryIdx, one.trainIdx) for one in clear], int).reshape(-1, 2)


def _consensus(a: FloatArray, b: FloatArray, sigma: FloatArray) -> Mask:
    """Return which pairs agree with the pose that most agree with (RANSAC)."""
    best: Mask = np.zeros(len(a), bool)
    if len(a) < 3:
        return best
    rng = np.random.default_rng(0)
    for _ in range(0, _SAMPLES, _BATCH):
        some = rng.integers(0, len(a), (_BATCH, 3))
        R, t = rigid_fit(a[some], b[some])
        off = np.einsum('sij,nj->sni', R, a) + t[:, None] - b
        agree = (off**2).sum(axis=-1) < (_WITHIN * sigma) ** 2
        most = agree[int(agree.sum(axis=1).argmax())]
        if most.sum() > best.sum():
            best = most
    return best


def _fit(
    a: FloatArray, b: FloatArray, sigma: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return R, t and the covariance of `Pose`, from pairs with isotropic errors."""
    weight = 1 / sigma**2
    R, t = rigid_fit(a, b, weight)
    turned = a @ R.T + t - b.mean(axis=0)
    design = similarity_derivatives(turned)[..., :6]  # without scale
    normal = np.einsum('nij,n,nik->jk', design, weight, design)
    off = a @ R.T + t - b
    freedom = max(1, 3 * len(a) - 6)
    misfit = float(weight @ (off**2).sum(axis=1)) / freedom
    return R, t, np.linalg.inv(normal) * max(1.0, misfit)
