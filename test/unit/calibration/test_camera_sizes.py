# SPDX-License-Identifier: Apache-2.0
"""Cameras of different resolution: calibrated, saved, read, rectified to one size, matched."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from binocular_recon.apps.summary_entries import calibration_entry, rectified_rig
from binocular_recon.calibration.holding import check_holding
from binocular_recon.calibration.session.calibration_files import save_calibration
from binocular_recon.calibration.session.captures import read_captures
from binocular_recon.calibration.solve import calibrate
from binocular_recon.calibration.target.capture import Capture
from binocular_recon.camera import FloatArray, StereoRig
from binocular_recon.cli.main import main
from binocular_recon.errors import CalibrationError, ImageError
from binocular_recon.inputs.common_size import CommonSize
from binocular_recon.io.calibration_yaml import read_rig
from binocular_recon.io.image_files import write_image_file
from binocular_recon.simulation.capture import CaptureOptions, simulate_capture
from binocular_recon.simulation.render import Billboard, Sensor, draw_backdrop, expose
from binocular_recon.simulation.rig import RawRig, survey_rig
from binocular_recon.simulation.rods import draw_board, paper_board
from binocular_recon.stereo.rectification import Rectifier, rectified_points

pytestmark = pytest.mark.long

BOARD = paper_board()
DEPTH_M = 15.0


def rig_of(left: float, right: float, rows: int = 0) -> RawRig:
    """Return the survey rig at two scales, the right images higher by ``rows`` px."""
    camera = survey_rig(right).right
    K = camera.K + np.array([[0, 0, 0], [0, 0, rows / 2], [0, 0, 0]])
    return replace(survey_rig(left), right=replace(camera, height=camera.height + rows, K=K))


def captures_of(rig: RawRig, boards: int, noise_px: float = 0.1) -> list[Capture]:
    captures = []
    for index in range(boards):
        rng = np.random.default_rng([3, index])
        placed = draw_board(BOARD, rig, rng)
        marks = (placed.marks_px(view) for view in rig.views())
        captures.append(
            Capture(str(index), *(px + rng.normal(0, noise_px, px.shape) for px in marks))
        )
    return captures


def errors_of(rig: RawRig, found: StereoRig) -> tuple[float, float]:
    """Return the mean error of depth at 15 m, mm, and of rows (or columns), px, without noise."""
    rng = np.random.default_rng(6)
    points = DEPTH_M * np.column_stack(
        [rng.uniform(-0.25, 0.25, 300), rng.uniform(-0.15, 0.15, 300), np.ones(300)]
    )
    left, right = (
        rectified_points(camera, view.project(points))
        for camera, view in zip((found.left, found.right), rig.views(), strict=True)
    )
    seen = cv2.triangulatePoints(found.left.P, found.right.P, left.T, right.T)
    depths: FloatArray = ((seen[:3] / seen[3]).T @ found.left.R)[:, 2]
    across = 1 - abs(found.turns)
    off = np.abs(left[:, across] - right[:, across]).mean()
    return 1e3 * float(np.abs(depths - DEPTH_M).mean()), float(off)


def test_corners_stay_corners() -> None:
    sizes = CommonSize((1920, 1200), (2880, 2000))
    corners = np.array([[-0.5, 99.5], [2879.5, 1899.5]])
    np.testing.assert_allclose(sizes.scale, 0.6)
    np.testing.assert_allclose(sizes.to_common(np.full(2, -0.5)), np.array([95.5, -0.5]))
    np.testing.assert_allclose(sizes.to_right(sizes.to_common(corners)), corners)
    assert str(sizes) == '1920x1200 and 2880x2000 px'
    assert not CommonSize((9, 9), (9, 9)).differs


@pytest.mark.parametrize(('right', 'rows'), [(1.5, 0), (0.5, 200)])
def test_rods_calibrate_cameras_of_two_resolutions(
    right: float, rows: int, tmp_path: Path
) -> None:
    """As exactly as cameras of one: 20 to 60 mm at 15 m, 0.03 px of rows."""
    rig = rig_of(1.0, right, rows)
    captures = captures_of(rig, 11)
    result = calibrate(captures, BOARD, rig.left.size, right_size=rig.right.size)
    save_calibration(result, tmp_path)
    saved = read_rig(tmp_path)
    assert saved.left.size == (1920, 1200) and saved.right.size == rig.right.size
    depth_mm, rows_px = errors_of(rig, saved)
    assert depth_mm < min(75, 2e3 * result.depth_sigma_m(DEPTH_M, 0.0))
    assert rows_px < 0.06
    for name, (row, column) in (('fx_right_px', (0, 0)), ('cy_right_px', (1, 2))):
        off = saved.right.K[row, column] - rig.right.K[row, column]
        assert abs(off) < 3.5 * result.sigma[name], name
    # the noise of each camera's marks, in its own pixels
    noise = result.to_mapping()['mark_sigma_px']
    assert noise['v'] == pytest.approx(0.1, rel=0.15)
    assert noise['v_right'] == pytest.approx(0.1, rel=0.15)
    assert saved.covariance is not None
    index = saved.covariance.parameters.index('fx_right')
    assert np.sqrt(saved.covariance.matrix[index, index]) == pytest.approx(
        result.sigma['fx_right_px']
    )
    # what summary.json says of the rig is the rig, whatever the images were rectified with
    entry = json.loads(json.dumps(calibration_entry(saved)))
    assert entry['right_image_size'] == list(rig.right.size)
    for alpha in (-1.0, 0.0):
        read = rectified_rig({'source': {'alpha': alpha}}, entry)
        np.testing.assert_array_equal(read.left.P, Rectifier(saved, alpha).rig.left.P)
        assert read.covariance is not None
        assert read.covariance.right.size == rig.right.size
    holding = check_holding(saved, captures_of(rig, 3, 0.2), BOARD, rig.left.size, rig.right.size)
    assert not holding.faults
    with pytest.raises(CalibrationError, match=r'the images are 1920x1200 px, the calibration is'
                       r' for 1920x1200 and \d+x\d+ px'):  # fmt: skip
        check_holding(saved, captures, BOARD, rig.left.size)


def test_detection_and_files_take_images_of_two_sizes(tmp_path: Path) -> None:
    rig = rig_of(0.5, 0.75)
    options = CaptureOptions(depth_m=(5.0, 8.0))
    shown = simulate_capture(BOARD, rig, np.random.default_rng(3), options)
    for side in ('left', 'right'):
        write_image_file(tmp_path / f'{side}_a.png', getattr(shown, side))
        write_image_file(tmp_path / f'{side}_b.png', shown.left)
    (tmp_path / 'left_b.png').unlink()
    found = read_captures(tmp_path, BOARD)
    assert found.sizes == CommonSize((960, 600), (1440, 900))
    capture = found.captures[0]
    assert np.nanmax(np.abs(capture.left_px - shown.left_px)) < 0.5
    assert np.nanmax(np.abs(capture.right_px - shown.right_px)) < 0.5


def test_a_pair_of_two_sizes_is_reconstructed() -> None:
    rig = rig_of(0.25, 0.4)
    stereo = rig.stereo_rig()
    rng = np.random.default_rng(8)
    texture = cv2.GaussianBlur(rng.uniform(0, 255, (900, 1400, 3)), (0, 0), 1.5)
    texture = cv2.normalize(texture, None, 0, 255, cv2.NORM_MINMAX).astype(np.uint8)
    step = 2 * DEPTH_M / rig.left.K[0, 0] / 2
    wall = Billboard(
        texture, None, np.array([-700 * step, -450 * step, DEPTH_M]),
        step * np.eye(3)[0], step * np.eye(3)[1],
    )  # fmt: skip
    left, right = (
        expose(draw_backdrop(view, wall), Sensor(noise=1.0), rng) for view in rig.views()
    )
    rectifier = Rectifier(stereo)
    assert [image.shape for image in rectifier(left, right)] == [left.shape, left.shape]
    assert rectifier.rig.right.size == rig.left.size
    for alpha in (0.0, 1.0):
        assert Rectifier(stereo, alpha).rig.right.size == rig.left.size
    grey = [cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) for image in rectifier(left, right)]
    matcher = cv2.StereoSGBM.create(0, 64, 7, P1=200, P2=1600)
    disparity = matcher.compute(*grey) / 16 - stereo.disparity_offset_px
    depths = stereo.focal_px * stereo.baseline_m / disparity[disparity > 0]
    assert (disparity > 0).mean() > 0.5
    assert np.median(depths) == pytest.approx(DEPTH_M, rel=0.01)
    with pytest.raises(ImageError, match='right image is 480x300 px, its calibration is for 768'):
        rectifier(left, left)


@pytest.mark.parametrize('below_m', [1.0, -0.8])
def test_rods_calibrate_cameras_one_above_the_other(below_m: float, tmp_path: Path) -> None:
    """Columns correspond then; depth is as exact as with cameras side by side."""
    rig = survey_rig()
    rig = replace(rig, T=-rig.R @ np.array([0.02, below_m, 0.0]))
    result = calibrate(captures_of(rig, 11), BOARD, rig.left.size)
    save_calibration(result, tmp_path)
    saved = read_rig(tmp_path)
    assert saved.turns == (1 if below_m > 0 else -1)
    assert saved.baseline_m == pytest.approx(rig.baseline_m, abs=4 * result.sigma['baseline_m'])
    depth_mm, columns_px = errors_of(rig, saved)
    assert depth_mm < min(90, 2e3 * result.depth_sigma_m(DEPTH_M, 0.0))
    assert columns_px < 0.06
    # the marks differ by their noise, in columns, after all three methods have been applied
    differences = result.to_mapping()['row_difference_px']
    assert differences['uncorrected']['mean'] > 5
    assert differences['adjusted']['mean'] == pytest.approx(0.11, abs=0.02)
    assert not any('epipolar' in warning for warning in result.warnings)
    holding = check_holding(saved, captures_of(rig, 3, 0.2), BOARD, rig.left.size)
    assert not holding.faults and 'columns differ by 0.' in str(holding)


def test_points_of_two_sizes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rig = rig_of(0.5, 0.75)
    grid = np.stack(np.meshgrid(np.arange(8), np.arange(6)), -1).reshape(-1, 2) * 0.12
    rows: list[list[object]] = [['name', 'side', 'id', 'X_m', 'Y_m', 'u_px', 'v_px']]
    rng = np.random.default_rng(4)
    for board in range(9):
        turn = cv2.Rodrigues(rng.uniform(-0.5, 0.5, 3))[0]
        middle = np.array([rng.uniform(-0.2, 1.0), rng.uniform(-0.5, 0.5), rng.uniform(2.5, 5)])
        points = np.column_stack([grid - grid.mean(axis=0), np.zeros(len(grid))])
        for side, view in zip(('left', 'right'), rig.views(), strict=True):
            pixels = view.project(points @ turn.T + middle) + rng.normal(0, 0.1, (len(grid), 2))
            inside = ((pixels > 0) & (pixels < np.array(view.camera.size) - 1)).all(axis=1)
            rows += [[f'{board}', side, i, *grid[i], *pixels[i]] for i in np.flatnonzero(inside)]
    table = tmp_path / 'points.csv'
    with table.open('w', newline='') as file:
        csv.writer(file).writerows(rows)
    command = ['calibrate', '--points', str(table), '--output', str(tmp_path / 'rig')]
    assert main([*command, '--image-size', '960x600', '--right-image-size', '1440x900']) == 0
    found = read_rig(tmp_path / 'rig')
    assert found.right.size == (1440, 900)
    assert found.right.K[0, 0] == pytest.approx(rig.right.K[0, 0], rel=5e-3)
    assert found.baseline_m == pytest.approx(rig.baseline_m, rel=5e-3)
    assert errors_of(rig, found)[1] < 0.2
    assert main([*command, '--right-image-size', '1440x900']) != 0
    assert '--right-image-size needs --image-size' in capsys.readouterr().err
