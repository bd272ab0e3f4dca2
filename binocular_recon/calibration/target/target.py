# SPDX-License-Identifier: Apache-2.0
"""Geometry of a target: rods whose places are known roughly, or points known exactly."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from binocular_recon.calibration.target.rods import RodBoard
from binocular_recon.camera import FloatArray

# How a rod may differ from its nominal place, in the order of `Target.sigmas`: the foot's
# offset along the board's x, y, z (m) and the lean of its top towards x and z (rad).
DEVIATIONS = ('x', 'y', 'z', 'lean_x', 'lean_z')
# One standard deviation of how far a board of points is bent, as a share of its longer side:
# boards of foam or wood are bent by up to 1 %, glass and aluminium less.
WARP_SHARE = 0.01
# Points this close to one plane, as a share of the board's longer side, form a flat board.
_FLAT_SHARE = 1e-6


@dataclass(frozen=True, eq=False)
class Target:
    """Marks on straight rods; a flat board of points is a target of rods with one mark each.

    Attributes
    ----------
    anchors_m : (R, 3) float64
        Nominal foot of each rod in the board frame (x along the row, y up, z to the viewer), m.
    heights_m : (M,) float64
        Heights of the marks along each rod, m; exact.
    sigmas : (5,) float64
        One standard deviation of each of ``DEVIATIONS``; 0 = exact.
    radius_m : float
        Distance of the visible marks from the rods' axes, towards the camera, m: for edges of
        bands the radius of the rods.
    warp_sigma_m : float
        One standard deviation of both parts of a board's warp (`bumps`), m; 0 = flat.

    """

    anchors_m: FloatArray
    heights_m: FloatArray
    sigmas: FloatArray
    radius_m: float = 0.0
    warp_sigma_m: float = 0.0

    @classmethod
    def from_rods(cls, board: RodBoard) -> Target:
        """Return the rods of ``rods.yaml`` as a target."""
        x, z = board.rods_xz_m.T
        placement, height, tilt = (
            board.placement_sigma_m,
            board.height_sigma_m,
            board.tilt_sigma_rad,
        )
        return cls(
            anchors_m=np.stack([x, np.zeros_like(x), z], axis=-1),
            heights_m=board.marks_m,
            sigmas=np.array([placement, height, placement, tilt, tilt]),
            radius_m=board.mark_offset_m,
        )

    @classmethod
    def from_points(cls, points_m: FloatArray) -> Target:
        """Return points of a board, (N, 3) m in the board frame, as a target.

        They are exact but for a warp of the whole board, if they lie in a plane z = constant.
        """
        points = np.asarray(points_m, np.float64)
        width, height, thickness = np.ptp(points, axis=0)
        side = max(width, height)
        warp = WARP_SHARE * side if thickness <= _FLAT_SHARE * side else 0.0
        return cls(points, np.zeros(1), np.zeros(5), warp_sigma_m=float(warp))

    @property
    def shape(self) -> tuple[int, int]:
        """Number of rods and of marks per rod."""
        return len(self.anchors_m), len(self.heights_m)

    @property
    def has_rods(self) -> bool:
        """Whether marks lie on rods (and are not single points)."""
        return len(self.heights_m) > 1

    @property
    def bends(self) -> bool:
        """Whether the board may be warped."""
        return self.warp_sigma_m > 0

    @property
    def bumps(self) -> FloatArray:
        """Shapes of a board's warp, (R, 2): displacement along z of each point.

        1 - x'^2 and 1 - y'^2, with x' and y' from -1 to 1 over the board; the warp's two parts
        say by how many metres the middle then stands out. Source: mrcal's ``calobject_warp``.
        """
        low, high = self.anchors_m[:, :2].min(axis=0), self.anchors_m[:, :2].max(axis=0)
        half = np.maximum((high - low) / 2, np.finfo(np.float64).tiny)
        bumps: FloatArray = 1 - ((self.anchors_m[:, :2] - (low + high) / 2) / half) ** 2
        return bumps

    @property
    def nominal_m(self) -> FloatArray:
        """Marks of exactly placed rods, (R, M, 3) float64, board frame, m."""
        marks, _ = self.marks(np.zeros((len(self.anchors_m), 5)))
        return marks

    def exact(self) -> Target:
        """Return the target as the planar method takes it: exact, without thickness or warp."""
        return Target(self.anchors_m, self.heights_m, np.zeros(5))

    def marks(
        self, deviations: FloatArray, warp_m: FloatArray | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Return the marks on the axes of displaced rods, or the points of a warped board.

        Parameters
        ----------
        deviations : (..., R, 5) float64
            Displacement of each rod, in the order of ``DEVIATIONS``.
        warp_m : (2,) float64, optional
            How far the board's middle stands out, m, by each of `bumps`; nothing on a board that
            does not bend.

        Returns
        -------
        marks_m : (..., R, M, 3) float64
            Marks in the board frame, m; their spacing is kept.
        directions : (..., R, 3) float64
            Unit direction of each rod, from its foot up.

        """
        upright = np.ones(deviations.shape[:-1])
        lean = np.stack([deviations[..., 3], upright, deviations[..., 4]], axis=-1)
        directions = lean / np.linalg.norm(lean, axis=-1, keepdims=True)
        feet = self.anchors_m + deviations[..., :3]
        marks = feet[..., None, :] + self.heights_m[:, None] * directions[..., None, :]
        if self.bends and warp_m is not None:
            marks[..., 2] += (self.bumps @ warp_m)[:, None]
        return marks, directions


def seen_scale(ends_m: FloatArray, radius_m: float, right_centre_m: FloatArray) -> float:
    """Return by how much too long a length on a rod is measured, as a factor.

    Each camera sees the edges on the surface that faces it, not on the axis, and where their rays
    meet depends on how the rod lies to the baseline.

    Parameters
    ----------
    ends_m : (2, 3) float64
        Ends of the length on the rod's axis, left rectified frame, m.
    radius_m : float
        Radius of the rod.
    right_centre_m : (3,) float64
        Optical centre of the right camera in that frame, along x or y.

    """
    rod = ends_m[1] - ends_m[0]
    rod = rod / np.linalg.norm(rod)
    rays = []
    for centre in (np.zeros(3), right_centre_m):
        ahead = ends_m - centre
        away = ahead - (ahead @ rod)[:, None] * rod
        surface = ahead - radius_m * away / np.linalg.norm(away, axis=1, keepdims=True)
        rays.append(surface / surface[:, 2:])
    along = int(np.argmax(np.abs(right_centre_m)))
    depths = right_centre_m[along] / (rays[0] - rays[1])[:, along]
    seen = rays[0] * depths[:, None]
    return float(np.linalg.norm(seen[1] - seen[0]) / np.linalg.norm(ends_m[1] - ends_m[0]))
