# SPDX-License-Identifier: Apache-2.0
"""The simulator: its geometry against independent formulas, its images against its truth."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from binocular_recon.calibration.target.rods import RodBoard, load_rods
from binocular_recon.cli.quality import simulate
from binocular_recon.errors import CalibrationError, FileError
from binocular_recon.simulation.capture import CaptureOptions, simulate_capture, visible_marks
from binocular_recon.simulation.clutter import KINDS, paint
from binocular_recon.simulation.render import (
    Billboard,
    RodPaint,
    Sensor,
    billboard_opacity,
    draw_rods,
    expose,
)
from binocular_recon.simulation.rig import TABLE_1_PITCH_RAD, fisheye_rig, survey_rig
from binocular_recon.simulation.rods import draw_board, paper_board, place_board


def test_projection_is_the_plumb_bob_model() -> None:
    """By hand: x = 0.3, y = -0.2, k1 k2 p1 p2 of the left camera."""
    left = survey_rig().views()[0]
    k1, k2, p1, p2 = left.camera.D
    x, y = 0.3, -0.2
    r2 = x * x + y * y
    radial = 1 + k1 * r2 + k2 * r2 * r2
    u = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    v = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    expected = [1650 * u + 965, 1652 * v + 598]
    np.testing.assert_allclose(left.project(np.array([x, y, 1.0]) * 7), expected, atol=1e-9)


def test_rays_invert_the_projection() -> None:
    rng = np.random.default_rng(0)
    for view in survey_rig().views():
        points = rng.uniform((-4, -2.5, 8), (4, 2.5, 16), (200, 3))
        rays = view.rays(view.project(points))
        along = points - view.centre_xyz
        depth = (along @ view.R.T)[:, 2:]
        np.testing.assert_allclose(rays, along / depth, atol=2e-6)


def test_a_fisheye_rig_has_marks_and_a_rectification_but_no_images() -> None:
    rig = fisheye_rig()
    view = rig.views()[1]
    point = np.array([[6.0, -1.0, 4.0]])
    local = (point @ rig.R.T + rig.T)[:, None]
    expected = cv2.fisheye.projectPoints(
        local, np.zeros(3), np.zeros(3), rig.right.K, rig.right.D
    )[0][:, 0]
    np.testing.assert_allclose(view.project(point), expected, atol=1e-9)
    assert rig.stereo_rig().right.distortion_model == 'equidistant'
    with pytest.raises(CalibrationError, match='equidistant cannot be simulated, only its marks'):
        _ = view.numbers


def test_points_behind_the_camera_have_no_image() -> None:
    assert np.isnan(survey_rig().views()[0].project(np.array([0.0, 0.0, -5.0]))).all()


def test_pitch_gives_the_row_differences_of_table_1() -> None:
    board, rng = paper_board(), np.random.default_rng(0)
    for pitch, low, high in ((0.0, 1.5, 3.0), (TABLE_1_PITCH_RAD, 5.0, 6.0)):
        rig = survey_rig(pitch_rad=pitch)
        left, right = rig.views()
        rows = []
        for _ in range(40):
            placed = draw_board(board, rig, rng)
            rows.append((placed.marks_px(left) - placed.marks_px(right))[..., 1])
        assert low < np.abs(rows).mean() < high


def test_placement_errors_have_the_stated_sigmas() -> None:
    board, rng = paper_board(0.005), np.random.default_rng(1)
    offsets, leans, spacing = [], [], []
    for _ in range(300):
        placed = place_board(board, np.zeros(3), np.array([0.0, 1.0, 8.0]), rng)
        nominal = board.world_points()[:, 0] - [1.2, 0.3, 0.0]
        local = (placed.feet_xyz - [0.0, 1.0, 8.0]) @ placed.rotation
        offsets.append(local - nominal)
        leans.append(placed.directions_xyz @ placed.rotation)
        marks = placed.marks_xyz()
        spacing.append(np.linalg.norm(np.diff(marks, axis=1), axis=-1))
    np.testing.assert_allclose(np.std(offsets, (0, 1)), [0.005, 0.010, 0.005], rtol=0.06)
    np.testing.assert_allclose(np.std(leans, (0, 1))[[0, 2]], 0.005, rtol=0.06)
    np.testing.assert_allclose(spacing, 0.3, atol=1e-12)


def test_band_edge_is_drawn_where_the_truth_says() -> None:
    """The 50 % crossing on the rod's middle line, off the axis' own image by the surface."""
    rig, board = survey_rig(), paper_board(0.0)
    view = rig.views()[0]
    placed = place_board(board, np.zeros(3), np.array([0.0, 1.3, 7.0]), np.random.default_rng(0))
    canvas = np.full((1200, 1920, 3), 90.0, np.float32)
    draw_rods(canvas, view, placed, RodPaint(ambient=1.0, grime=0.0))
    edges = placed.marks_px(view)
    axis = view.project(placed.marks_xyz())
    assert np.abs(edges - axis)[:, 0, 1].min() > 0.5
    for x, y in edges[2]:
        rows = np.arange(int(y) - 4, int(y) + 6)
        profile = canvas[rows, round(x), 0]
        low, high = sorted((profile[0], profile[-1]))
        covered = (profile - low).sum() / (high - low)
        rising = profile[-1] > profile[0]
        edge = rows[-1] + 0.5 - covered if rising else rows[0] - 0.5 + covered
        # the ring bends away beside the middle line by a few hundredths of a pixel
        assert edge == pytest.approx(y, abs=0.06)


def test_rod_is_as_wide_as_its_silhouette() -> None:
    rig, board = survey_rig(), paper_board(0.0)
    placed = place_board(board, np.zeros(3), np.array([0.0, 1.3, 7.0]), np.random.default_rng(0))
    canvas = np.zeros((1200, 1920, 3), np.float32)
    draw_rods(
        canvas, rig.views()[0], placed, RodPaint((1, 1, 1), (1, 1, 1), 2.0, ambient=1, grime=0)
    )
    x, y = placed.marks_px(rig.views()[0])[2, 3].astype(int)
    # tangents to a cylinder of radius r at distance d: 2 r / sqrt(d^2 - r^2), times f
    assert canvas[y, x - 20 : x + 21, 0].sum() == pytest.approx(2 * 0.02 / 7 * 1650, rel=0.01)


def test_what_a_plate_covers_is_hidden() -> None:
    rig, board = survey_rig(), paper_board(0.0)
    view = rig.views()[0]
    placed = place_board(board, np.zeros(3), np.array([0.0, 1.3, 8.0]), np.random.default_rng(0))
    third = placed.marks_xyz()[2, 3] / 2
    mask = np.full((50, 50), 255, np.uint8)
    step = 0.002
    corner = third - np.array([25 * step, 25 * step, 0.0])
    plate = Billboard(
        np.zeros((50, 50, 3), np.uint8), mask, corner, step * np.eye(3)[0], step * np.eye(3)[1]
    )
    opacity = billboard_opacity(view, plate)
    assert opacity.sum() == pytest.approx((0.1 / 4 * 1650) ** 2, rel=0.06)
    visible = visible_marks(placed, view, opacity)
    assert not visible[2, 3]
    assert visible.sum() == 29


@pytest.mark.parametrize('kind', list(KINDS))
def test_backgrounds_have_clutter(kind: str) -> None:
    image = paint(kind, (320, 200), np.random.default_rng(0))
    assert image.shape == (200, 320, 3)
    assert 5 < image.std() < 110


def test_capture_is_reproducible() -> None:
    rig, board = survey_rig(0.25), paper_board()
    options = CaptureOptions(kinds=('snow',))
    one, same = (simulate_capture(board, rig, np.random.default_rng(3), options) for _ in range(2))
    np.testing.assert_array_equal(one.left, same.left)
    assert one.left.shape == (300, 480, 3)
    assert one.left_visible.all() and one.right_visible.all()


def test_sensor_blurs_exposes_and_adds_noise() -> None:
    canvas = np.zeros((200, 300, 3), np.float32)
    canvas[:, 150:] = 100.0
    image = expose(canvas, Sensor(1.5, 20.0, 0.7, 2.0), np.random.default_rng(0)).astype(float)
    assert image[:, :140].mean() == pytest.approx(20.0, abs=0.1)
    assert image[:, 160:].mean() == pytest.approx(170.0, abs=0.1)
    assert image[:, 160:].std() == pytest.approx(2.02, abs=0.05)  # rounding adds 1/12
    profile = (image.mean((0, 2)) - 20.0) / 150.0
    # half of the sampled Gaussian and half of its middle
    assert profile[150] == pytest.approx(0.785, abs=0.005)


def test_difficulties_are_what_they_say() -> None:
    rig, board = survey_rig(0.25), paper_board()
    hidden, cut, lean = 0, 0, []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        options = CaptureOptions(occluded=True, kinds=('snow',))
        capture = simulate_capture(board, rig, rng, options)
        hidden += int((~capture.left_visible).any() or (~capture.right_visible).any())
        assert (~capture.left_visible).sum(1).max() <= 3
        capture = simulate_capture(board, rig, rng, CaptureOptions(cut=True, kinds=('snow',)))
        cut += int(not (capture.left_visible.all() and capture.right_visible.all()))
        capture = simulate_capture(board, rig, rng, CaptureOptions(tilted=True, kinds=('snow',)))
        up = capture.left_px[2, -1] - capture.left_px[2, 0]
        lean.append(abs(np.rad2deg(np.arctan2(up[0], -up[1]))))
    assert hidden >= 3
    assert cut == 4
    assert min(lean) > 6 and max(lean) < 30


def test_board_that_fits_nowhere_is_refused() -> None:
    wide = RodBoard.from_mapping(
        {
            'rods': [{'x': 10.0 * i} for i in range(4)],
            'marks': [1.0, 2.0],
            'rod_diameter': 0.05,
            'placement_sigma': 0.0,
        }
    )
    with pytest.raises(CalibrationError, match=r'30 m wide and 2 m high does not fit'):
        draw_board(wide, survey_rig(), np.random.default_rng(0))


def _simulate(*arguments: str) -> None:
    parser = argparse.ArgumentParser()
    simulate.add_arguments(parser)
    simulate.run(parser.parse_args(arguments))


def test_command_writes_captures_and_truth(tmp_path: Path) -> None:
    photographs = tmp_path / 'photographs'
    photographs.mkdir()
    cv2.imwrite(str(photographs / 'one.png'), paint('grass', (400, 300), np.random.default_rng(0)))
    out = tmp_path / 'out'
    _simulate(
        'rods', '--output', str(out), '--boards', '1', '--seed', '7', '--placement', '0.002',
        '--backgrounds', str(photographs),
    )  # fmt: skip
    assert sorted(path.name for path in out.iterdir()) == [
        'left_0000.png', 'right_0000.png', 'rods.yaml', 'truth.json',
    ]  # fmt: skip
    assert load_rods(out / 'rods.yaml').height_sigma_m == pytest.approx(0.004)
    truth = json.loads((out / 'truth.json').read_text())
    assert truth['rig']['baseline_m'] == pytest.approx(1.0, abs=1e-3)
    assert np.array(truth['boards'][0]['left_px']).shape == (5, 6, 2)
    image = cv2.imread(str(out / 'left_0000.png'))
    assert image is not None and image.shape == (1200, 1920, 3)


def test_command_names_an_empty_folder(tmp_path: Path) -> None:
    with pytest.raises(FileError, match='holds no image'):
        _simulate('rods', '--output', str(tmp_path / 'out'), '--backgrounds', str(tmp_path))
