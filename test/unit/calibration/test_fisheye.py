# SPDX-License-Identifier: Apache-2.0
"""Calibration of a rig of equidistant (fisheye) cameras, and of lenses that cannot be."""

from __future__ import annotations

import csv
import functools
import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from binocular_recon.calibration.adjustment.distortion import Evidence, choose_model
from binocular_recon.calibration.adjustment.fisheye_start import fisheye_guess, start_fisheye
from binocular_recon.calibration.adjustment.linearisation import State, linearise, predict
from binocular_recon.calibration.adjustment.uncertainty import depth_sigma_m
from binocular_recon.calibration.model import StereoCalibration
from binocular_recon.calibration.rectification.metric_rectification import correction_of
from binocular_recon.calibration.rectification.recalibration import corrected_marks
from binocular_recon.calibration.result import CalibrationResult
from binocular_recon.calibration.screening import observations, rejection_reason
from binocular_recon.calibration.session.calibration_files import save_calibration
from binocular_recon.calibration.solve import calibrate
from binocular_recon.calibration.target.capture import Capture
from binocular_recon.calibration.target.target import Target
from binocular_recon.camera import FloatArray
from binocular_recon.cli.main import main
from binocular_recon.errors import CalibrationError
from binocular_recon.evaluation.calibration.self_check import true_calibration
from binocular_recon.io.calibration_yaml import read_rig
from binocular_recon.lenses import LENSES
from binocular_recon.simulation.rig import fisheye_rig
from binocular_recon.stereo.rectification import Rectifier, rectified_points
from test.calibration_tools import (
    SIZE,
    board_of,
    captures_of,
    check_sigmas,
    fisheye_captures,
    numeric_jacobian,
)

pytestmark = pytest.mark.long

SEEDS = range(4)


def fisheye_truth() -> StereoCalibration:
    return true_calibration(fisheye_rig())


@functools.cache
def solved_fisheye(placement_m: float, seed: int) -> CalibrationResult:
    captures = fisheye_captures(placement_m, seed=seed)
    return calibrate(captures, board_of(placement_m), SIZE, lens='equidistant')


def points_at_15_m() -> FloatArray:
    """Return points up to 57 degrees from the axis, (N, 3) m."""
    x, y = np.meshgrid(np.linspace(-1.4, 1.4, 9), np.linspace(-0.6, 0.6, 5))
    return 15.0 * np.column_stack([x.ravel(), y.ravel(), np.ones(x.size)])


@pytest.mark.parametrize('placement_m', [0.0, 0.005])
def test_depth_errors_are_as_large_as_predicted(placement_m: float) -> None:
    points, truth = points_at_15_m(), fisheye_truth()
    pixels = [truth.project(points, side) for side in ('left', 'right')]
    ratios = []
    for seed in SEEDS:
        result = solved_fisheye(placement_m, seed)
        errors = (result.calibration.triangulate(*pixels) - points)[:, 2]
        sigma = depth_sigma_m(
            result.calibration, result.estimate.problem.free, result.estimate.covariance, points
        )
        ratios.append(np.sqrt(np.mean((errors / sigma) ** 2)))
        assert np.abs(errors / sigma).max() < 4
    assert max(ratios) < 3
    assert 0.6 < np.sqrt(np.mean(np.square(ratios))) < 1.4


@pytest.mark.parametrize('seed', SEEDS)
def test_stated_sigmas_cover_the_true_rig(seed: int) -> None:
    result = solved_fisheye(0.005, seed)
    check_sigmas(result, fisheye_truth())
    assert result.adjusted.error_px < 1.15 * 0.2
    assert not result.rejected and not result.warnings


def test_rows_correspond_after_rectification() -> None:
    result, points, truth = solved_fisheye(0.0, 0), points_at_15_m(), fisheye_truth()
    marks = np.concatenate([truth.project(points, side) for side in ('left', 'right')], axis=-1)
    aligned = corrected_marks(
        marks, result.calibration, correction_of(result.calibration, result.rig)
    )
    assert np.abs(aligned[:, 1] - aligned[:, 3]).mean() < 0.1


