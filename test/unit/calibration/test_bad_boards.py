# SPDX-License-Identifier: Apache-2.0
"""Every kind of bad input of a calibration: what is refused, left out or pointed out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from binocular_recon.calibration.screening import Rejected
from binocular_recon.calibration.solve import calibrate
from binocular_recon.calibration.target.capture import Capture
from binocular_recon.calibration.target.rods import RodBoard
from binocular_recon.calibration.target.target import Target
from binocular_recon.errors import CalibrationError
from binocular_recon.evaluation.calibration.self_check import (
    depth_errors_m,
)
from test.calibration_tools import (
    SIZE,
    board_of,
    captures_at,
    captures_of,
    solved,
    spoilt,
    truth,
    wrong_board,
)

pytestmark = pytest.mark.long


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
