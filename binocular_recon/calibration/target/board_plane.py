# SPDX-License-Identifier: Apache-2.0
"""A board in an image: where its marks must be, and whether a board can stand like that.

The marks of rods in one line lie in a plane, which a homography maps. Rods off that line are
first moved into it with a roughly fitted pinhole camera (Terzakis and Lourakis 2020, SQPnP).
"""

from __future__ import annotations

import cv2
import numpy as np

from binocular_recon.calibration.target.rods import RodBoard
from binocular_recon.camera import FloatArray
from binocular_recon.images import Mask

# A rod is off its place by at most this and four of the board's own sigmas, m.
MAX_OFFSET_M = 0.06
# The scales of a board's rods differ by less than this factor.
MAX_SCALE_RATIO = 4.0
# Rods off the row by less than this lie in its plane, m.
FLAT_M = 1e-3
# Focal lengths of real cameras, as shares of the image's width.
FOCAL_LENGTHS = np.geomspace(0.4, 5.0, 30)


def lateral_limit_m(board: RodBoard) -> float:
    """Return how far sideways a rod may be from where the other rods predict it, m."""
    limit = MAX_OFFSET_M + 4 * float(
        np.hypot(board.placement_sigma_m, board.tilt_sigma_rad * board.marks_m[-1])
    )
    if board.count > 1:
        limit = min(limit, 0.3 * float(np.diff(board.row_m[:, 0]).min()))
    return limit


def plane_marks(board: RodBoard, marks_px: FloatArray, size: tuple[int, int]) -> FloatArray | None:
    """Fit a board to the marks found and return where it has every mark.

    (R, M, 2) float64, NaN behind the camera. None if fewer than two rods have two marks each.
    ``size`` is width and height of the image, px.
    """
    matrix = _camera(board, marks_px, size)
    if matrix is None:
        return None
    found = np.isfinite(marks_px[..., 0])
    mapped = _row_points(board) @ matrix[:, :3].T + matrix[:, 3]
    depth = mapped[..., 2:]
    ahead = depth * np.sign(np.median(depth[found])) > 0
    projected: FloatArray = np.where(ahead, mapped[..., :2] / np.where(ahead, depth, 1.0), np.nan)
    length = np.linalg.norm(projected[:, -1] - projected[:, 0], axis=1)
    known = length[found.any(1) & np.isfinite(length)]
    usual = np.median(known) if known.size else np.nan
    # beyond the vanishing point, or too near to be seen
    far = ~((length > usual / MAX_SCALE_RATIO) & (length < usual * MAX_SCALE_RATIO))
    projected[far] = np.nan
    return projected


def marks_along(
    board: RodBoard, marks_px: FloatArray, size: tuple[int, int], along_m: FloatArray
) -> FloatArray | None:
    """Return where marks of other rods would be, ``along_m`` (N,) along the row: (N, M, 2) px.

    NaN behind the camera. None if fewer than two rods have two marks each. ``marks_px`` (R, M, 2)
    are those found, ``size`` is width and height of the image, px.
    """
    matrix = _camera(board, marks_px, size)
    if matrix is None:
        return None
    across, off = board.row_m.T
    points = np.zeros((along_m.size, board.marks_per_rod, 3))
    points[..., 0] = along_m[:, None]
    points[..., 1] = board.world_points()[0, :, 1]
    points[..., 2] = np.interp(along_m, across, off)[:, None]
    found = np.isfinite(marks_px[..., 0])
    depth = points @ matrix[2, :3] + matrix[2, 3]
    usual = np.median(_row_points(board)[found] @ matrix[2, :3] + matrix[2, 3])
    projected: FloatArray = np.where(
        (depth * usual > 0)[..., None], project(matrix, points), np.nan
    )
    return projected


def predict_marks(
    board: RodBoard, marks_px: FloatArray, plane_px: FloatArray | None
) -> FloatArray:
    """Predict every mark from those found: (R, M, 2) float64, NaN = unknown.

    The board's plane predicts it; each rod is then corrected by its own marks.
    """
    found = np.isfinite(marks_px[..., 0])
    predicted = np.full_like(marks_px, np.nan) if plane_px is None else plane_px.copy()
    for rod in range(board.count):
        h, seen = board.marks_m, found[rod]
        if plane_px is not None and seen.any():
            off = marks_px[rod, seen] - predicted[rod, seen]
            degree = min(1, int(seen.sum()) - 1)
            predicted[rod] += np.stack([np.polyval(np.polyfit(h[seen], o, degree), h)
                                        for o in off.T], -1)  # fmt: skip
        elif plane_px is None and seen.sum() >= 2:
            predicted[rod] = np.stack(
                [np.polyval(np.polyfit(h[seen], v, 1), h) for v in marks_px[rod, seen].T], -1
            )
    return predicted


