# SPDX-License-Identifier: Apache-2.0
"""Planar calibration against OpenCV's, on real and simulated boards."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from binocular_recon.calibration.adjustment.linearisation import predict
from binocular_recon.calibration.adjustment.planar import calibrate_planar, first_guess
from binocular_recon.calibration.model import check_finite
from binocular_recon.calibration.screening import observations
from binocular_recon.calibration.session.points_csv import read_points
from binocular_recon.calibration.target.target import Target
from binocular_recon.errors import CalibrationError
from binocular_recon.evaluation.calibration.opencv_calibration import calibrate_in_two_steps
from binocular_recon.evaluation.calibration.self_check import depth_errors_m
from test.calibration_tools import CHESSBOARD, SIZE, board_of, captures_of, truth


def test_chessboard_is_that_of_opencv() -> None:
    table = read_points(CHESSBOARD)
    observed = observations(table.captures)
    state = calibrate_planar(observed, table.target, table.least_size)
    errors = observed - predict(state, table.target)
    points = [table.target.nominal_m.reshape(-1, 1, 3).astype(np.float32)] * len(observed)
    images = [
        [np.ascontiguousarray(board[:, 0, uv], np.float32)[:, None] for board in observed]
        for uv in (slice(0, 2), slice(2, 4))
    ]
    flags = cv2.CALIB_FIX_K3
    single = [
        cv2.calibrateCamera(points, image, table.least_size, None, None, flags=flags)[1:3]
        for image in images
    ]
    rms, K_left, _, K_right, _, R, T = cv2.stereoCalibrate(
        points, *images, *single[0], *single[1], table.least_size,
        flags=flags | cv2.CALIB_USE_INTRINSIC_GUESS,
    )[:7]  # fmt: skip
    assert np.sqrt(2 * np.mean(errors**2)) == pytest.approx(rms, rel=0.002)
    found = state.calibration
    assert found.baseline_m == pytest.approx(float(np.linalg.norm(T)), rel=1e-4)
    np.testing.assert_allclose(found.K_left, K_left, atol=0.2)
    np.testing.assert_allclose(found.K_right, K_right, atol=0.2)
    np.testing.assert_allclose(found.R, R, atol=2e-4)


def test_exact_rods_are_calibrated_as_well_as_by_the_adjustment() -> None:
    target = Target.from_rods(board_of(0.0))
    state = calibrate_planar(observations(captures_of(0.0)), target, SIZE)
    assert np.abs(depth_errors_m(state.calibration, truth())[1]).mean() < 0.1
    assert state.calibration.baseline_m == pytest.approx(1.0, abs=0.01)


def test_the_same_marks_give_the_same_bits() -> None:
    """OpenCV adds up the boards in the order in which its threads finish, if it may."""
    threads = cv2.getNumThreads()
    target = Target.from_rods(board_of(0.005))
    observed = observations(captures_of(0.005, boards=16))
    found = {
        calibrate_planar(observed, target, SIZE).calibration.K_left.tobytes() for _ in range(5)
    }
    assert len(found) == 1
    assert cv2.getNumThreads() == threads


def test_first_guess_is_near_the_focal_length() -> None:
    target = Target.from_rods(board_of(0.005))
    pixels = observations(captures_of())[..., :2].reshape(11, -1, 2)
    K = first_guess(target.nominal_m.reshape(-1, 3), pixels, SIZE)
    assert K[0, 0] == pytest.approx(1650, rel=0.1)
    np.testing.assert_allclose(K[:2, 2], [959.5, 599.5])


def test_marks_in_one_spot_are_refused() -> None:
    target = Target.from_rods(board_of(0.005))
    observed = np.full((4, 5, 6, 4), 500.0)
    with pytest.raises(CalibrationError, match=r'check that rods\.yaml'):
        calibrate_planar(observed, target, SIZE)


def test_a_solution_that_diverged_is_refused() -> None:
    with pytest.raises(CalibrationError, match='the solution diverged'):
        check_finite(replace(truth(), T=np.array([np.nan, 0, 0])))
    with pytest.raises(CalibrationError, match='the solution diverged'):
        check_finite(replace(truth(), K_left=np.diag([-1.0, 1, 1])))


def test_opencv_in_two_steps_finds_exact_boards() -> None:
    """What remains without noise is the thickness of the rods, which it does not know."""
    captures, target = captures_of(0.0, noise_px=0.0), Target.from_rods(board_of(0.0))
    errors_m = depth_errors_m(calibrate_in_two_steps(captures, target, SIZE), truth())
    assert (np.abs(errors_m).mean(axis=1) < [0.04, 0.07, 0.13]).all()
