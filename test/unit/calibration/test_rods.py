# SPDX-License-Identifier: Apache-2.0
"""rods.yaml: accepted values, defaults, refusals with a remedy, and the geometry of edges."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from binocular_recon.calibration.target.mark_types import visible_edges
from binocular_recon.calibration.target.rods import RodBoard, load_rods, save_rods
from binocular_recon.errors import CalibrationError, FileError

EXAMPLE = Path(__file__).parents[3] / 'config' / 'rods.yaml'


def values(**changes: Any) -> dict[str, Any]:
    base = {
        'rods': [{'x': 0.0}, {'x': 0.6, 'z': 0.1}],
        'marks': [0.3, 0.6, 1.1],
        'rod_diameter': 0.04,
        'placement_sigma': 0.005,
    }
    return {key: value for key, value in {**base, **changes}.items() if value != 'absent'}


def test_example_is_the_papers_board() -> None:
    board = load_rods(EXAMPLE)
    assert (board.count, board.marks_per_rod) == (5, 6)
    points = board.world_points()
    assert points.shape == (5, 6, 3)
    np.testing.assert_allclose(points[4, 5], [2.4, 1.8, 0.0])
    np.testing.assert_allclose(points[1, 0], [0.6, 0.3, 0.0])


def test_sigmas_default_to_the_placement() -> None:
    board = RodBoard.from_mapping(values())
    assert board.height_sigma_m == pytest.approx(0.010)
    assert board.tilt_sigma_rad == pytest.approx(0.005)
    assert board.world_points()[1, 2].tolist() == [0.6, 1.1, 0.1]


def test_round_trip(tmp_path: Path) -> None:
    board = RodBoard.from_mapping(values(height_sigma=0.02, tilt_sigma=0.001))
    save_rods(board, tmp_path / 'rods.yaml')
    again = load_rods(tmp_path / 'rods.yaml')
    assert again.to_mapping() == board.to_mapping()


@pytest.mark.parametrize(
    ('changes', 'message'),
    [
        ({'marks': 'absent'}, 'missing marks'),
        ({'rods': 'absent', 'placement_sigma': 'absent'}, 'missing rods, placement_sigma'),
        ({'rod_diametre': 0.04}, 'unknown rod_diametre'),
        ({'mark_type': 'ring'}, "must be one of band_edge, band_edge_light, got 'ring'"),
        ({'marks': [0.3, 0.9, 0.6]}, 'marks must increase'),
        ({'marks': [0.3, 0.3]}, 'marks must increase'),
        ({'marks': [0.3]}, 'at least 2 heights per rod, got 1'),
        ({'marks': [-0.3, 0.3]}, 'are they in metres'),
        ({'marks': [300, 600]}, 'are they in metres'),
        ({'marks': [0.3, '0.6 m']}, "mark 2 must be a number in metres, got '0.6 m'"),
        ({'marks': 0.3}, 'marks must be a list'),
        ({'marks': [0.3, float('nan')]}, 'marks must increase'),
        ({'rod_diameter': -0.04}, 'rod_diameter must be positive'),
        ({'rod_diameter': 40}, 'rod_diameter must be positive and below'),
        ({'rod_diameter': True}, 'rod_diameter must be a number'),
        ({'rod_diameter': float('nan')}, 'rod_diameter_m must be a finite number'),
        ({'placement_sigma': -0.1}, 'placement_sigma must be within 0..1, got -0.1'),
        ({'height_sigma': 5}, 'height_sigma must be within 0..1, got 5'),
        ({'tilt_sigma': 1}, 'tilt_sigma must be within 0..0.35'),
        ({'rods': []}, 'rods must be a list'),
        ({'rods': [0.0, 0.6]}, 'rod 1 must be given as'),
        ({'rods': [{'x': 0.0}, {'z': 0.6}]}, 'rod 2 must be given as'),
        ({'rods': [{'x': 0.0}, {'x': 'far'}]}, 'x of rod 2 must be a number'),
        ({'rods': [{'x': 0.6}, {'x': 0.0}]}, r'got x = 0.6 then 0 \(rods 1 and 2\)'),
        ({'rods': [{'x': 0.0}, {'x': 0.02}]}, 'stand apart by more than rod_diameter'),
        ({'rods': [{'x': float('inf')}]}, 'not finite'),
    ],
)
def test_bad_values_are_refused(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(CalibrationError, match=message):
        RodBoard.from_mapping(values(**changes))


def test_files_are_named(tmp_path: Path) -> None:
    with pytest.raises(
        FileError, match=r'absent\.yaml cannot be read: No such file or directory; give the rods'
    ):
        load_rods(tmp_path / 'absent.yaml')
    path = tmp_path / 'rods.yaml'
    path.write_text('rods: [')
    with pytest.raises(FileError, match='is not valid YAML'):
        load_rods(path)
    path.write_text('5 rods')
    with pytest.raises(CalibrationError, match=r'rods\.yaml holds no rods'):
        load_rods(path)
    path.write_text('rods: [{x: 0}]\nmarks: [1, 2]\nrod_diameter: -1\nplacement_sigma: 0\n')
    with pytest.raises(CalibrationError, match=r'rods\.yaml: rod_diameter must be positive'):
        load_rods(path)
    with pytest.raises(FileError, match='cannot write'):
        save_rods(load_rods(EXAMPLE), tmp_path / 'none' / 'rods.yaml')


def test_edge_is_seen_on_the_surface() -> None:
    """A ring 1 m below the camera at 10 m, diameter 40 mm: seen 0.33 px above its axis point."""
    up = np.array([0.0, -1.0, 0.0])
    marks = np.array([[0.0, 1.0, 10.0], [0.0, 0.0, 10.0]])
    seen = visible_edges(marks, up, np.zeros(3), 0.02)
    np.testing.assert_allclose(seen, [[0, 1.0, 9.98], [0, 0, 9.98]], atol=1e-12)
    rows = 1650 * seen[:, 1] / seen[:, 2]
    assert rows[0] - 165.0 == pytest.approx(0.331, abs=1e-3)
    # of all the ring's points the one returned is nearest to the camera
    angle = np.linspace(0, 2 * np.pi, 721)
    axis = np.array([0.1, -0.98, 0.17])
    axis /= np.linalg.norm(axis)
    side = np.cross(axis, [1.0, 0, 0])
    side /= np.linalg.norm(side)
    ring = marks[0] + 0.02 * (
        np.cos(angle)[:, None] * side + np.sin(angle)[:, None] * np.cross(axis, side)
    )
    nearest = ring[np.linalg.norm(ring, axis=1).argmin()]
    np.testing.assert_allclose(
        visible_edges(marks[0], axis, np.zeros(3), 0.02), nearest, atol=2e-4
    )
