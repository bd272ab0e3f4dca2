# SPDX-License-Identifier: Apache-2.0
"""What a capture is checked for."""

from __future__ import annotations

import numpy as np
import pytest

from binocular_recon.calibration.target.capture import Capture
from binocular_recon.errors import CalibrationError
from binocular_recon.nodes.calibration.newest_pair import ImagePair
from binocular_recon.nodes.calibration.steps import (
    check_still,
    describe_size_change,
    detect_pair,
)
from binocular_recon.simulation.capture import CaptureOptions, simulate_capture
from binocular_recon.simulation.rig import survey_rig
from binocular_recon.simulation.rods import paper_board

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
    assert describe_size_change((960, 600), (960, 600)) == ''
    assert describe_size_change((480, 300), (960, 600)) == (
        'the images are 480x300 px, those of earlier boards 960x600 px; restore the camera'
        ' settings, or reset and start again'
    )
