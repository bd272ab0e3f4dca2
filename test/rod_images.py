# SPDX-License-Identifier: Apache-2.0
"""Images of simulated boards for the tests of rod detection."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from binocular_recon.calibration.target.rods import RodBoard
from binocular_recon.simulation.render import RodPaint, Sensor, draw_rods, expose
from binocular_recon.simulation.rig import View, survey_rig
from binocular_recon.simulation.rods import PlacedBoard, place_board

RIG = survey_rig()


def middle_of(view: View, width: int, height: int) -> View:
    """Return a camera with a smaller sensor about the same centre: as many px per degree."""
    K = view.camera.K.copy()
    K[:2, 2] -= (view.camera.width - width) / 2, (view.camera.height - height) / 2
    return replace(view, camera=replace(view.camera, width=width, height=height, K=K))


# boards need no more of the image, and a detection takes as long as the image has pixels
LEFT = middle_of(RIG.views()[0], 1200, 800)


def board_of(
    rods: list[float] | list[tuple[float, float]], marks: list[float], diameter: float = 0.04
) -> RodBoard:
    """Return a board with rods at x, or x and z."""
    places = [rod if isinstance(rod, tuple) else (rod, 0.0) for rod in rods]
    return RodBoard.from_mapping(
        {
            'rods': [{'x': float(x), 'z': z} for x, z in places],
            'marks': marks,
            'rod_diameter': diameter,
            'placement_sigma': 0.003,
        }
    )


def image_of(
    board: RodBoard,
    translation: tuple[float, float, float],
    rotation: tuple[float, float, float] = (0.0, 0.0, 0.0),
    background: float = 110.0,
    **paint: Any,
) -> tuple[np.ndarray[Any, Any], PlacedBoard]:
    """Return an image of a board before a plain wall, and the board."""
    rng = np.random.default_rng(5)
    placed = place_board(board, np.array(rotation), np.array(translation), rng)
    canvas = np.full((*LEFT.camera.size[::-1], 3), background, np.float32)
    length = board.marks_m[-1] + 0.2
    draw_rods(canvas, LEFT, placed, RodPaint(length_m=length, **paint))
    return expose(canvas, Sensor(), rng), placed
