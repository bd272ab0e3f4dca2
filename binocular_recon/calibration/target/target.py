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

    """

    anchors_m: FloatArray
    heights_m: FloatArray
    sigmas: FloatArray
    radius_m: float = 0.0

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
        """Return exactly known points, (N, 3) m in the board frame, as a target."""
        return cls(np.asarray(points_m, np.float64), np.zeros(1), np.zeros(5))

    @property
    def shape(self) -> tuple[int, int]:
        """Number of rods and of marks per rod."""
        return len(self.anchors_m), len(self.heights_m)

    @property
    def has_rods(self) -> bool:
        """Whether marks lie on rods (and are not single points)."""
        return len(self.heights_m) > 1

    @property
    def nominal_m(self) -> FloatArray:
        """Marks of exactly placed rods, (R, M, 3) float64, board frame, m."""
        marks, _ = self.marks(np.zeros((len(self.anchors_m), 5)))
        return marks

    def exact(self) -> Target:
        """Return the target as the planar method takes it: exact rods without thickness."""
        return Target(self.anchors_m, self.heights_m, np.zeros(5))

    def marks(self, deviations: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the marks on the axes of displaced rods.

        Parameters
        ----------
        deviations : (..., R, 5) float64
            Displacement of each rod, in the order of ``DEVIATIONS``.

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
        return marks, directions
