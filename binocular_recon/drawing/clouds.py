# SPDX-License-Identifier: Apache-2.0
"""Draw a point cloud from an oblique view, for those without a viewer at hand."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from binocular_recon.images import ByteImage, FloatImage

# Points are drawn in a larger image that is then averaged down.
_OVERSAMPLING = 2
_BACKGROUND = (40, 34, 30)
# A pixel whose neighbours' depths differ by more than this share lies between two surfaces; its
# disparity is that of neither.
_BORDER_DEPTH_SHARE = 0.03
# Share of the points, %, that may lie outside the image on each side.
_CUT_PERCENT = 1.0


@dataclass(frozen=True)
class CloudView:
    """From where a cloud is seen.

    Attributes
    ----------
    yaw_deg : float
        Turn about the vertical; positive looks from the left.
    pitch_deg : float
        Turn about the horizontal; positive looks from above.
    distance : float
        Distance from the middle of the cloud, as a multiple of its distance from the camera.

    """

    yaw_deg: float = 20.0
    pitch_deg: float = 10.0
    distance: float = 1.2


def draw_cloud(
    points_xyz: FloatImage, bgr: ByteImage, size: tuple[int, int], view: CloudView | None = None
) -> ByteImage:
    """Draw the points of a cloud as squares that hide each other, with the whole cloud in view.

    Parameters
    ----------
    points_xyz : (H, W, 3) float32
        Left rectified optical frame, m; NaN = none.
    bgr : (H, W, 3) uint8
        Colour of the points.
    size : (int, int)
        Width and height of the image.
    view : CloudView, optional
        From where.

    Returns
    -------
    image : (height, width, 3) uint8
        BGR.

    """
    drawn = np.isfinite(points_xyz).all(axis=-1) & ~_borders(points_xyz[..., 2])
    points = points_xyz[drawn]
    gaps_m = _pixel_angle(points_xyz) * points[:, 2] if len(points) else points[:, 2]
    return draw_points(points, bgr[drawn], gaps_m, size, view)


def draw_points(
    points_xyz: FloatImage,
    bgr: ByteImage,
    gaps_m: FloatImage,
    size: tuple[int, int],
    view: CloudView | None = None,
) -> ByteImage:
    """Draw points (N, 3) in the axes of a camera, as `draw_cloud` does those of an image.

    Parameters
    ----------
    points_xyz : (N, 3) float32
        x right, y down, z forward, m.
    bgr : (N, 3) uint8
        Their colours.
    gaps_m : (N,) float32
        Distance of each point to its neighbours, m.
    size : (int, int)
        Width and height of the image.
    view : CloudView, optional
        From where.

    Returns
    -------
    image : (height, width, 3) uint8
        BGR.

    """
    width, height = (side * _OVERSAMPLING for side in size)
    canvas = np.full((height, width, 3), _BACKGROUND, np.uint8)
    if len(points_xyz):
        seen = _turned(points_xyz, view or CloudView())
        in_front = seen[:, 2] > 0.05 * np.median(seen[:, 2])
        seen, colours, gaps_m = seen[in_front], bgr[in_front], gaps_m[in_front]
        x, y, focal = _fitted(seen, width, height)
        # a square as large as the gap between neighbouring points, and no gap is seen
        sides = np.clip(np.ceil(1.5 * focal * gaps_m / seen[:, 2]), 1, 9).astype(int)
        _splat(canvas, x, y, seen[:, 2], sides, colours)
    return np.asarray(cv2.resize(canvas, size, interpolation=cv2.INTER_AREA), np.uint8)


def _borders(depth_m: FloatImage) -> npt.NDArray[np.bool_]:
    """Tell which pixels have neighbours at clearly different depths."""
    filled = np.nan_to_num(depth_m, nan=0.0)
    square = np.ones((3, 3), np.uint8)
    spread = cv2.dilate(filled, square) - cv2.erode(filled, square)
    return np.asarray(spread > _BORDER_DEPTH_SHARE * filled)


def _pixel_angle(points_xyz: FloatImage) -> float:
    """Return the angle between neighbouring pixels, radians."""
    directions = points_xyz[..., 0] / points_xyz[..., 2]
    return float(np.nanmedian(np.diff(directions, axis=1)))


def _turned(points: FloatImage, view: CloudView) -> FloatImage:
    """Return points in the frame of the view: x right, y down, z forward."""
    middle = np.median(points, axis=0)
    yaw, pitch = np.radians([view.yaw_deg, view.pitch_deg])
    turn = (
        cv2.Rodrigues(np.array([pitch, 0.0, 0.0]))[0]
        @ cv2.Rodrigues(np.array([0.0, -yaw, 0.0]))[0]
    )
    away = np.array([0.0, 0.0, middle[2] * view.distance])
    return np.asarray((points - middle) @ turn.T + away, np.float32)


def _fitted(seen: FloatImage, width: int, height: int) -> tuple[FloatImage, FloatImage, float]:
    """Project so that the points fill the image; returns columns, rows and focal length."""
    flat = seen[:, :2] / seen[:, 2:]
    low, high = np.percentile(flat, [_CUT_PERCENT, 100 - _CUT_PERCENT], axis=0)
    focal = float(0.96 * np.min(np.array([width, height]) / np.maximum(high - low, 1e-6)))
    middle = np.array([width, height]) / 2
    x, y = (focal * (flat - (low + high) / 2) + middle).T
    return x.astype(np.float32), y.astype(np.float32), focal


def _splat(
    canvas: ByteImage,
    x: FloatImage,
    y: FloatImage,
    depth: FloatImage,
    sides: npt.NDArray[np.int_],
    colours: ByteImage,
) -> None:
    """Paint squares from the farthest to the nearest."""
    height, width = canvas.shape[:2]
    places, owners = [], []
    for side in np.unique(sides):
        own = np.flatnonzero(sides == side)
        left, top = (np.rint(at[own] - side / 2).astype(int) for at in (x, y))
        for row, column in np.ndindex(side, side):
            rows, columns = top + row, left + column
            inside = (rows >= 0) & (rows < height) & (columns >= 0) & (columns < width)
            places.append(rows[inside] * width + columns[inside])
            owners.append(own[inside])
    place, owner = np.concatenate(places), np.concatenate(owners)
    order = np.argsort(-depth[owner], kind='stable')
    # numpy: the last of several values for one place stays
    canvas.reshape(-1, 3)[place[order]] = colours[owner[order]]
