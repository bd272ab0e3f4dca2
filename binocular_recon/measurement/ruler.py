# SPDX-License-Identifier: Apache-2.0
"""Sizes of standing things, measured in a reconstructed cloud between picked pixels.

A pixel is a direction; how far away it is comes from the cloud around it, by a robust fit over the
whole thing. The end points of a thing are on its outline, where a single point of the cloud may
belong to what lies behind.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from binocular_recon.camera import FloatArray
from binocular_recon.errors import MeasurementError
from binocular_recon.images import to_grey
from binocular_recon.measurement.frame import MeasuredFrame
from binocular_recon.measurement.picks import Pick
from binocular_recon.measurement.planes import (
    SCATTER_PX,
    Plane,
    fitted_ground,
    height_above,
    normal_of,
)
from binocular_recon.measurement.robust_fits import consensus_fit, refined_fit
from binocular_recon.measurement.snapping import PICK_SIGMA_PX, check_inside
from binocular_recon.measurement.uncertain import Uncertain, joined, propagate

# How well the depth of a body, and of the hubs together, is known, px of disparity: the surface
# lies before the ends, and matching takes outlines to the depth of the axis.
BODY_SIGMA_PX = 0.15
# How well the depth of each wheel is known for itself, px of disparity.
WHEEL_SIGMA_PX = 0.03
# Points lower than this above the ground may be the ground, m.
CLEAR_OF_GROUND_M = 0.12
# Half the width of the strip along a body, as a share of its height.
BODY_HALF_WIDTH = 0.045
BODY_DEPTH_M = 0.4
# A bicycle reaches so far beyond its hubs and above the lower one, as a share of the wheelbase;
# what lies behind its nearest points by more than its length is something else. Above the wheels
# are handlebar and saddle, which reach out of their plane.
BICYCLE_BEYOND, BICYCLE_ABOVE, BICYCLE_LENGTH_M, WHEEL_HEIGHT_M = 0.36, 1.1, 1.2, 0.7
HUB_HALF_PX = 3
# No match is trusted more than one with this sigma, px.
LEAST_SIGMA_PX = 0.05
# A hub sticks out of the plane of its wheels, and a wheel lies off that of the whole bicycle, by
# less than this, px of disparity.
MOST_OFFSET_PX = 0.8
# Box of the automatic height around a body, m, and the percentile taken as its top.
BOX_HALF_M, TOP_PERCENTILE = 0.5, 99.9


@dataclass(frozen=True, eq=False)
class VerticalPlane:
    """A plane that stands on the ground: ``focal_baseline / ahead = inverse @ (1, side / ahead)``.

    Attributes
    ----------
    inverse : (2,) float64
        Disparity straight ahead and its change with the direction, px.
    level : (3, 3) float64
        Rows: unit vectors to the side, up, and ahead.
    focal_baseline : float
        px m.

    """

    inverse: FloatArray
    level: FloatArray
    focal_baseline: float

    def point(self, ray: FloatArray) -> FloatArray:
        """Return where a ray from the camera meets the plane: (3,) float64, m."""
        side, _, ahead = self.level @ ray
        met: FloatArray = ray * (self.focal_baseline / (self.inverse @ [ahead, side]))
        return met


class Ruler:
    """Measures upright things in one reconstruction.

    Parameters
    ----------
    frame : MeasuredFrame
        Of a scene with level ground.
    pick_sigma_px : float
        One standard deviation of picks, on each axis.
    ground : Plane, optional
        The ground, if it is known already.

    Attributes
    ----------
    ground : Plane
    level : (3, 3) float64
        Unit vectors to the side, up (against gravity, from the ground) and ahead; left rectified
        frame.
    camera_height_m : float
        Of the left camera above the ground.

    Raises
    ------
    MeasurementError
        If the cloud shows no ground.

    """

    def __init__(
        self,
        frame: MeasuredFrame,
        pick_sigma_px: float = PICK_SIGMA_PX,
        ground: Plane | None = None,
    ) -> None:
        self._frame, self._pick_sigma_px = frame, pick_sigma_px
        self._focal_baseline = frame.focal_baseline
        self._points = frame.points_xyz
        self._weight = _information(frame)
        self.ground = ground or fitted_ground(frame)
        normal = self.ground.inverse
        up = -normal / np.linalg.norm(normal)
        self.camera_height_m = float(self._focal_baseline / np.linalg.norm(normal))
        side = np.cross([0.0, 0.0, 1.0], up)
        side /= np.linalg.norm(side)
        self.level: FloatArray = np.stack([side, up, np.cross(up, side)])

    def height(self, top: Pick, sole: Pick) -> Uncertain:
        """Return the height of a person, (1,) m, from picks of head top and sole.

        The body stands upright: both ends lie on one vertical plane that faces the camera, at the
        median distance of the body's points.
        """
        ends = self._ends(self._body_plane(top.pixel, sole.pixel), (top, sole))
        return propagate(
            lambda ends, ground: normal_of(ground) @ (ends[:3] - ends[3:]),
            ends,
            self.ground.support,
        )

    def height_above_ground(self, top: Pick, sole: Pick) -> Uncertain:
        """Return the height of head top above the ground, (1,) m: the sole stands on it."""
        ends = self._ends(self._body_plane(top.pixel, sole.pixel), (top,))
        return propagate(lambda end, ground: height_above(ground, end), ends, self.ground.support)

    def automatic_height_m(self, top: Pick, sole: Pick) -> float:
        """Return the 99.9th percentile of the heights in a box around a person, m.

        The picks only say where the person is. NaN if the box is empty.
        """
        body = self._body_plane(top.pixel, sole.pixel)
        middle = body.point(self._frame.ray((top.pixel + sole.pixel) / 2))
        side, height, ahead = np.moveaxis(self._points @ self.level.T, -1, 0)
        x, _, z = self.level @ middle
        near = (abs(side - x) < BOX_HALF_M) & (abs(ahead - z) < BOX_HALF_M)
        heights = height[near] + self.camera_height_m
        return float(np.percentile(heights, TOP_PERCENTILE)) if near.any() else float('nan')

    def wheelbase(self, rear: Pick, front: Pick) -> Uncertain:
        """Return the distance of a bicycle's hubs, (1,) m, from their picks.

        Wheels and frame lie in one vertical plane; the hubs' ends lie parallel to it.
        """
        ends = self._ends(
            self._wheel_plane(rear.pixel, front.pixel), (rear, front), WHEEL_SIGMA_PX
        )
        return propagate(lambda ends: np.linalg.norm(ends[:3] - ends[3:]), ends)

    def _ends(
        self, plane: VerticalPlane, picks: tuple[Pick, ...], each_px: float = 0.0
    ) -> Uncertain:
        """Return where picks meet an upright plane, (3 n,) m, with all effects.

        Errors of matching are those of the plane as a whole and, of ``each_px``, of each end.
        """
        whole = ' '.join(pick.name for pick in picks)
        ends = []
        for pick in picks:
            check_inside(self._frame, pick, pick.pixel, 'left')
            met = plane.point(self._frame.ray(pick.pixel))
            slopes = [
                plane.point(self._frame.ray(pick.pixel + step))
                - plane.point(self._frame.ray(pick.pixel - step))
                for step in np.eye(2) / 2
            ]
            per_px = -met[:, None] * met[2] / self._focal_baseline
            effects = {
                ('pick', pick.name): self._pick_sigma_px * np.stack(slopes, axis=-1),
                ('matching', whole): BODY_SIGMA_PX * per_px,
                ('matching', pick.name): each_px * per_px,
            }
            ends.append(self._frame.calibrated(Uncertain(met, effects)))
        return joined(*ends)

    def _body_plane(self, top_px: FloatArray, sole_px: FloatArray) -> VerticalPlane:
        """Return the plane that faces the camera at a person's distance."""
        half = np.array([BODY_HALF_WIDTH * np.linalg.norm(sole_px - top_px), 0.0])
        low, high = np.minimum(top_px, sole_px), np.maximum(top_px, sole_px)
        window = self._window(low - half, high + half)
        ahead = (self._points[window] @ self.level[2]).ravel()
        ahead = ahead[np.isfinite(ahead)]
        if not ahead.size:
            raise MeasurementError(f'the cloud has no point between {top_px} and {sole_px}')
        # what shows between the legs is left out
        body = ahead[abs(ahead - np.median(ahead)) < BODY_DEPTH_M]
        straight = np.array([self._focal_baseline / np.median(body), 0.0])
        return VerticalPlane(straight, self.level, self._focal_baseline)

    def _wheel_plane(self, rear_px: FloatArray, front_px: FloatArray) -> VerticalPlane:
        """Return the plane of a bicycle, moved to the ends of its hubs."""
        length = np.linalg.norm(front_px - rear_px)
        low, high = np.minimum(rear_px, front_px), np.maximum(rear_px, front_px)
        window = self._window(
            low - length * np.array([1.0, BICYCLE_ABOVE]), high + length * np.array([1.0, 0.5])
        )
        side, height, ahead = (self._points[window] @ self.level.T).reshape(-1, 3).T
        height = height + self.camera_height_m
        chosen = (height > CLEAR_OF_GROUND_M) & (height < WHEEL_HEIGHT_M)
        if chosen.sum() < 2:
            raise MeasurementError(f'the cloud has no bicycle between {rear_px} and {front_px}')
        nearest = np.percentile(ahead[chosen], 5)
        ends = [self.level @ self._frame.ray(pixel) for pixel in (rear_px, front_px)]
        hubs = np.array([end[0] / end[2] for end in ends])
        first, last = sorted(hubs)
        beyond = BICYCLE_BEYOND / nearest
        chosen &= (ahead < nearest + BICYCLE_LENGTH_M) & (side / ahead > first - beyond)
        chosen &= side / ahead < last + beyond
        ahead, direction = ahead[chosen], side[chosen] / ahead[chosen]
        disparity, weight = self._focal_baseline / ahead, self._weight[window].ravel()[chosen]
        design = np.stack([np.ones_like(direction), direction], -1)
        inverse = consensus_fit(design, disparity, weight, SCATTER_PX)
        if inverse is None:
            raise MeasurementError(f'the cloud has no bicycle between {rear_px} and {front_px}')
        inverse = _through_wheels(inverse, direction, disparity, weight, hubs)
        plane = VerticalPlane(inverse, self.level, self._focal_baseline)
        out = [self._above_plane_px(plane, pixel) for pixel in (rear_px, front_px)]
        seen = [offset for offset in out if abs(offset) < MOST_OFFSET_PX]
        shift = np.array([np.mean(seen) if seen else 0.0, 0.0])
        return VerticalPlane(inverse + shift, self.level, self._focal_baseline)

    def _above_plane_px(self, plane: VerticalPlane, pixel: FloatArray) -> float:
        """Return how far the cloud at a pixel is in front of a plane, px; infinite without one."""
        points = self._points[self._window(pixel - HUB_HALF_PX, pixel + HUB_HALF_PX)]
        points = points[np.isfinite(points[..., 2])]
        if not len(points):
            return float('inf')
        side, _, ahead = (points @ self.level.T).T
        on_plane = plane.inverse[0] + plane.inverse[1] * side / ahead
        return float(np.median(self._focal_baseline / ahead - on_plane))

    def _window(self, low: FloatArray, high: FloatArray) -> tuple[slice, slice]:
        """Return rows and columns between two corners, within the image."""
        size = np.array(self._points.shape[1::-1])
        first = np.clip(np.rint(low), 0, size - 1).astype(int)
        last = np.clip(np.rint(high), 0, size - 1).astype(int)
        return slice(first[1], last[1] + 1), slice(first[0], last[0] + 1)


