# SPDX-License-Identifier: Apache-2.0
"""Edges that a tone curve shifts are told from marks at wrong heights."""

from __future__ import annotations

import numpy as np
import pytest

from binocular_recon.calibration.adjustment.tone_curve import ToneCurve
from binocular_recon.calibration.detection.detect import detect_rods
from binocular_recon.calibration.solve import calibrate
from binocular_recon.calibration.target.capture import Capture
from binocular_recon.evaluation.calibration.self_check import depth_errors_m
from binocular_recon.simulation.rods import paper_board
from test.calibration_tools import (
    SIZE,
    board_of,
    captures_at,
    captures_of,
    solved,
    truth,
    wrong_board,
)
from test.rod_images import image_of

pytestmark = pytest.mark.long

TURNS = [-0.6, -0.3, 0.0, 0.2, 0.4, 0.7, -0.5]


def shifted(captures: list[Capture], left_px: float, right_px: float) -> list[Capture]:
    """Return captures with every other mark shifted up its rod, the others down."""
    changed = []
    for capture in captures:
        sides = []
        for marks, shift in ((capture.left_px, left_px), (capture.right_px, right_px)):
            up = marks[:, -1] - marks[:, 0]
            up /= np.linalg.norm(up, axis=1, keepdims=True)
            signs = np.where(np.arange(marks.shape[1]) % 2, -1.0, 1.0)
            sides.append(marks + shift * signs[:, None] * up[:, None])
        changed.append(Capture(capture.name, *sides))
    return changed


@pytest.mark.parametrize(('seed', 'left', 'right'), [(0, 0.32, 0.32), (1, -0.16, -0.2)])
def test_a_tone_curve_is_estimated_and_taken_out(seed: int, left: float, right: float) -> None:
    captures = captures_of(seed=seed)
    result = calibrate(shifted(captures, left, right), board_of(0.005), SIZE)
    (warning,) = result.warnings
    assert 'the images have a tone curve (gamma)' in warning and 'set gamma to 1' in warning
    found = [float(part.split()[-1]) for part in warning.split(' px in the ')[:2]]
    assert found == pytest.approx([abs(left), abs(right)], abs=0.03)
    clean = solved(0.005) if seed == 0 else calibrate(captures, board_of(0.005), SIZE)
    errors = [
        np.sqrt(np.mean(depth_errors_m(one.calibration, truth())[1] ** 2))
        for one in (result, clean)
    ]
    assert errors[0] == pytest.approx(errors[1], rel=0.02)
    assert result.mark_sigma_px == pytest.approx(clean.mark_sigma_px, rel=0.02)


def test_bands_that_are_too_long_are_not_taken_for_a_tone_curve() -> None:
    """All dark bands are 4 mm longer than stated: the same in metres at every distance."""
    marks = [0.302, 0.598, 0.902, 1.198, 1.502, 1.798]
    result = calibrate(captures_of(), wrong_board(marks=marks), SIZE)
    assert not any('tone curve' in warning for warning in result.warnings)
    assert sum('measure it and correct rods.yaml' in warning for warning in result.warnings) >= 4


def test_boards_at_one_distance_leave_both_causes_open() -> None:
    board = board_of(0.005)
    captures = captures_at(TURNS, [9.0, 9.5, 10, 10.3, 9, 9.6, 10.1], board)
    warnings = calibrate(shifted(captures, 0.3, 0.3), board, SIZE).warnings
    (tone,) = (warning for warning in warnings if 'shifted oppositely' in warning)
    assert 'or all dark bands differ in length from the light ones' in tone
    assert 'before you correct rods.yaml' in tone
    assert not any('sits about' in warning for warning in warnings)


def test_without_a_shift_nothing_is_said() -> None:
    assert ToneCurve(np.zeros(2)).warning == '' and solved(0.005).warnings == ()


def test_gamma_shifts_edges_alike_at_all_distances() -> None:
    """The model: what a tone curve does to images of rods."""
    shifts = []
    for depth in (6.0, 12.0):
        image, placed = image_of(paper_board(), (0.0, 1.2, depth))
        encoded = np.rint(255 * (image / 255) ** (1 / 2.2)).astype(np.uint8)
        moved = (
            detect_rods(encoded, placed.board).marks_px - detect_rods(image, placed.board).marks_px
        )
        signs = np.where(np.arange(6) % 2, -1.0, 1.0)
        upward = -moved[..., 1] * signs
        assert np.nanstd(upward) < 0.1 and abs(np.nanmean(moved[..., 0])) < 0.1
        shifts.append(float(np.nanmean(upward)))
    # dark below the first mark: gamma lightens the middle of the edge, which moves down
    assert shifts[0] < -0.1 and shifts[1] == pytest.approx(shifts[0], abs=0.05)
