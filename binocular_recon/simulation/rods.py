# SPDX-License-Identifier: Apache-2.0
"""Boards as they really stand, and where the cameras see their marks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from binocular_recon.calibration.target.board_plane import inside_image
from binocular_recon.calibration.target.mark_types import visible_edges
from binocular_recon.calibration.target.rods import RodBoard
from binocular_recon.camera import FloatArray
from binocular_recon.errors import CalibrationError
from binocular_recon.simulation.rig import RawRig, View

# Board frame (x right, y up, z to the viewer) seen by a camera in front of it.
FACING_CAMERA = np.diag([1.0, -1.0, -1.0])
# Poses tried before giving up.
MAX_TRIES = 3000


@dataclass(frozen=True, eq=False)
class PlacedBoard:
    """One board in the rig's reference frame; each rod is a line of its own.

    Attributes
    ----------
    board : RodBoard
        The nominal board of ``rods.yaml``.
    rotation, translation_xyz : (3, 3), (3,) float64
        Pose of the nominal board: ``x = rotation x_board + translation``, m.
    feet_xyz : (R, 3) float64
        Foot of each rod as it stands, m.
    directions_xyz : (R, 3) float64
        Unit direction of each rod, from the foot up.

    """

    board: RodBoard
    rotation: FloatArray
    translation_xyz: FloatArray
    feet_xyz: FloatArray
    directions_xyz: FloatArray

    def marks_xyz(self) -> FloatArray:
        """Return the marks on the rods' axes: (R, M, 3) float64, m."""
        heights = self.board.marks_m[None, :, None]
        marks: FloatArray = self.feet_xyz[:, None] + heights * self.directions_xyz[:, None]
        return marks

    def marks_px(self, view: View) -> FloatArray:
        """Return where ``view`` sees the marks, inside the image or not: (R, M, 2) float64, px."""
        return view.project(
            visible_edges(
                self.marks_xyz(),
                self.directions_xyz[:, None],
                view.centre_xyz,
                self.board.mark_offset_m,
            )
        )

    def to_mapping(self) -> dict[str, Any]:
        """Return pose and lines as plain lists, for ``truth.json``."""
        return {
            'rotation': self.rotation.tolist(),
            'translation_xyz_m': self.translation_xyz.tolist(),
            'feet_xyz_m': self.feet_xyz.tolist(),
            'directions_xyz': self.directions_xyz.tolist(),
        }


def paper_board(placement_m: float = 0.005) -> RodBoard:
    """Return the paper's board, 5 rods of 6 marks, with placement sigma ``placement_m``."""
    return RodBoard.from_mapping(
        {
            'rods': [{'x': 0.6 * i} for i in range(5)],
            'marks': [0.3, 0.6, 0.9, 1.2, 1.5, 1.8],
            'rod_diameter': 0.04,
            'placement_sigma': placement_m,
        }
    )


def with_placement(board: RodBoard, placement_m: float) -> RodBoard:
    """Return the board with other placement, height (2 x) and tilt (per metre) sigmas."""
    changes = {
        'placement_sigma': placement_m,
        'height_sigma': 2 * placement_m,
        'tilt_sigma': placement_m,
    }
    return RodBoard.from_mapping({**board.to_mapping(), **changes})


def place_board(
    board: RodBoard,
    rotation_vector: FloatArray,
    translation_xyz: FloatArray,
    rng: np.random.Generator,
) -> PlacedBoard:
    """Place a board with errors drawn from its own placement, height and tilt sigmas.

    Parameters
    ----------
    board : RodBoard
        Rods and their sigmas.
    rotation_vector : (3,) float64
        Rotation of the board from facing the camera squarely, about the camera's axes, rad.
    translation_xyz : (3,) float64
        Middle of the row of feet in the rig's reference frame, m.
    rng : numpy.random.Generator
        Source of the errors.

    """
    rotation = cv2.Rodrigues(np.asarray(rotation_vector, np.float64))[0] @ FACING_CAMERA
    middle = board.rods_xz_m[:, 0].mean()
    translation = np.asarray(translation_xyz, np.float64) - rotation @ [middle, 0.0, 0.0]
    sigma = np.array([board.placement_sigma_m, board.height_sigma_m, board.placement_sigma_m])
    feet = np.stack([board.rods_xz_m[:, 0], np.zeros(board.count), board.rods_xz_m[:, 1]], -1)
    feet += rng.normal(size=feet.shape) * sigma
    lean = rng.normal(size=(board.count, 2)) * board.tilt_sigma_rad
    directions = np.stack([lean[:, 0], np.ones(board.count), lean[:, 1]], -1)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return PlacedBoard(
        board, rotation, translation, feet @ rotation.T + translation, directions @ rotation.T
    )


def draw_board(
    board: RodBoard,
    rig: RawRig,
    rng: np.random.Generator,
    *,
    depth_m: tuple[float, float] = (5.0, 16.0),
    roll_rad: tuple[float, float] = (0.0, 0.0),
    cut: bool = False,
    margin_px: float = 5.0,
) -> PlacedBoard:
    """Place a board at random in the view of both cameras.

    Parameters
    ----------
    board : RodBoard
        Rods and their sigmas.
    rig : RawRig
        Both cameras.
    rng : numpy.random.Generator
        Source of everything random.
    depth_m : tuple of float
        Range of the board's distance.
    roll_rad : tuple of float
        Range of the board's tilt in the image, to the left or right.
    cut : bool
        True: the image border cuts a rod in at least one image, but both show most marks; False:
        every mark is at least ``margin_px`` inside both images.
    margin_px : float
        Distance of a seen mark from the image border.

    Raises
    ------
    CalibrationError
        If the board does not fit into both images within ``depth_m``.

    """
    for _ in range(MAX_TRIES):
        z = rng.uniform(*depth_m)
        pose = [rng.uniform(-0.15, 0.15), rng.uniform(-0.9, 0.9)]
        pose.append(rng.choice([-1, 1]) * rng.uniform(*roll_rad))
        reach = 0.5 if cut else 0.35
        middle = [rng.uniform(-reach, reach) * z, rng.uniform(-0.3, 0.6) + 1.05, z]
        if cut:
            middle[1] += rng.uniform(-0.1, 0.15) * z
        placed = place_board(board, np.array(pose), np.array(middle), rng)
        seen = np.stack(
            [
                inside_image(placed.marks_px(view), view.camera.size, margin_px)
                for view in rig.views()
            ]
        )
        per_rod = seen.all(0).sum(1)
        if seen.all() and not cut:
            return placed
        most = (seen.mean((1, 2)) > 0.6).all()
        if cut and not seen.all() and most and (per_rod >= 3).any():
            return placed
    raise CalibrationError(
        f'a board {np.ptp(board.rods_xz_m[:, 0]):g} m wide and {board.marks_m[-1]:g} m high does'
        f' not fit into both images at {depth_m[0]:g}..{depth_m[1]:g} m; use fewer rods or'
        ' more depth'
    )
