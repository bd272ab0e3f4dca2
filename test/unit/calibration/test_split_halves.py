# SPDX-License-Identifier: Apache-2.0
"""Halves of the boards: alike where everything is as modelled, apart where it is not."""

from __future__ import annotations

import functools
import json
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from binocular_recon.calibration.adjustment import split_halves
from binocular_recon.calibration.adjustment.bundle_adjustment import minimise, normal_equations
from binocular_recon.calibration.adjustment.estimation import Estimate
from binocular_recon.calibration.adjustment.split_halves import compare_halves
from binocular_recon.calibration.adjustment.uncertainty import depth_derivatives, field_of_view
from binocular_recon.calibration.model import StereoCalibration
from binocular_recon.calibration.report._parameters import parameters
from binocular_recon.calibration.result import CalibrationResult
from binocular_recon.calibration.session.points_csv import read_points
from binocular_recon.calibration.solve import calibrate
from binocular_recon.calibration.target.capture import Capture
from binocular_recon.calibration.target.target import Target
from binocular_recon.camera import FloatArray
from binocular_recon.cli.rigs.calibrate import summary
from binocular_recon.nodes.calibration.steps import describe_result
from test.calibration_tools import (
    CHESSBOARD,
    SIZE,
    board_of,
    captures_of,
    chessboard_captures,
    depth_rms_m,
    estimated,
    points_target,
    solved,
    stated_rms_m,
    truth,
)

pytestmark = pytest.mark.long

Change = Callable[[list[Capture], np.random.Generator], list[Capture]]


def rods(placement_m: float, boards: int, seed: int, change: Change | None = None) -> Estimate:
    captures = captures_of(placement_m, boards, seed=seed)
    captures = change(captures, np.random.default_rng([seed, 99])) if change else captures
    return estimated(captures, Target.from_rods(board_of(placement_m)))


def points(boards: int, seed: int, change: Change | None = None) -> Estimate:
    rng = np.random.default_rng([seed, 99])
    captures = chessboard_captures(boards, seed=seed)
    # not from near to far, as they are drawn
    captures = [captures[i] for i in rng.permutation(boards)]
    return estimated(change(captures, rng) if change else captures, points_target())


def shifted(captures: list[Capture], rng: np.random.Generator) -> list[Capture]:
    """Shift all marks of an image by 0.3 px, in another direction each time."""
    angles = rng.uniform(0, 2 * np.pi, (len(captures), 2))
    shifts = 0.3 * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    return [
        replace(c, left_px=c.left_px + shift[0], right_px=c.right_px + shift[1])
        for c, shift in zip(captures, shifts, strict=True)
    ]


def other_lenses(captures: list[Capture], rng: np.random.Generator) -> list[Capture]:
    """Give both lenses another k1 on every board."""

    def bent(pixels: FloatArray, K: FloatArray, k1: float) -> FloatArray:
        plane = (pixels - K[:2, 2]) / K[0, 0]
        moved: FloatArray = K[0, 0] * k1 * plane * np.sum(plane**2, axis=-1, keepdims=True)
        return pixels + moved

    K = truth().K_left, truth().K_right
    return [
        replace(c, left_px=bent(c.left_px, K[0], k1[0]), right_px=bent(c.right_px, K[1], k1[1]))
        for c, k1 in zip(captures, rng.normal(0, 0.005, (len(captures), 2)), strict=True)
    ]


def zoomed(captures: list[Capture], _rng: np.random.Generator) -> list[Capture]:
    """Enlarge both focal lengths by 0.3 % after the first half of the boards."""
    change = []
    for index, c in enumerate(captures):
        factor = 1.003 if index >= len(captures) // 2 else 1.0
        (left, right) = (
            (pixels - K[:2, 2]) * factor + K[:2, 2]
            for pixels, K in ((c.left_px, truth().K_left), (c.right_px, truth().K_right))
        )
        change.append(replace(c, left_px=left, right_px=right))
    return change