def inside_image(pixels: FloatArray, size: tuple[int, int], margin_px: float) -> Mask:
    """Return which pixels (..., 2) lie at least ``margin_px`` inside an image of ``size``."""
    limit = np.array(size) - 1 - margin_px
    inside: Mask = np.all((pixels >= margin_px) & (pixels <= limit), axis=-1)
    return inside


def slant(board: RodBoard, marks_px: FloatArray, size: tuple[int, int]) -> float:
    """Measure how far the rods are from standing square on their row, at the same scale.

    The larger of the cosine between rods and row and the logarithm of the ratio of their scales,
    both in space, with the focal length that fits best (Zhang 2000, eq. 3 and 4, square pixels,
    the principal point in the middle of the image). Placement errors and noise make it about
    0.05. 0 if too few marks are found.
    """
    matrix = _camera(board, marks_px, size)
    return 0.0 if matrix is None else float(_slants(matrix[:, [0, 1, 3]], size).min())


def fit_camera(
    points_m: FloatArray, pixels: FloatArray, size: tuple[int, int]
) -> FloatArray | None:
    """Fit the matrix (3, 4) that maps points near a plane to pixels; None if that fails.

    Parameters
    ----------
    points_m : (N, 3) float64
        Points along, up and off the plane, m; right-handed, the last axis towards the viewer.
    pixels : (N, 2) float64
        Their images, px.
    size : (int, int)
        Width and height of the image, px.

    """
    camera: FloatArray = np.eye(3, 4)
    moved = pixels
    if np.abs(points_m[:, 2]).max() >= FLAT_M:
        pinhole = _pinhole(points_m, pixels, size)
        if pinhole is None:
            return None
        camera = pinhole
        moved = pixels - project(camera, points_m) + project(camera, points_m * [1, 1, 0])
    plane = cv2.findHomography(points_m[:, :2], moved, 0)[0]
    if plane is None:
        return None
    pose = camera[:, [0, 1, 3]]
    normal = camera[:, 2] * np.sum(plane * pose) / np.sum(pose**2)
    return np.column_stack([plane[:, :2], normal, plane[:, 2]])


def _pinhole(points_m: FloatArray, pixels: FloatArray, size: tuple[int, int]) -> FloatArray | None:
    """Fit a camera matrix (3, 4) with square pixels and a centred principal point."""
    width, height = size
    best, least = None, np.inf
    for focal in FOCAL_LENGTHS[::3] * width:
        K = np.array([[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1.0]])
        found, turn, shift = cv2.solvePnP(points_m, pixels, K, None, flags=cv2.SOLVEPNP_SQPNP)
        if not found:
            continue
        camera = K @ np.column_stack([cv2.Rodrigues(turn)[0], shift])
        error = float(np.sum((project(camera, points_m) - pixels) ** 2))
        if error < least:
            best, least = camera, error
    return best


def project(camera: FloatArray, points_m: FloatArray) -> FloatArray:
    """Map points (..., 3) m to pixels (..., 2) by a matrix (3, 4)."""
    mapped = points_m @ camera[:, :3].T + camera[:, 3]
    pixels: FloatArray = mapped[..., :2] / mapped[..., 2:]
    return pixels


def _camera(board: RodBoard, marks_px: FloatArray, size: tuple[int, int]) -> FloatArray | None:
    """Fit the matrix (3, 4) from row coordinates to pixels; None without two rods."""
    found = np.isfinite(marks_px[..., 0])
    if (found.sum(1) >= 2).sum() < 2:
        return None
    return fit_camera(_row_points(board)[found], marks_px[found], size)


def _row_points(board: RodBoard) -> FloatArray:
    """Return the marks in row coordinates, along, up and off it: (R, M, 3) float64, m."""
    points = board.world_points()
    points[..., [0, 2]] = board.row_m[:, None]
    return points


def _centred(plane: FloatArray, size: tuple[int, int]) -> FloatArray:
    """Return a homography to offsets from the image centre, in shares of the image's width."""
    width, height = size
    centred = plane[:2] - 0.5 * np.array([[width - 1], [height - 1]]) * plane[2]
    return np.concatenate([centred / width, plane[2:]])


def _slants(plane: FloatArray, size: tuple[int, int]) -> FloatArray:
    """Return how far a homography is from that of a plane in space, for each focal length."""
    across, up = _centred(plane, size).T[:2]

    def product(a: FloatArray, b: FloatArray) -> FloatArray:
        value: FloatArray = (a[:2] @ b[:2]) / FOCAL_LENGTHS**2 + a[2] * b[2]
        return value

    rows, rods = product(across, across), product(up, up)
    skew = np.abs(product(across, up)) / np.sqrt(rows * rods)
    slants: FloatArray = np.maximum(skew, 0.5 * np.abs(np.log(rows / rods)))
    return slants
