# SPDX-License-Identifier: Apache-2.0
"""What a capture is checked for."""

from __future__ import annotations

import numpy as np
import pytest

from binocular_recon.calibration.solve import calibrate
from binocular_recon.calibration.target.capture import Capture
from binocular_recon.errors import CalibrationError
from binocular_recon.inputs.common_size import CommonSize
from binocular_recon.nodes.calibration.newest_pair import ImagePair
from binocular_recon.nodes.calibration.steps import (
    check_still,
    describe_next_step,
    describe_result,
    describe_size_change,
    detect_pair,
)
from binocular_recon.simulation.capture import CaptureOptions, simulate_capture
from binocular_recon.simulation.rig import survey_rig
from binocular_recon.simulation.rods import paper_board
from test.calibration_tools import SIZE, captures_of, solved, wrong_board

pytestmark = pytest.mark.long

BOARD = paper_board()


def test_rods_count_as_still_only_if_they_are_found_again_in_the_same_place() -> None:
    options = CaptureOptions(depth_m=(3.0, 6.0))
    shown = simulate_capture(BOARD, survey_rig(scale=0.5), np.random.default_rng(1), options)
    pair = ImagePair(shown.left, shown.right, 10.0)
    left, right = detect_pair(pair, BOARD)
    capture = Capture('new', left.marks_px, right.marks_px)
    later = ImagePair(shown.left, shown.right, 10.5)
    assert check_still(pair, capture, later, BOARD) == ''
    assert 'no further pair arrived' in check_still(pair, capture, None, BOARD)
    empty = np.full_like(shown.left, 120)
    with pytest.raises(CalibrationError, match=r'were not found again 0\.50 s later; wait until'):
        check_still(pair, capture, ImagePair(empty, empty, 10.5), BOARD)
    moved_left, moved_right = (np.roll(image, 3, axis=1) for image in (shown.left, shown.right))
    with pytest.raises(CalibrationError, match=r'moved by 3\.0 px within 0\.25 s'):
        check_still(pair, capture, ImagePair(moved_left, moved_right, 10.25), BOARD)


def test_images_must_keep_their_size() -> None:
    alike, small = CommonSize((960, 600), (960, 600)), CommonSize((960, 600), (480, 300))
    assert describe_size_change(alike, alike) == ''
    assert describe_size_change(small, alike) == (
        'the images are 960x600 and 480x300 px, those of earlier boards 960x600 px; restore the'
        ' camera settings, or reset and start again'
    )


def test_the_answer_of_calibrate_carries_every_warning_and_only_then_doubts_it() -> None:
    board = wrong_board(marks=[0.3, 0.6, 0.904, 1.2, 1.5, 1.8])
    poor = calibrate(captures_of(boards=4, seed=3), board, SIZE)
    answer = describe_result(poor)
    for fault in (
        'warning: 4 boards were used; depth is better known with 11 or more',
        'warning: one standard deviation of depth at the boards (12.',
        'capture more boards, turned by 20 to 50 degrees',
        'warning: mark 3 sits about -',
    ):
        assert fault in answer
    assert answer.count('warning: ') == len(poor.warnings)
    assert describe_next_step(poor) == (
        f'settle the {len(poor.warnings)} warnings and calibrate again, or call save to keep it'
        ' as it is'
    )
    good = solved(0.005)
    assert good.warnings == () and 'warning' not in describe_result(good)
    assert describe_next_step(good) == 'call save to keep it'