def _through_wheels(
    inverse: FloatArray,
    direction: FloatArray,
    disparity: FloatArray,
    weight: FloatArray,
    hubs: FloatArray,
) -> FloatArray:
    """Return the plane through the middles of both wheels, each fitted by itself.

    Matching flattens each wheel of a turned bicycle towards one disparity, which is right at the
    hub: the slope within the wheels is fitted along and left out.
    """
    offset = direction[:, None] - hubs
    near = abs(offset) < BICYCLE_BEYOND * abs(hubs[1] - hubs[0])
    chosen = near.any(axis=1) & (weight > 0)
    if near[chosen].sum(axis=0).min() < 2:
        return inverse
    design = np.column_stack([near, (near * offset).sum(axis=1)]).astype(np.float64)[chosen]
    start = np.array([*(inverse[0] + inverse[1] * hubs), inverse[1]])
    rear, front, _ = refined_fit(design, disparity[chosen], weight[chosen], SCATTER_PX, start)
    if max(abs(rear - start[0]), abs(front - start[1])) > MOST_OFFSET_PX:
        return inverse  # a wheel was not reconstructed: the frame is enough
    slope = (front - rear) / (hubs[1] - hubs[0])
    return np.array([rear - slope * hubs[0], slope])


def _information(frame: MeasuredFrame) -> FloatArray:
    """Return how much each point of the cloud tells about its distance, (H, W).

    A disparity is measured where the image changes along the row and the match was clear, which
    its sigma says; elsewhere it is filled in from there.
    """
    change = cv2.Sobel(to_grey(frame.left_bgr), cv2.CV_32F, 1, 0)
    contrast = np.sqrt(1.0 + cv2.GaussianBlur(change**2, (0, 0), 0.8))
    sigma_px = np.where(frame.measured, np.maximum(frame.sigma_px, LEAST_SIGMA_PX), np.inf)
    information: FloatArray = contrast / sigma_px.astype(np.float64) ** 2
    return information
