# SPDX-License-Identifier: Apache-2.0
"""A whole calibration from marks: the known result, its errors and its lens terms."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from binocular_recon.calibration import solve as solving
from binocular_recon.calibration.adjustment import estimation
from binocular_recon.calibration.adjustment.bundle_adjustment import minimise
from binocular_recon.calibration.adjustment.distortion import Evidence, choose_model
from binocular_recon.calibration.rectification.metric_rectification import (
    correction_of,
    metric_rig,
)
from binocular_recon.calibration.rectification.recalibration import corrected_marks
from binocular_recon.calibration.screening import observations
from binocular_recon.calibration.session.points_csv import read_points
from binocular_recon.calibration.solve import calibrate
from binocular_recon.errors import CalibrationError
from binocular_recon.evaluation.calibration.self_check import (
    check_rows,
    simulated_captures,
)
from binocular_recon.simulation.rig import survey_rig
from binocular_recon.simulation.rods import draw_board
from test.calibration_tools import (
    CHESSBOARD,
    SIZE,
    board_of,
    captures_of,
    check_sigmas,
    solved,
    truth,
)

pytestmark = pytest.mark.long


def test_chessboard_gives_the_known_result() -> None:
    table = read_points(CHESSBOARD)
    result = calibrate(table.captures, table.target, table.least_size)
    # what cv2.stereoCalibrate finds, which takes the board as flat
    assert np.sqrt(2) * result.planar.error_px == pytest.approx(0.215, rel=0.02)
    assert result.calibration.baseline_m == pytest.approx(0.0832, rel=0.02)
    assert not result.rejected and not result.estimate.outliers.any()
    assert result.model == 'k1 k2 p1 p2'


def test_result_states_the_three_methods_and_their_errors() -> None:
    result = solved(0.005)
    content = json.loads(json.dumps(result.to_mapping(), allow_nan=False))
    assert content['image_size'] == [1920, 1200]
    assert content['baseline_m'] == pytest.approx(1.0, abs=4 * content['sigma']['baseline_m'])
    assert {'fx_left_px', 'fx_right_px', 'baseline_m', 'k1_left', 'turn_y_rad', 'T_x_m'} <= set(
        content['sigma']
    )
    assert set(content['depth_sigma_m']) == {'10', '15', '20'}
    assert len(content['boards']) == 11 and content['boards'][0]['marks'] == 30
    for board in content['boards']:
        assert board['adjusted_px'] < 1.15 * 0.2
    planar, adjusted = (
        np.mean([board[f'{name}_px'] for board in content['boards']])
        for name in ('uncorrected', 'adjusted')
    )
    assert adjusted < 0.71 * planar  # the paper's 29 %
    rows = content['row_difference_px']
    assert rows['uncorrected']['mean'] > 3 * rows['corrected']['mean']
    assert rows['adjusted']['mean'] < 0.3
    assert content['rejected'] == []
    K, T = np.array(content['left']['K']), np.array(content['T'])
    assert K.shape == (3, 3) and len(content['left']['D']) == 5 and T[0] < 0


def test_stated_sigmas_cover_the_true_rig() -> None:
    check_sigmas(solved(0.005), truth())


def test_depth_sigma_has_the_share_of_the_disparity_noise() -> None:
    result = solved(0.005)
    own, total = result.depth_sigma_m(15, 0.0), result.depth_sigma_m(15, 0.1)
    noise = 15**2 / (result.rig.focal_px * result.rig.baseline_m) * 0.1
    assert total == pytest.approx(np.hypot(own, noise))
    assert result.depth_sigma_m(10, 0.0) < own < result.depth_sigma_m(20, 0.0)


def test_rows_on_boards_that_were_not_used() -> None:
    """A small part of Table 1 in ``calibrate --self-check``."""
    exact, rough = check_rows(sets=1, placements_m=(0.0, 0.010))
    assert 4 < exact.uncorrected_px < 8
    assert exact.corrected_px < 0.3 and exact.adjusted_px < 0.2
    assert rough.adjusted_px < 0.2


def test_rectification_that_is_saved_aligns_the_rows() -> None:
    result = solved(0.005)
    observed = observations(captures_of(seed=5))
    aligned = corrected_marks(
        observed, result.calibration, correction_of(result.calibration, result.rig)
    )
    assert np.abs(aligned[..., 1] - aligned[..., 3]).mean() < 0.3


def test_distortion_that_needs_more_terms_is_noticed() -> None:
    rig = truth()
    captures = captures_of(0.0, boards=18, noise_px=0.05)
    step = np.zeros(30)
    step[[8, 20]] = -0.5
    bent = rig.moved(step)
    moved = []
    for capture in captures:
        points = rig.triangulate(capture.left_px, capture.right_px)
        pixels = [bent.project(points, side) for side in ('left', 'right')]
        moved.append(replace(capture, left_px=pixels[0], right_px=pixels[1]))
    result = calibrate(moved, board_of(0.0), SIZE)
    assert result.model == 'k1 k2 p1 p2 k3'
    assert result.calibration.D_left[4] == pytest.approx(-0.5, abs=0.15)
    assert solved(0.005).model == 'k1 k2 p1 p2'


def test_weak_evidence_does_not_change_the_model() -> None:
    def evidence(k3: float, rational: float) -> tuple[Evidence, ...]:
        return (
            Evidence('k1', 0, 16, -50.0),
            Evidence('k1 k2 p1 p2', 0, 22, 0.0),
            Evidence('k1 k2 p1 p2 k3', 0, 24, k3),
            Evidence('rational', 0, 30, rational),
        )

    assert choose_model(evidence(-5.0, -9.0)) == 'k1 k2 p1 p2'
    assert choose_model(evidence(-20.0, -12.0)) == 'k1 k2 p1 p2 k3'
    assert choose_model(evidence(-20.0, -60.0)) == 'rational'


def test_an_unsettled_adjustment_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    """The rounds run out: state and problem still belong together."""
    monkeypatch.setattr(estimation, '_ROUNDS', -10)
    result = calibrate(captures_of(), board_of(0.005), SIZE)
    assert any('was not settled' in warning for warning in result.warnings)
    found = result.estimate
    again = minimise(found.problem, found.state).calibration
    np.testing.assert_allclose(again.T, found.state.calibration.T, atol=1e-6)


def test_without_correction_its_column_repeats_the_adjustment(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def fail(*_: object) -> None:
        raise CalibrationError('no camera fits')

    monkeypatch.setattr(solving, 'recalibrate', fail)
    result = calibrate(captures_of(), board_of(0.005), SIZE)
    assert any('its column repeats the adjustment: no camera fits' in w for w in result.warnings)
    assert result.corrected.error_px == result.adjusted.error_px


def test_rods_far_off_their_row_are_no_contradiction() -> None:
    board = replace(
        board_of(0.003), rods_xz_m=np.array([(0.6 * i, 0.6 * (i % 2)) for i in range(5)])
    )
    rig = survey_rig()
    rng = np.random.default_rng(0)
    placed = [draw_board(board, rig, rng) for _ in range(11)]
    result = calibrate(simulated_captures(rig, placed, 0.2, (0, 0)), board, SIZE)
    assert not result.rejected
    assert result.adjusted.error_px < 1.15 * 0.2


def test_squinting_rig_keeps_its_rows_and_depth() -> None:
    result = solved(0.005)
    rig = metric_rig(result.calibration)
    assert rig.baseline_m == pytest.approx(result.calibration.baseline_m)
