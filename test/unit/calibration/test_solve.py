# SPDX-License-Identifier: Apache-2.0
"""A whole calibration from marks: the known result, and every kind of bad input."""

from __future__ import annotations

import json
from collections.abc import Callable
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
from binocular_recon.calibration.screening import Rejected, observations
from binocular_recon.calibration.session.points_csv import read_points
from binocular_recon.calibration.solve import calibrate
from binocular_recon.calibration.target.capture import Capture
from binocular_recon.calibration.target.rods import RodBoard
from binocular_recon.calibration.target.target import Target
from binocular_recon.errors import CalibrationError
from binocular_recon.evaluation.calibration.self_check import (
    check_rows,
    depth_errors_m,
    simulated_captures,
)
from binocular_recon.simulation.rig import survey_rig
from binocular_recon.simulation.rods import PlacedBoard, draw_board, place_board
from test.calibration_tools import CHESSBOARD, SIZE, board_of, captures_of, solved, truth


def spoilt(change: Callable[[list[Capture]], None], seed: int = 2) -> list[Capture]:
    captures = captures_of(seed=seed)
    change(captures)
    return captures


def captures_at(turns_rad: list[float], depths_m: list[float], board: RodBoard) -> list[Capture]:
    """Simulate boards that face the cameras up to a turn about their upright."""
    rng = np.random.default_rng(0)
    rig = survey_rig()
    captures = []
    for index, (turn, depth) in enumerate(zip(turns_rad, depths_m, strict=True)):
        middle = np.array([0.1 * depth * (index % 3 - 1), 1.2, depth])
        placed: PlacedBoard = place_board(board, np.array([0, turn, 0]), middle, rng)
        pixels = [placed.marks_px(view) for view in rig.views()]
        noisy = [px + rng.normal(0, 0.2, px.shape) for px in pixels]
        captures.append(Capture(f'{index}', *noisy))
    return captures


def test_chessboard_gives_the_known_result() -> None:
    table = read_points(CHESSBOARD)
    result = calibrate(table.captures, table.target, table.least_size)
    assert result.rms_px == pytest.approx(0.215, rel=0.02)
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
    result, rig = solved(0.005), truth()
    for name, value, true in (
        ('fx_left_px', result.calibration.K_left[0, 0], rig.K_left[0, 0]),
        ('fy_right_px', result.calibration.K_right[1, 1], rig.K_right[1, 1]),
        ('cx_left_px', result.calibration.K_left[0, 2], rig.K_left[0, 2]),
        ('k1_right', result.calibration.D_right[0], rig.D_right[0]),
        ('T_z_m', result.calibration.T[2], rig.T[2]),
        ('baseline_m', result.calibration.baseline_m, rig.baseline_m),
    ):
        assert abs(value - true) < 3.5 * result.sigma[name], name


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


def test_too_few_boards_says_how_many_and_why() -> None:
    captures = captures_of(boards=3)
    captures[1] = replace(captures[1], left_px=np.full((5, 6, 2), np.nan))
    lost = [Rejected('99', 'left_99.png cannot be read')]
    with pytest.raises(
        CalibrationError, match=r'2 of 4 boards can be used .* capture 1 more'
    ) as e:
        calibrate(captures, board_of(0.005), SIZE, rejected=lost)
    assert 'left_99.png cannot be read' in str(e.value)
    assert '02: 0 of 30 marks found in both images' in str(e.value)


def test_rods_that_are_not_there_are_named() -> None:
    more = RodBoard.from_mapping(
        {**board_of(0.005).to_mapping(), 'rods': [{'x': 0.6 * i} for i in range(7)]}
    )
    missing = ((0, 2), (0, 0), (0, 0))
    captures = [
        Capture(
            c.name,
            *(np.pad(px, missing, constant_values=np.nan) for px in (c.left_px, c.right_px)),
        )
        for c in captures_of()
    ]
    with pytest.raises(CalibrationError, match='describes 7 rods, but rod 6, 7 was found on none'):
        calibrate(captures, more, SIZE)


