# SPDX-License-Identifier: Apache-2.0
"""The plane of a board in a picture: where it puts the marks, and whether it can stand there."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from binocular_recon.calibration.rods import RodBoard
from binocular_recon.camera import FloatArray

# Rods stand this far off their place at most, besides four of the board's own sigmas, m.
ASTRAY_M = 0.06
# Rods of a board differ in scale by less than this.
MOST_SCALE = 4.0
# Focal lengths that cameras have, as shares of the picture's width.
FOCAL_LENGTHS = np.geomspace(0.4, 5.0, 30)


def lateral_limit_m(board: RodBoard) -> float:
    """Return how far sideways a rod may be from where the others put it, m."""
    limit = ASTRAY_M + 4 * float(
        np.hypot(board.placement_sigma_m, board.tilt_sigma_rad * board.marks_m[-1])
    )
    if board.count > 1:
        limit = min(limit, 0.3 * float(np.diff(board.rods_xz_m[:, 0]).min()))
    return limit


def plane_marks(board: RodBoard, marks_px: FloatArray) -> FloatArray | None:
    """Return where the plane of the board that fits the marks found puts every mark.

    (R, M, 2) float64, NaN behind the camera. None if fewer than two rods have two marks each.
    """
    matrix = _homography(board, marks_px)
    if matrix is None:
        return None
    found = np.isfinite(marks_px[..., 0])
    world = board.world_points()[..., :2]
    mapped = world @ matrix[:, :2].T + matrix[:, 2]
    depth = mapped[..., 2:]
    ahead = depth * np.sign(np.median(depth[found])) > 0
    projected: FloatArray = np.where(ahead, mapped[..., :2] / np.where(ahead, depth, 1.0), np.nan)
    length = np.linalg.norm(projected[:, -1] - projected[:, 0], axis=1)
    usual = np.nanmedian(length[found.any(1)])
    # beyond the vanishing point or so near that no rig sees it
    far = ~((length > usual / MOST_SCALE) & (length < usual * MOST_SCALE))
    projected[far] = np.nan
    return projected


def predict_marks(
    board: RodBoard, marks_px: FloatArray, plane_px: FloatArray | None
) -> FloatArray:
    """Return where every mark should be, from those found: (R, M, 2) float64, NaN = no telling.

    Where the plane of the board puts it, corrected for each rod by what is found of it.
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


def expected_in_picture(
    predicted_px: FloatArray, size: tuple[int, int], margin_px: float
) -> npt.NDArray[np.bool_]:
    """Return which marks should be in the picture, (R, M) bool."""
    limit = np.array(size) - 1 - margin_px
    with np.errstate(invalid='ignore'):
        inside: npt.NDArray[np.bool_] = np.all(
            (predicted_px >= margin_px) & (predicted_px <= limit), -1
        )
    return inside


def slant(board: RodBoard, marks_px: FloatArray, size: tuple[int, int]) -> float:
    """Return how far the marks are from rods that stand square on their row, at the right scale.

    The larger of the cosine between rods and row and the logarithm of their scales' ratio, both
    in space, with the focal length that suits best (Zhang 2000, eq. 3 and 4, square pixels and
    the principal point amid the picture). Placing errors and noise make it 0.05 or so. 0 if too
    little is found to tell.
    """
    matrix = _homography(board, marks_px)
    if matrix is None:
        return 0.0
    width, height = size
    centred = matrix[:2] - 0.5 * np.array([[width - 1], [height - 1]]) * matrix[2]
    across, up = np.concatenate([centred / width, matrix[2:]]).T[:2]

    def product(a: FloatArray, b: FloatArray) -> FloatArray:
        value: FloatArray = (a[:2] @ b[:2]) / FOCAL_LENGTHS**2 + a[2] * b[2]
        return value

    rows, rods = product(across, across), product(up, up)
    skew = np.abs(product(across, up)) / np.sqrt(rows * rods)
    return float(np.maximum(skew, 0.5 * np.abs(np.log(rows / rods))).min())


def _homography(board: RodBoard, marks_px: FloatArray) -> FloatArray | None:
    """Return the matrix (3, 3) that maps the board's x, y to pixels, None without two rods."""
    found = np.isfinite(marks_px[..., 0])
    if (found.sum(1) >= 2).sum() < 2:
        return None
    matrix: FloatArray | None = cv2.findHomography(
        board.world_points()[..., :2][found], marks_px[found], 0
    )[0]
    return matrix
