# SPDX-License-Identifier: Apache-2.0
"""An older calibration against marks captured later: its rows, its scale and their sigmas."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from binocular_recon.calibration.holding import check_holding
from binocular_recon.calibration.rectification.metric_rectification import metric_rig
from binocular_recon.calibration.target.target import Target
from binocular_recon.errors import CalibrationError
from binocular_recon.rotations import rotation
from test.calibration_tools import (
    SIZE,
    board_of,
    captures_of,
    chessboard_captures,
    points_target,
    solved,
    truth,
)

pytestmark = pytest.mark.long

BOARD = board_of(0.005)


def test_exact_marks_of_the_true_rig_have_equal_rows_and_the_true_scale() -> None:
    holding = check_holding(metric_rig(truth()), captures_of(noise_px=0.0), BOARD, SIZE)
    assert holding.boards == 11 and holding.marks == 330
    # both cameras see edges on the near side of the rods, hardly apart
    assert holding.rows_px < 0.02 and abs(holding.scale - 1) < 2e-5
    assert np.isnan(holding.calibration_sigma) and holding.faults == ()
    assert 'the sigma of the calibration is not known' in str(holding)


def test_a_calibration_holds_within_its_sigmas() -> None:
    rig = solved(0.005).rig
    errors = []
    for seed in range(5):
        holding = check_holding(rig, captures_of(boards=5, seed=40 + seed), BOARD, SIZE)
        assert holding.faults == () and holding.systematic_rows_px < 0.15
        assert holding.rows_px == pytest.approx(np.sqrt(2 * 2 / np.pi) * 0.2, abs=0.03)
        assert 0 < holding.calibration_sigma < holding.scale_sigma < 0.003
        errors.append((holding.scale - 1) / holding.scale_sigma)
    assert np.sqrt(np.mean(np.square(errors))) < 2


@pytest.mark.parametrize(('pitch', 'yaw', 'baseline'), [(1e-3, 0, 1), (0, 1e-3, 1), (0, 0, 1.01)])
def test_a_rig_that_changed_is_told_by_rows_or_lengths(
    pitch: float, yaw: float, baseline: float
) -> None:
    found = solved(0.005)
    turned = rotation(np.array([pitch, yaw, 0.0])) @ found.calibration.R
    changed = replace(found.calibration, R=turned, T=baseline * found.calibration.T)
    known = found.rig.covariance
    assert known is not None
    bare = metric_rig(changed)
    rig = replace(bare, covariance=replace(known, left=bare.left, right=bare.right))
    holding = check_holding(rig, captures_of(boards=4, seed=70), BOARD, SIZE)
    (fault,) = holding.faults
    if pitch:
        # 1 mrad of f = 1655 px
        assert holding.systematic_rows_px == pytest.approx(1.7, abs=0.2)
        assert 'rows differ by 1.' in fault and 'a camera has moved' in fault
    elif yaw:
        # Z^2 / (f b) x 1.7 px
        assert abs(holding.scale - 1) == pytest.approx(1e-3 * holding.depth_m, rel=0.25)
        assert 'standard deviations (at most 3): depth at ' in fault
    else:
        assert holding.scale == pytest.approx(1.01, abs=0.002)
        assert 'lengths are +1.' in fault


def test_boards_of_points_are_compared_as_a_whole() -> None:
    captures = chessboard_captures(5, seed=3)
    holding = check_holding(metric_rig(truth()), captures, points_target(), SIZE)
    assert holding.boards == 5 and holding.scale == pytest.approx(1, abs=0.001)
    long = Target.from_points(0.99 * points_target().anchors_m)
    wrong = check_holding(metric_rig(truth()), captures, long, SIZE)
    assert wrong.scale == pytest.approx(1 / 0.99, abs=0.001) and len(wrong.faults) == 1


def test_what_cannot_be_compared_is_refused() -> None:
    rig, captures = metric_rig(truth()), captures_of(boards=1)
    with pytest.raises(CalibrationError, match='are 640x480 px, the calibration is for 1920x1200'):
        check_holding(rig, captures, BOARD, (640, 480))
    with pytest.raises(CalibrationError, match='none of 0 boards has a mark in both images'):
        check_holding(rig, [], BOARD, SIZE)
    one = np.full((5, 6, 2), np.nan)
    one[0, 0] = captures[0].left_px[0, 0]
    alone = replace(captures[0], left_px=one)
    assert 'too few to compare lengths' in str(check_holding(rig, [alone], BOARD, SIZE))