def test_boards_of_one_rod_are_named() -> None:
    captures = captures_of(boards=4)
    for index in range(2):
        left = captures[index].left_px.copy()
        left[1:] = np.nan
        captures[index] = replace(captures[index], left_px=left)
    with pytest.raises(CalibrationError, match='at least two rods are needed'):
        calibrate(captures, board_of(0.005), SIZE)


def test_parallel_boards_are_refused() -> None:
    depths = list(np.linspace(6, 15, 8))
    captures = captures_at([0.3] * 8, depths, board_of(0.005))
    with pytest.raises(CalibrationError, match=r'parallel .* turn boards by 20 to 50 degrees'):
        calibrate(captures, board_of(0.005), SIZE)


def test_boards_at_one_distance_are_refused() -> None:
    captures = captures_at([-0.6, -0.3, 0.0, 0.2, 0.4, 0.7], [9.0] * 6, board_of(0.005))
    with pytest.raises(CalibrationError, match=r'stand at one distance .* spread them'):
        calibrate(captures, board_of(0.005), SIZE)


def test_swapped_images_are_refused() -> None:
    captures = [Capture(c.name, c.right_px, c.left_px) for c in captures_of()]
    with pytest.raises(CalibrationError, match='left and right are swapped'):
        calibrate(captures, board_of(0.005), SIZE)


@pytest.mark.parametrize(
    'kind', ['swapped', 'blurred', 'moved', 'exchanged rods', 'next rods', 'repeated']
)
def test_a_bad_board_is_named_left_out_and_the_rest_used(kind: str) -> None:
    rng = np.random.default_rng(3)

    def change(captures: list[Capture]) -> None:
        bad = captures[3]
        left, right = bad.left_px.copy(), bad.right_px.copy()
        if kind == 'swapped':
            left, right = right, left
        elif kind == 'blurred':
            left += rng.normal(0, 1.5, left.shape)
            right += rng.normal(0, 1.5, right.shape)
        elif kind == 'moved':  # between the two images, by 5 cm and a little turn
            right[:, :, 0] += 6 + 2 * np.arange(5)[:, None]
            right[:, :, 1] += 1.5
        elif kind == 'exchanged rods':
            left[[1, 2]], right[[1, 2]] = left[[2, 1]], right[[2, 1]]
        elif kind == 'next rods':  # one image alone does not tell
            right[1:], right[0] = right[:-1].copy(), np.nan
        else:
            left = captures[2].left_px + rng.normal(0, 0.2, left.shape)
            right = captures[2].right_px + rng.normal(0, 0.2, right.shape)
        captures[3] = replace(bad, left_px=left, right_px=right)

    result = calibrate(spoilt(change), board_of(0.005), SIZE)
    assert [board.name for board in result.rejected] == ['04']
    expected = {
        'swapped': 'its left and right image are exchanged',
        'next rods': 'do not agree on where the rods stand',
        'blurred': 'blurred',
        'moved': 'the rods were moved in between',
        'exchanged rods': 'a rod or a mark was taken for another one',
        'repeated': 'it repeats board 03',
    }[kind]
    assert expected in result.rejected[0].reason
    assert len(result.names) == 10
    assert any('10 boards were used' in warning for warning in result.warnings)
    errors = depth_errors_m(result.calibration, truth())[1]
    assert np.sqrt(np.mean(errors**2)) < 3 * result.depth_sigma_m(15, 0.0)


def test_a_board_with_too_few_good_marks_is_named() -> None:
    """Six marks, of which three are off in one image: less than Zhang's method needs."""

    def change(captures: list[Capture]) -> None:
        weak = np.zeros((5, 6, 1), np.bool_)
        weak[np.ix_([0, 4], [0, 2, 5])] = True
        left, right = (
            np.where(weak, px, np.nan) for px in (captures[3].left_px, captures[3].right_px)
        )
        for rod, mark, off in ((0, 0, 3.0), (0, 2, -3.0), (4, 5, 3.0)):
            left[rod, mark] += (off, 2.0)
        captures[3] = Capture('weak', left, right)

    result = calibrate(spoilt(change), board_of(0.005), SIZE)
    (left_out,) = result.rejected
    assert left_out.name == 'weak' and 'marks of one image fit' in left_out.reason
    assert len(result.names) == 10