def test_exact_marks_give_the_rig_back() -> None:
    """Without noise, terms beyond the default two are called for."""
    captures = fisheye_captures(0.0, noise_px=0.0)
    truth, points = fisheye_truth(), points_at_15_m()
    result = calibrate(captures, board_of(0.0), SIZE, lens='equidistant')
    assert result.model == 'k1 k2 k3'
    pixels = [truth.project(points, side) for side in ('left', 'right')]
    assert np.abs(result.calibration.triangulate(*pixels) - points).max() < 0.03
    assert result.adjusted.error_px < 0.01


def test_saved_files_are_those_of_a_fisheye_camera_and_rectify(tmp_path: Path) -> None:
    result = solved_fisheye(0.005, 0)
    save_calibration(result, tmp_path)
    text = (tmp_path / 'left.yaml').read_text()
    assert 'distortion_model: equidistant' in text
    rig = read_rig(tmp_path)
    for camera, D in (
        (rig.left, result.calibration.D_left),
        (rig.right, result.calibration.D_right),
    ):
        assert camera.distortion_model == 'equidistant'
        np.testing.assert_array_equal(camera.D, D)
    report = (tmp_path / 'report.html').read_text()
    assert '<td>k2</td>' in report and '<td>p1</td>' not in report
    # a spot at 9 m lands in the rows of the rectified images that the files state
    truth, point = fisheye_truth(), np.array([[4.0, -1.0, 9.0]])
    images, rows = [], []
    for side, camera in (('left', rig.left), ('right', rig.right)):
        y, x = np.mgrid[:1200, :1920]
        spot = truth.project(point, side)
        blob = 255 * np.exp(-((x - spot[0, 0]) ** 2 + (y - spot[0, 1]) ** 2) / 18)
        images.append(blob.astype(np.float32))
        rows.append(rectified_points(camera, spot)[0, 1])
    for row, rectified in zip(rows, Rectifier(rig)(*images), strict=True):
        weights = rectified.sum(axis=1)
        assert weights @ np.arange(1200) / weights.sum() == pytest.approx(row, abs=0.05)
    assert abs(rows[0] - rows[1]) < 0.3


def test_derivatives_are_those_of_central_differences() -> None:
    rng = np.random.default_rng(1)
    truth = fisheye_truth()
    state = State(
        truth,
        np.diag([1.0, -1, -1])[None],
        np.array([[0.5, 0.9, 2.5]]),
        rng.normal(0, 0.03, (1, 5, 5)),
    )
    target = Target.from_rods(board_of(0.005))
    count = len(truth.parameters)
    assert count == 22
    _, jacobians = linearise(state, target)

    def marks(step: FloatArray) -> FloatArray:
        return predict(state.moved(step, np.zeros((1, 6)), np.zeros((1, 5, 5))), target)

    numeric = numeric_jacobian(marks, np.zeros(count))
    scale = np.abs(numeric).max()
    np.testing.assert_allclose(
        jacobians.calibration.reshape(-1, count), numeric, atol=1e-7 * scale
    )


def test_the_start_is_near_the_focal_length() -> None:
    target, lens = Target.from_rods(board_of(0.005)), LENSES['equidistant']
    pixels = observations(fisheye_captures())[..., :2].reshape(14, -1, 2)
    points = target.nominal_m.reshape(-1, 3)
    K, errors_px = fisheye_guess(points, pixels, SIZE, lens)
    assert K[0, 0] == pytest.approx(700, rel=0.08)
    assert np.median(errors_px) < 8
    few = np.where(np.arange(30)[:, None] < 5, pixels[:1], np.nan)
    with pytest.raises(CalibrationError, match='no equidistant camera fits the marks'):
        fisheye_guess(points, few, SIZE, lens)
    with pytest.raises(CalibrationError, match=r'1 of 15 boards have fewer than 6 marks within'):
        start_fisheye(points, np.concatenate([pixels, few]), SIZE, lens)


