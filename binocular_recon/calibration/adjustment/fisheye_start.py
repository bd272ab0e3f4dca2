# SPDX-License-Identifier: Apache-2.0
"""Start values of a wide-angle camera.

Zhang's method needs homographies, which a fisheye image does not follow. Its one unknown that
matters at first is the focal length: for every one tried, the marks become rays of the ideal lens
(coefficients 0), each board gets its pose from them, and the focal length that reproduces the
marks best is taken. The adjustment does the rest.
"""

from __future__ import annotations

import cv2
import numpy as np

from binocular_recon.calibration.adjustment._camera_estimate import CameraEstimate
from binocular_recon.camera import FloatArray
from binocular_recon.errors import CalibrationError
from binocular_recon.lenses.lens import Lens

# Focal lengths tried, as shares of the longer side of the image; then finer about the best one.
_FOCAL_SHARES = np.geomspace(0.15, 3.0, 31)
_FINER = np.geomspace(0.9, 1.1, 13)
# Boards that the focal length is chosen with.
_BOARDS = 20
# Rays farther out lie so far from the centre of the plane at depth 1 that they alone would set
# the pose of a board, rad.
_LARGEST_ANGLE = np.radians(80)
_LEAST_MARKS = 6


def start_fisheye(
    points: FloatArray, pixels: FloatArray, image_size: tuple[int, int], lens: Lens
) -> CameraEstimate:
    """Return a camera with the ideal lens and the boards' poses.

    Parameters
    ----------
    points : (N, 3) float64
        Marks of a board, m.
    pixels : (B, N, 2) float64
        Where they were found, px; NaN = not found.
    image_size : (int, int)
        Width and height, px.
    lens : Lens
        Its coefficients are taken as 0.

    Raises
    ------
    CalibrationError
        If no focal length fits, or a board has too few marks within 80 degrees of the axis.

    """
    K, _ = fisheye_guess(points, pixels, image_size, lens)
    poses = [_pose(points, rays) for rays in _rays(pixels, K, lens)]
    found = [pose for pose in poses if pose is not None]
    if len(found) < len(poses):
        raise CalibrationError(
            f'{len(poses) - len(found)} of {len(poses)} boards have fewer than {_LEAST_MARKS}'
            f' marks within 80 degrees of the optical axis that fit a lens {lens.name}; leave'
            ' these boards out, or calibrate with another lens'
        )
    return CameraEstimate(
        K,
        _no_distortion(lens),
        np.array([R for R, _ in found]),
        np.array([shift for _, shift in found]),
    )


def fisheye_guess(
    points: FloatArray, pixels: FloatArray, image_size: tuple[int, int], lens: Lens
) -> tuple[FloatArray, FloatArray]:
    """Return K of the camera with the ideal lens that fits best, and each board's error, px.

    The principal point is the centre of the image. Errors (B,) are root mean squares of the
    distance; inf where a board has no pose.
    """
    some = pixels[np.unique(np.linspace(0, len(pixels) - 1, _BOARDS).astype(int))]
    shares = _FOCAL_SHARES
    for _ in range(2):
        cameras = np.array([_ideal(share * max(image_size), image_size) for share in shares])
        errors = np.median(_errors(points, some, cameras, lens), axis=1)
        best = int(np.argmin(errors))
        shares = shares[best] * _FINER
    if not np.isfinite(errors[best]):
        raise CalibrationError(
            f'no {lens.name} camera fits the marks; check that rods.yaml states the rods in the'
            ' images and that the lens is such a one, and capture boards at more distances and'
            ' angles'
        )
    return cameras[best], _errors(points, pixels, cameras[best : best + 1], lens)[0]


def pinhole_pixels(pixels: FloatArray, K: FloatArray, lens: Lens) -> FloatArray:
    """Return pixels (..., 2) of a camera with the ideal lens as those of a pinhole with its K.

    NaN beyond 80 degrees from the axis.
    """
    return np.diag(K)[:2] * _rays(pixels, K, lens) + K[:2, 2]


def _ideal(focal: float, image_size: tuple[int, int]) -> FloatArray:
    width, height = image_size
    return np.array([[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1.0]])


def _no_distortion(lens: Lens) -> FloatArray:
    return np.zeros(len(lens.COEFFICIENTS))


def _rays(pixels: FloatArray, K: FloatArray, lens: Lens) -> FloatArray:
    return _near_rays((pixels - K[:2, 2]) / np.diag(K)[:2], lens)


def _near_rays(distorted: FloatArray, lens: Lens) -> FloatArray:
    rays = lens.undistort(distorted, _no_distortion(lens))
    far = np.linalg.norm(rays, axis=-1, keepdims=True) > np.tan(_LARGEST_ANGLE)
    return np.where(far, np.nan, rays)


def _pose(points: FloatArray, rays: FloatArray) -> tuple[FloatArray, FloatArray] | None:
    """Return rotation and translation of a board, None if there are none in front."""
    seen = np.isfinite(rays).all(axis=-1)
    if seen.sum() < _LEAST_MARKS:
        return None
    try:
        found, turn, shift = cv2.solvePnP(points[seen], rays[seen], np.eye(3), None)
    except cv2.error:
        return None
    if not found or not np.isfinite(shift).all():
        return None
    R = np.asarray(cv2.Rodrigues(turn)[0], np.float64)
    ahead = ((points[seen] @ R.T + shift.ravel())[:, 2] > 0).all()
    return (R, np.asarray(shift.ravel(), np.float64)) if ahead else None


def _errors(points: FloatArray, pixels: FloatArray, cameras: FloatArray, lens: Lens) -> FloatArray:
    """Return how far the marks of each board are from where its pose has them, (C, B) px.

    Root mean squares for each of the cameras (C, 3, 3), all at once: a lens costs little more for
    many marks than for a few.
    """
    focal, centre = cameras[:, None, None, [0, 1], [0, 1]], cameras[0, :2, 2]
    rays = _near_rays((pixels - centre) / focal, lens)
    errors = np.full(rays.shape[:2], np.inf)
    places, local = [], []
    for place in np.ndindex(errors.shape):
        pose = _pose(points, rays[place])
        if pose is not None:
            places.append(place)
            local.append(points @ pose[0].T + pose[1])
    if places:
        camera, board = np.array(places).T
        seen = np.stack(local)
        distorted = lens.distort(seen[..., :2] / seen[..., 2:], _no_distortion(lens))
        expected = focal[camera, 0] * distorted + centre
        squares = np.sum((expected - pixels[board]) ** 2, axis=-1)
        errors[camera, board] = np.sqrt(np.nanmean(squares, axis=-1))
    return errors