def test_an_unsettled_adjustment_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
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


def wrong_board(**changes: object) -> RodBoard:
    return RodBoard.from_mapping({**board_of(0.005).to_mapping(), **changes})


def test_rods_that_contradict_the_images_are_refused() -> None:
    captures = captures_of()
    for board, message in (
        (
            wrong_board(rods=[{'x': x} for x in (0.0, 0.6, 1.3, 1.8, 2.4)]),
            'rod 3 stands .* mm off its x in most boards .* measure the rods',
        ),
        (wrong_board(rods=[{'x': 0.5 * i} for i in range(5)]), 'contradicts the images'),
        (
            wrong_board(marks=[0.3, 0.6, 0.93, 1.2, 1.5, 1.8]),
            'mark 3 of rod . is not where it is said to be',
        ),
        (
            wrong_board(rods=[{'x': x} for x in (0.0, 0.3, 1.5, 1.8, 2.4)]),
            'do not lie as described .* check the positions of the rods',
        ),
    ):
        with pytest.raises(CalibrationError, match=message):
            calibrate(captures, board, SIZE)


def test_a_mark_at_a_slightly_wrong_height_is_pointed_out() -> None:
    result = calibrate(captures_of(), wrong_board(marks=[0.3, 0.6, 0.904, 1.2, 1.5, 1.8]), SIZE)
    assert any('mark 3 sits about -' in warning for warning in result.warnings)
    assert not any('mark' in warning for warning in solved(0.005).warnings)


def test_rods_and_marks_that_are_never_found_are_named() -> None:
    """Detection leaves out a mark at a wrong height and a rod at a wrong place."""

    def lose(captures: list[Capture]) -> None:
        for capture in captures:
            for pixels in (capture.left_px, capture.right_px):
                pixels[:, 1] = np.nan
                pixels[3 if capture is not captures[0] else 0] = np.nan

    result = calibrate(spoilt(lose), board_of(0.005), SIZE)
    named = [warning for warning in result.warnings if 'was found on' in warning]
    assert named == [
        'rod 4 was found on 1 of 11 boards; check its position in rods.yaml',
        'mark 2 was found on 0 of 11 boards; check its height in rods.yaml',
    ]


def test_rods_stated_exact_that_are_not_are_pointed_out() -> None:
    result = calibrate(captures_of(0.005), board_of(0.0), SIZE)
    assert any('state a placement_sigma' in warning for warning in result.warnings)


def test_marks_that_no_calibration_fits_are_refused() -> None:
    def change(captures: list[Capture]) -> None:
        rng = np.random.default_rng(0)
        for index, capture in enumerate(captures):
            shaken = capture.right_px + rng.normal(0, 9.0, capture.right_px.shape)
            captures[index] = replace(capture, right_px=shaken)

    with pytest.raises(CalibrationError, match='miss the best calibration by'):
        calibrate(spoilt(change), board_of(0.005), SIZE)


def test_boards_that_leave_depth_open_are_refused() -> None:
    turns = [0.0, 0.18, -0.18, 0.1, -0.1, 0.2]
    captures = captures_at(turns, [13, 13.5, 14, 14.5, 15, 15.5], board_of(0.02))
    with pytest.raises(CalibrationError, match='do not determine depth'):
        calibrate(captures, board_of(0.02), SIZE)


def test_marks_of_another_board_are_refused() -> None:
    captures = captures_of(boards=3)
    target = Target.from_points(np.zeros((7, 3)))
    with pytest.raises(CalibrationError, match=r'have shape \(5, 6, 2\), expected \(7, 1, 2\)'):
        calibrate(captures, target, SIZE)
    with pytest.raises(CalibrationError, match='lie outside its 640x480 px'):
        calibrate(captures, board_of(0.005), (640, 480))


def test_squinting_rig_keeps_its_rows_and_depth() -> None:
    result = solved(0.005)
    rig = metric_rig(result.calibration)
    assert rig.baseline_m == pytest.approx(result.calibration.baseline_m)