def zoomed_truth() -> StereoCalibration:
    true, zoom = truth(), np.diag([1.003, 1.003, 1.0])
    K = true.K_left.copy(), true.K_right.copy()
    for one in K:
        one[:2, :2] = zoom[:2, :2] @ one[:2, :2]
    return replace(true, K_left=K[0], K_right=K[1])


@functools.cache
def faulty() -> CalibrationResult:
    """Calibrate with boards whose marks are shifted; computed once for all tests."""
    captures = shifted(captures_of(0.0, 14, seed=1), np.random.default_rng(1))
    return calibrate(captures, board_of(0.0), SIZE)


def rms(values: list[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


@pytest.mark.parametrize(
    'honest',
    [
        functools.partial(rods, 0.005, 11),
        functools.partial(rods, 0.0, 11),
        functools.partial(rods, 0.005, 6),
        functools.partial(points, 13),
    ],
)
def test_halves_agree_where_everything_is_as_modelled(
    honest: Callable[[int], Estimate],
) -> None:
    ratios = []
    for seed in range(3):
        halves = compare_halves(honest(seed))
        assert halves.by_lot and halves.in_order
        assert halves.factor == 1.0 and not halves.warning
        assert 0.4 < halves.by_lot.ratio < 1.5
        assert halves.by_lot.limit == (1.75 if sum(halves.boards) < 11 else 1.5)
        assert halves.in_order.ratio < halves.in_order.limit < 3.3
        ratios.append(halves.by_lot.ratio)
    assert 0.6 < rms(ratios) < 1.3


@pytest.mark.parametrize(
    ('boards', 'change'),
    [
        (functools.partial(points, 20), shifted),
        (functools.partial(points, 20), other_lenses),
        (functools.partial(rods, 0.0, 22), shifted),
    ],
)
def test_what_differs_from_board_to_board_inflates_sigma(
    boards: Callable[[int, Change], Estimate], change: Change
) -> None:
    before, after = [], []
    for seed in range(3):
        found = boards(seed, change)
        halves = compare_halves(found)
        assert 'something differed from board to board' in halves.warning
        before.append(depth_rms_m(found, 5.0) / stated_rms_m(found, 5.0))
        after.append(before[-1] / halves.factor)
    assert rms(before) > 1.25
    assert 0.5 < rms(after) < 1.5


def test_a_focal_length_that_changes_in_between_inflates_sigma() -> None:
    before, after = [], []
    for seed in range(3):
        found = points(30, seed, zoomed)
        halves = compare_halves(found)
        assert halves.factor > 2
        assert 'something changed in the course of the capture' in halves.warning
        stated = stated_rms_m(found, 3.0)
        before += [depth_rms_m(found, 3.0, true) / stated for true in (truth(), zoomed_truth())]
        after += [ratio / halves.factor for ratio in before[-2:]]
    assert rms(before) > 3
    assert 0.5 < rms(after) < 1.5


def test_a_half_is_adjusted_as_if_it_were_all() -> None:
    """One step from the adjustment of all boards leads to the minimum of a half."""
    found = rods(0.005, 30, 1)
    first = np.arange(30) % 2 == 0
    field = field_of_view(found.state.calibration, 10.0)
    derivatives = depth_derivatives(found.state.calibration, found.problem.free, field)
    equations = normal_equations(found.problem, found.state)
    split = split_halves._split(equations, derivatives, first)
    pixels = [found.state.calibration.project(field, side) for side in ('left', 'right')]
    depths = []
    for half in (first, ~first):
        problem = replace(found.problem, observed_px=found.problem.observed_px[half])
        state = minimise(problem, found.state.select(half))
        depths.append(state.calibration.triangulate(*pixels)[:, 2])
    sigma = np.sqrt(np.diag(split.covariance))
    assert np.all(np.abs(split.difference_m - (depths[0] - depths[1])) < 0.25 * sigma)
    # without what both know beforehand, the covariances of independent halves add up
    bare = replace(equations, prior=1e-9 * equations.prior)
    covariance = sum(bare.select(half).covariance()[0] for half in (first, ~first))
    np.testing.assert_allclose(
        split_halves._split(bare, derivatives, first).covariance,
        derivatives @ covariance @ derivatives.T,
        rtol=1e-4,
        atol=1e-9,
    )


def test_everything_that_is_stated_carries_the_factor() -> None:
    result = faulty()
    factor = result.halves.factor
    assert factor > 1.5 and result.estimate.inflation == factor
    bare = replace(result, estimate=replace(result.estimate, inflation=1.0))
    for name, sigma in bare.sigma.items():
        assert result.sigma[name] == pytest.approx(factor * sigma), name
    assert result.depth_sigma_m(15, 0.0) == pytest.approx(factor * bare.depth_sigma_m(15, 0.0))
    best = result.advice[0]
    assert best.sigma_before_m == pytest.approx(result.depth_sigma_m(best.depth_m, 0.0))
    assert 0 < best.gain < 1


def test_halves_that_contradict_each_other_are_reported() -> None:
    result = faulty()
    entry = json.loads(json.dumps(result.to_mapping(), allow_nan=False))['split_half']
    assert entry['inflated'] and entry['factor'] >= entry['ratio'] > entry['limit']
    assert entry['boards'] == [7, 7] and entry['reason'] is None
    assert entry['by_lot']['splits'] == 4 and entry['in_order']['splits'] == 1
    depths = list(entry['by_lot']['depth_m'])
    assert len(depths) == 3 and 4 < float(depths[0]) < float(depths[2]) < 17
    assert all(one['difference'] > 0 for one in entry['by_lot']['depth_m'].values())
    words = f'all sigmas were multiplied by {result.halves.factor:.2f}'
    assert words in result.warnings[0] and 'lock focus' in result.warnings[0]
    assert words in summary(result) and words in describe_result(result)
    assert 'Halves of the boards differ in depth by ' in parameters(result)


def test_halves_that_agree_are_reported() -> None:
    result = solved(0.005)
    entry = result.to_mapping()['split_half']
    assert not entry['inflated'] and entry['factor'] == 1 and entry['ratio'] < entry['limit']
    assert entry['boards'] == [6, 5]
    assert 'halves of the boards differ in depth by ' in summary(result)
    assert 'halves' not in describe_result(result)
    assert not any('halves' in warning for warning in result.warnings)


def test_too_few_boards_are_not_compared_but_mentioned() -> None:
    result = calibrate(captures_of(0.002, 5), board_of(0.002), SIZE)
    words = '5 boards are too few to compare halves, so'
    assert words in result.warnings[0] and 'capture 6 or more' in result.warnings[0]
    entry = json.loads(json.dumps(result.to_mapping(), allow_nan=False))['split_half']
    assert entry['ratio'] is None and entry['factor'] == 1 and words in entry['reason']
    assert result.estimate.inflation == 1
    assert words in parameters(result) and words in summary(result)


def test_images_without_a_common_middle_are_not_compared(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(split_halves, 'field_of_view', lambda *_: np.zeros((0, 3)))
    halves = compare_halves(solved(0.005).estimate)
    assert halves.factor == 1 and 'show nothing in common' in halves.warning


def test_halves_of_a_real_chessboard_set_contradict_each_other() -> None:
    """Its boards were held by hand before webcams; OpenCV and mrcal see nothing of that."""
    table = read_points(CHESSBOARD)
    found = estimated(list(table.captures), table.target, table.least_size)
    flat = estimated(
        list(table.captures), replace(table.target, warp_sigma_m=0.0), table.least_size
    )
    for one, ratio in ((found, 2.88), (flat, 2.42)):
        halves = compare_halves(one)
        assert halves.by_lot
        assert halves.by_lot.ratio == pytest.approx(ratio, abs=0.1)
