# SPDX-License-Identifier: Apache-2.0
"""Captures on disk: numbered, resumed, dropped without loss."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from binocular_recon.calibration.rods import Capture
from binocular_recon.errors import CalibrationError, FileError
from binocular_recon.io.capture_store import CaptureStore
from binocular_recon.io.image_files import read_image_file
from binocular_recon.simulation.rods import paper_board

BOARD = paper_board()
RNG = np.random.default_rng(5)
IMAGE = RNG.integers(0, 255, (40, 60), np.uint8)


def test_boards_are_numbered_and_a_new_store_goes_on(tmp_path: Path) -> None:
    store = CaptureStore(tmp_path / 'deep' / 'captures', BOARD)
    assert [store.add(IMAGE, IMAGE[::-1]) for _ in range(2)] == ['001', '002']
    again = CaptureStore(store.folder, BOARD)
    assert again.names == ['001', '002']
    assert again.add(IMAGE, IMAGE) == '003'
    np.testing.assert_array_equal(read_image_file(store.folder / 'left_001.png'), IMAGE)
    np.testing.assert_array_equal(read_image_file(store.folder / 'right_001.png'), IMAGE[::-1])


def test_board_half_written_before_a_crash_is_left_alone(tmp_path: Path) -> None:
    store = CaptureStore(tmp_path, BOARD)
    store.add(IMAGE, IMAGE)
    (tmp_path / 'left_001.png').unlink()
    assert store.add(IMAGE, IMAGE) == '002'
    assert (tmp_path / 'right_001.png').exists()


def test_dropped_boards_are_kept_aside(tmp_path: Path) -> None:
    store = CaptureStore(tmp_path, BOARD)
    for _ in range(3):
        store.add(IMAGE, IMAGE)
    store.drop(['003'])
    store.drop(['001', '002'])
    assert store.names == []
    assert len(list(tmp_path.glob('dropped/*/left_*.png'))) == 3
    assert store.add(IMAGE, IMAGE) == '001'


def test_marks_of_a_board_just_captured_are_not_found_again(tmp_path: Path) -> None:
    store = CaptureStore(tmp_path, BOARD)
    name = store.add(IMAGE, IMAGE)
    marks = RNG.uniform(0, 40, (BOARD.count, BOARD.marks_per_rod, 2))
    store.keep(Capture(name, marks, marks), (60, 40))
    found = store.captures()
    np.testing.assert_array_equal(found.captures[0].left_px, marks)
    assert found.image_size == (60, 40)


def test_no_board_is_said(tmp_path: Path) -> None:
    with pytest.raises(CalibrationError, match='no board has been captured yet'):
        CaptureStore(tmp_path, BOARD).captures()


def test_folder_that_cannot_be_made_is_said(tmp_path: Path) -> None:
    (tmp_path / 'file').write_text('')
    with pytest.raises(FileError, match='cannot be made'):
        CaptureStore(tmp_path / 'file' / 'captures', BOARD)
