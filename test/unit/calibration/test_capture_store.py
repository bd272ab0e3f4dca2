# SPDX-License-Identifier: Apache-2.0
"""Captures on disk: numbered, resumed, dropped without loss."""

from __future__ import annotations

import threading
from pathlib import Path

import numpy as np
import pytest

from binocular_recon.calibration.session import capture_store, captures
from binocular_recon.calibration.session.capture_store import CaptureStore
from binocular_recon.calibration.session.captures import BoardFiles, BoardReading
from binocular_recon.calibration.target.capture import Capture
from binocular_recon.calibration.target.rods import RodBoard
from binocular_recon.errors import CalibrationError, FileError
from binocular_recon.inputs.common_size import CommonSize
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


def test_board_half_written_before_a_crash_does_not_count(tmp_path: Path) -> None:
    """A power cut came between the two images: nobody was told of the board."""
    store = CaptureStore(tmp_path, BOARD)
    store.add(IMAGE, IMAGE)
    (tmp_path / 'left_001.png').unlink()
    again = CaptureStore(tmp_path, BOARD)
    assert again.names == []
    assert again.usable() is None
    with pytest.raises(CalibrationError, match='no board has been captured yet'):
        again.captures()
    assert again.add(IMAGE, IMAGE) == '002'
    assert (tmp_path / 'right_001.png').exists()
    marks = RNG.uniform(0, 40, (BOARD.count, BOARD.marks_per_rod, 2))
    again.keep(Capture('002', marks, marks), CommonSize((60, 40), (60, 40)))
    found = again.captures()
    assert [capture.name for capture in found.captures] == ['002']
    assert [(one.name, one.reason) for one in found.rejected] == [
        ('001', 'there is no left image')
    ]
    folder = again.drop_all()
    assert folder and sorted(path.name for path in folder.iterdir()) == [
        'left_002.png',
        'right_001.png',
        'right_002.png',
    ]
    assert again.drop_all() is None


def test_dropped_boards_are_kept_aside_and_their_numbers_are_theirs(tmp_path: Path) -> None:
    """A saved calibration names boards: another board of that name would be shown in its place."""
    store = CaptureStore(tmp_path, BOARD)
    for _ in range(3):
        store.add(IMAGE, IMAGE)
    assert store.drop(['003']).parent == tmp_path / 'dropped'
    store.drop(['001', '002'])
    assert store.names == []
    assert len(list(tmp_path.glob('dropped/*/left_*.png'))) == 3
    assert store.add(IMAGE, IMAGE) == '004'


def test_what_was_dropped_stays_so_after_a_power_cut(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = CaptureStore(tmp_path, BOARD)
    store.add(IMAGE, IMAGE)
    flushed: list[Path] = []
    monkeypatch.setattr(capture_store, 'flush', flushed.append)
    target = store.drop(['001'])
    assert set(flushed) == {target, target.parent, tmp_path}


def test_stored_boards_are_read_on_all_cores_once_until_stopped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for _ in range(2):
        CaptureStore(tmp_path, BOARD).add(IMAGE, IMAGE)
    marks = RNG.uniform(0, 40, (BOARD.count, BOARD.marks_per_rod, 2))
    read: list[str] = []
    together = threading.Barrier(2)

    def read_board(files: BoardFiles, _: RodBoard) -> BoardReading:
        if not files.problem:
            together.wait(10)
        read.append(files.name)
        return BoardReading(
            files, Capture(files.name, marks, marks), CommonSize((60, 40), (60, 40)), ''
        )

    monkeypatch.setattr(captures, 'read_board', read_board)
    monkeypatch.setattr(captures, 'thread_count', lambda: 2)
    stopped = CaptureStore(tmp_path, BOARD, stopped=lambda: True)
    with pytest.raises(CalibrationError, match='was stopped'):
        stopped.usable()
    read.clear()
    store = CaptureStore(tmp_path, BOARD)
    assert store.usable() and store.usable() and store.captures()
    assert sorted(read) == ['001', '002']
    # an image that was missing and comes, is read
    (tmp_path / 'left_007.png').write_bytes(b'')
    store.usable()
    monkeypatch.setattr(together, 'wait', lambda _: None)
    (tmp_path / 'right_007.png').write_bytes(b'')
    store.usable()
    assert read[2:] == ['007', '007']


def test_marks_of_a_board_just_captured_are_not_found_again(tmp_path: Path) -> None:
    store = CaptureStore(tmp_path, BOARD)
    name = store.add(IMAGE, IMAGE)
    marks = RNG.uniform(0, 40, (BOARD.count, BOARD.marks_per_rod, 2))
    store.keep(Capture(name, marks, marks), CommonSize((60, 40), (60, 40)))
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