def test_model_is_chosen_among_those_of_the_lens() -> None:
    def evidence(three: float, four: float) -> tuple[Evidence, ...]:
        return (
            Evidence('k1', 0, 16, -50.0),
            Evidence('k1 k2', 0, 18, 0.0),
            Evidence('k1 k2 k3', 0, 20, three),
            Evidence('k1 k2 k3 k4', 0, 22, four),
        )

    assert choose_model(evidence(-5.0, -9.0), 'equidistant') == 'k1 k2'
    assert choose_model(evidence(-20.0, -60.0), 'equidistant') == 'k1 k2 k3 k4'


def test_a_bad_board_is_named_left_out_and_the_rest_used() -> None:
    captures = fisheye_captures(seed=1)
    left = captures[5].left_px.copy()
    left[[1, 2]] = left[[2, 1]]
    captures[5] = replace(captures[5], left_px=left)
    reason = rejection_reason(
        captures[5], Target.from_rods(board_of(0.005)), SIZE, captures[:5], 'equidistant'
    )
    assert reason and 'a rod or a mark was taken for another one' in reason
    result = calibrate(captures, board_of(0.005), SIZE, lens='equidistant')
    assert [board.name for board in result.rejected] == ['05']


def test_marks_of_an_ordinary_lens_are_not_taken_for_a_fisheye() -> None:
    """Both lenses are alike near the axis: the coefficients make up for the difference."""
    result = calibrate(captures_of(), board_of(0.005), SIZE, lens='equidistant')
    assert result.calibration.lens == 'equidistant'
    assert result.adjusted.error_px < 1.3 * 0.2


@pytest.mark.parametrize(
    ('lens', 'message'),
    [
        ('fov', r"lens 'fov' is unknown; choose plumb_bob or equidistant"),
        ('rational_polynomial', 'a rational_polynomial lens cannot be chosen .* where the marks'),
    ],
)
def test_lenses_that_cannot_be_calibrated_are_refused(lens: str, message: str) -> None:
    with pytest.raises(CalibrationError, match=message):
        calibrate(captures_of(), board_of(0.005), SIZE, lens=lens)


def test_fisheye_marks_calibrated_as_plumb_bob_are_refused() -> None:
    with pytest.raises(CalibrationError):
        calibrate(fisheye_captures(), board_of(0.005), SIZE)


def write_points(path: Path, captures: list[Capture], target: Target) -> None:
    """Write the marks of flat boards as the table of another detector."""
    places = target.nominal_m
    with path.open('w', newline='') as file:
        table = csv.writer(file)
        table.writerow(['name', 'side', 'id', 'X_m', 'Y_m', 'u_px', 'v_px'])
        for capture in captures:
            for side, marks in (('left', capture.left_px), ('right', capture.right_px)):
                for rod, mark in itertools.product(*map(range, marks.shape[:2])):
                    if np.isfinite(marks[rod, mark]).all():
                        X, Y, _ = places[rod, mark]
                        row = [capture.name, side, f'{rod}-{mark}', X, Y, *marks[rod, mark]]
                        table.writerow(row)


def test_points_of_another_detector_take_the_lens_too(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    thin = replace(board_of(0.0), rod_diameter_m=1e-6)
    rig, path = fisheye_rig(), tmp_path / 'points.csv'
    write_points(path, fisheye_captures(0.0, board=thin), Target.from_rods(thin))
    arguments = ['--points', str(path), '--image-size', '1920x1200', '--lens', 'equidistant']
    assert main(['calibrate', *arguments, '--output', str(tmp_path / 'rig')]) == 0
    found = read_rig(tmp_path / 'rig')
    assert found.left.distortion_model == 'equidistant'
    assert found.left.K[0, 0] == pytest.approx(rig.left.K[0, 0], abs=1.0)
    assert found.baseline_m == pytest.approx(rig.baseline_m, abs=0.003)
    with pytest.raises(SystemExit):
        main(['calibrate', *arguments[:-1], 'fov'])
    assert "invalid choice: 'fov'" in capsys.readouterr().err
