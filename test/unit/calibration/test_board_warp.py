# SPDX-License-Identifier: Apache-2.0
"""The warp of a board of points: found, allowed for, and reported."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from binocular_recon.calibration.adjustment.linearisation import State, linearise, predict
from binocular_recon.calibration.adjustment.split_halves import compare_halves
from binocular_recon.calibration.report._parameters import parameters
from binocular_recon.calibration.session.points_csv import read_points
from binocular_recon.calibration.solve import calibrate
from binocular_recon.calibration.target.target import Target
from binocular_recon.calibration.verdict import warnings_of
from binocular_recon.camera import FloatArray
from binocular_recon.cli.rigs.calibrate import summary
from binocular_recon.rotations import rotation
from test.calibration_tools import (
    CHESSBOARD,
    board_of,
    chessboard_captures,
    depth_rms_m,
    estimated,
    numeric_jacobian,
    points_target,
    solved,
    truth,
)

pytestmark = pytest.mark.long

BOWS = [(0.0, 0.0), (0.001, -0.0005), (0.003, 0.001)]


def test_points_of_a_flat_board_bend_and_nothing_else_does() -> None:
    target = points_target()
    # 1 % of 0.9 m
    assert target.bends and target.warp_sigma_m == pytest.approx(0.009)
    assert not target.exact().bends
    assert not Target.from_rods(board_of(0.005)).bends
    solid = target.anchors_m + np.array([0, 0, 1.0]) * target.anchors_m[:, :1] ** 2
    assert not Target.from_points(solid).bends


def test_the_warp_is_two_parabolas_with_its_size_in_the_middle() -> None:
    target = points_target(columns=3, rows=5)
    marks, _ = target.marks(np.zeros((15, 5)), np.array([0.002, 0.005]))
    bend = marks[:, 0, 2].reshape(5, 3)
    np.testing.assert_allclose(bend[2], [0.005, 0.007, 0.005])
    np.testing.assert_allclose(bend[:, 1], [0.002, 0.00575, 0.007, 0.00575, 0.002])
    np.testing.assert_allclose(bend[[0, 0, -1, -1], [0, -1, 0, -1]], 0, atol=1e-15)


def test_derivatives_by_the_warp_are_those_of_central_differences() -> None:
    target = points_target(columns=4, rows=3)
    turns = np.array([[3.0, 0.2, -0.1], [2.6, -0.4, 0.3]])
    places = np.array([[0.2, 0.1, 2.0], [0.6, -0.2, 4.0]])
    warp = np.array([0.004, -0.003])
    state = State(truth(), rotation(turns), places, np.zeros((2, 12, 5)), warp)

    def by_warp(step: FloatArray) -> FloatArray:
        none = np.zeros(30), np.zeros((2, 6)), np.zeros((2, 12, 5))
        return predict(state.moved(*none, step), target)

    _, jacobians = linearise(state, target)
    numeric = numeric_jacobian(by_warp, np.zeros(2))
    scale = np.abs(numeric).max()
    np.testing.assert_allclose(jacobians.warp.reshape(-1, 2), numeric, atol=1e-7 * scale)
    assert linearise(state, target.exact())[1].warp.shape[-1] == 0


@pytest.mark.parametrize('bow_m', BOWS)
def test_the_bow_of_a_board_is_found(bow_m: tuple[float, float]) -> None:
    for seed in range(2):
        found = estimated(chessboard_captures(seed=seed, bow_m=bow_m), points_target())
        errors = found.state.warp_m - bow_m
        assert np.all(np.abs(errors) < 3 * found.warp_sigma_m)
        assert np.all(np.abs(errors) < 1e-4) and np.all(found.warp_sigma_m < 5e-5)


@pytest.mark.parametrize('bow_m', BOWS[1:])
def test_depth_is_better_than_with_a_board_taken_as_flat(bow_m: tuple[float, float]) -> None:
    flat = replace(points_target(), warp_sigma_m=0.0)
    captures = chessboard_captures(seed=1, bow_m=bow_m)
    bent_m, flat_m = (
        depth_rms_m(estimated(captures, target), 5.0) for target in (points_target(), flat)
    )
    assert bent_m < 0.006
    assert bent_m < 0.5 * flat_m


def test_a_flat_board_is_calibrated_as_before() -> None:
    captures, target = chessboard_captures(seed=3), points_target()
    bent, flat = (estimated(captures, t) for t in (target, replace(target, warp_sigma_m=0.0)))
    sigma = np.sqrt(np.diag(flat.covariance))
    steps = [
        np.r_[np.diag(one.state.calibration.K_left)[:2], one.state.calibration.T]
        for one in (bent, flat)
    ]
    assert np.all(np.abs(steps[0] - steps[1]) < np.r_[sigma[:2], sigma[-3:]])
    # what the warp costs: its two parameters are marginalised
    ratio = np.sqrt(np.diag(bent.covariance)) / sigma
    assert np.all(ratio > 0.97) and np.all(ratio < 1.3)
    assert flat.warp_sigma_m.size == 0 and not flat.state.warp_m.any()


def test_the_covariance_is_the_marginal_one() -> None:
    found = estimated(chessboard_captures(8, seed=2), points_target())
    count = int(found.problem.free.sum())
    assert found.covariance.shape == (count, count)
    assert found.shared_covariance.shape == (count + 2, count + 2)
    known = np.linalg.inv(np.linalg.inv(found.shared_covariance)[:count, :count])
    assert np.all(np.diag(found.covariance) >= np.diag(known) * (1 - 1e-9))


def test_a_real_chessboard_is_slightly_bent() -> None:
    table = read_points(CHESSBOARD)
    result = calibrate(table.captures, table.target, table.least_size)
    warp = json.loads(json.dumps(result.to_mapping()))['board_warp_m']
    assert warp['y'] == pytest.approx(-0.17e-3, abs=0.02e-3)
    assert abs(warp['x']) < 3 * warp['sigma']['x']
    assert abs(warp['y']) > 3 * warp['sigma']['y']
    # as if it were flat: 0.2153 px
    assert result.rms_px < 0.210 < 0.214 < result.planar.error_px * np.sqrt(2) < 0.217
    assert 'warp of the board: x +0.03 +- ' in summary(result)
    assert 'warp of the board' in parameters(result)


def test_a_bent_board_is_pointed_out() -> None:
    found = estimated(chessboard_captures(12, seed=4, bow_m=(0.0013, 0.0)), points_target())
    halves = compare_halves(found)
    (words,) = (warning for warning in warnings_of(found, halves) if 'bent' in warning)
    assert 'the board is bent by 1.3 mm (+1.23 +- 0.03 mm along x and +0.0' in words
    assert 'fix it to a stiff plate' in words
    straight = replace(found, state=replace(found.state, warp_m=np.zeros(2)))
    assert not any('bent' in warning for warning in warnings_of(straight, halves))


def test_rods_have_no_warp() -> None:
    result = solved(0.005)
    assert result.to_mapping()['board_warp_m'] is None
    assert 'warp' not in summary(result)
    assert result.estimate.shared_covariance.shape == result.estimate.covariance.shape
