# SPDX-License-Identifier: Apache-2.0
"""Rod detection on ray-cast images: what is left out and what is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from binocular_recon.calibration.detection import detect
from binocular_recon.calibration.detection._board_layout import Layout
from binocular_recon.calibration.detection._guided_search import stray_rods
from binocular_recon.calibration.detection._identity import scattered
from binocular_recon.calibration.detection.detect import _settle, detect_rods
from binocular_recon.calibration.target.board_plane import slant
from binocular_recon.errors import ImageError
from binocular_recon.io.image_files import read_image_file
from binocular_recon.simulation.capture import CaptureOptions, simulate_capture
from binocular_recon.simulation.rods import paper_board, place_board
from test.lookalikes import LOOKALIKES, checks, lattice, lookalike, photographed
from test.rod_images import LEFT, RIG, board_of, image_of

pytestmark = pytest.mark.long


def test_hidden_marks_are_not_invented() -> None:
    """A plate with edges right on the spacing hides two marks of a rod; the rest is found."""
    image, placed = image_of(paper_board(), (0.0, 1.2, 8.0))
    truth = placed.marks_px(LEFT)
    x0, y0 = (truth[2, 3] - (25, 8)).astype(int)
    x1, y1 = (truth[2, 2] + (25, 12)).astype(int)
    image[y0:y1, x0:x1] = 35
    detection = detect_rods(image, placed.board)
    hidden = np.zeros((5, 6), np.bool_)
    hidden[2, 2:4] = True
    np.testing.assert_array_equal(detection.found, ~hidden)
    assert np.nanmax(np.abs(detection.marks_px - truth)) < 0.3
    assert detection.messages == (
        'rod 3: marks 3, 4 hidden; people or things before it?',
        '28 of 30 marks',
    )


@pytest.mark.parametrize('marks', [0, 1])
def test_missing_rod_is_named(marks: int) -> None:
    """A lone mark has nothing that vouches for it."""
    image, placed = image_of(paper_board(), (0.0, 1.2, 8.0))
    x, y = placed.marks_px(LEFT)[2, -1].astype(int)
    image[marks * (y + 15) :, x - 15 : x + 16] = 110
    detection = detect_rods(image, placed.board)
    assert detection.messages == (
        'rod 3 of 5 not found; people or things before it?',
        '24 of 30 marks',
    )
    assert np.nanmax(np.abs(detection.marks_px - placed.marks_px(LEFT))) < 0.3


def test_rods_cut_by_the_image_border_keep_their_identity() -> None:
    """Two of five rods are out of the image to the left."""
    image, placed = image_of(paper_board(), (-2.5, 1.2, 8.0))
    truth = placed.marks_px(LEFT)
    detection = detect_rods(image, placed.board)
    seen = (truth[..., 0] > 3) & (truth[..., 0] < LEFT.camera.width - 4)
    assert 6 <= seen.sum() <= 24
    np.testing.assert_array_equal(detection.found, seen)
    assert np.nanmax(np.abs(detection.marks_px - truth)) < 0.3


def test_what_cannot_be_told_is_refused() -> None:
    """An end rod is hidden and there is room for one at either end: two readings."""
    image, placed = image_of(paper_board(), (0.0, 1.2, 8.0))
    x = placed.marks_px(LEFT)[0, :, 0].mean()
    image[:, int(x) - 15 : int(x) + 16] = 110
    detection = detect_rods(image, placed.board)
    assert not detection.found.any()
    assert 'too little of the board is in view' in detection.messages[0]


def test_three_rods_side_by_side_are_not_every_other_rod() -> None:
    """Two rods are partly hidden; the others look like 1, 3 and 5 of a board turned more."""
    board = paper_board()
    image, placed = image_of(board, (0.0, 1.2, 8.0), (0.0, 0.9, 0.0))
    truth = placed.marks_px(LEFT)
    x0, y0 = truth[:2, 2].min(0).astype(int) - 14
    x1, y1 = truth[:2, 1].max(0).astype(int) + 14
    image[y0:y1, x0:x1] = 70
    mistaken = np.full_like(truth, np.nan)
    mistaken[::2] = truth[2:]
    assert slant(board, mistaken, LEFT.camera.size) < 0.3
    layout = Layout(mistaken, 10.0, frozenset())
    measured = _settle(image.astype(np.float32).mean(2), board, layout)
    assert measured is not None
    detection = measured.detection
    assert detection.found[2:].all() and detection.found.sum() == 26
    assert np.nanmax(np.abs(detection.marks_px - truth)) < 0.3


def test_chessboard_is_no_board() -> None:
    """It looks more like five rods than the rods do, until its edges are measured."""
    image, placed = image_of(paper_board(), (0.2, 1.2, 8.0))
    rows, columns = np.mgrid[:300, :210] // 30
    image[100:400, 100:310] = np.where((rows + columns) % 2, 20, 235)[..., None]
    detection = detect_rods(image, placed.board)
    assert detection.found.all()
    assert np.abs(detection.marks_px - placed.marks_px(LEFT)).max() < 0.3


def test_feet_on_snow_are_no_marks() -> None:
    """With the tops hidden as well, feet and marks would fit the board shifted by two."""
    image, placed = image_of(paper_board(), (0.0, 1.2, 8.0), background=225.0)
    truth = placed.marks_px(LEFT)
    for top in (0, 4):
        hidden = image.copy()
        x0, y0 = truth[:, top:].min((0, 1)).astype(int) - 20
        x1, y1 = truth[:, top:].max((0, 1)).astype(int) + 20
        if top:
            hidden[max(0, y0 - 60) : y1, x0:x1] = 90
        detection = detect_rods(hidden, placed.board)
        assert detection.found.sum() == (20 if top else 30)
        assert np.nanmax(np.abs(detection.marks_px - truth)) < 0.3


def test_rods_do_not_stand_on_steps() -> None:
    """Two rods, one at marks 3 to 5 instead of 1 to 3: as in an image of stairs."""
    board = board_of([0.0, 1.2], [0.3, 0.6, 0.9, 1.2, 1.5, 1.8])
    placed = place_board(
        board, np.array([0.0, 0.7, 0.1]), np.array([0.5, 1.2, 12.0]), np.random.default_rng(0)
    )
    marks = placed.marks_px(LEFT)
    assert slant(board, marks, LEFT.camera.size) < 0.1
    marks[0, 2:] = marks[0, :4]
    marks[0, :2] = np.nan
    assert slant(board, marks, LEFT.camera.size) > 0.3
    assert slant(board, np.full_like(marks, np.nan), LEFT.camera.size) == 0


def test_no_rods_no_marks() -> None:
    rng = np.random.default_rng(0)
    for image in (
        np.zeros((300, 400), np.uint8),
        np.full((300, 400, 3), 255, np.uint8),
        rng.integers(0, 255, (600, 800), np.uint8),
    ):
        detection = detect_rods(image, paper_board())
        assert not detection.found.any()
        assert detection.messages


def test_wrong_rods_file_gives_no_wrong_marks() -> None:
    """Seven rods of eight marks are sought where five of six stand."""
    image, _ = image_of(paper_board(), (0.0, 1.2, 8.0))
    other = board_of([0.35 * i for i in range(7)], [0.3 + 0.17 * i for i in range(8)])
    assert detect_rods(image, other).found.sum() < 12


def test_clutter_alone_has_no_board() -> None:
    """Decoys: ladders, barriers and banded posts with other spacings."""
    board = paper_board()
    options = CaptureOptions(kinds=('barriers',))
    capture = simulate_capture(board, RIG, np.random.default_rng(2), options)
    # paint the rods over, rows above and below stay
    image = capture.left.copy()
    x0, y0 = np.nanmin(capture.left_px, (0, 1)).astype(int) - 60
    x1, y1 = np.nanmax(capture.left_px, (0, 1)).astype(int) + 60
    image[max(0, y0) : y1, max(0, x0) : x1] = 128
    assert not detect_rods(image, board).found.any()


@pytest.mark.parametrize('kind', LOOKALIKES)
def test_what_only_looks_like_rods_has_no_board(kind: str) -> None:
    """Forests, facades and stripes, in which upright edges and bands abound."""
    detection = detect_rods(lookalike(kind, (320, 200), 1), paper_board())
    assert not detection.found.any()
    assert detection.messages


@pytest.mark.parametrize(
    ('rods', 'marks', 'distance_m'), [(7, 6, 8.0), (5, 10, 10.0)], ids=['row', 'rods']
)
def test_a_pattern_that_goes_on_is_no_board(rods: int, marks: int, distance_m: float) -> None:
    """More rods, or more marks, than `rods.yaml` lists: which of them these are nothing tells."""
    standing = board_of([0.6 * i for i in range(rods)], [0.3 * i for i in range(1, marks + 1)])
    image, placed = image_of(standing, (0.0, 1.2, distance_m))
    detection = detect_rods(image, paper_board())
    assert not detection.found.any()
    assert (
        'or beyond its ends, as facades and lattices do; if these are the' in detection.messages[0]
    )
    whole = detect_rods(image, standing)
    assert np.nanmax(np.abs(whole.marks_px - placed.marks_px(LEFT))) < 0.3


def test_panels_of_a_facade_are_no_board() -> None:
    """Twenty marks fit the board in these, and the pattern goes on to the left."""
    rng = np.random.default_rng([0, 99, 0])
    image = photographed(checks((400, 260), rng), rng)
    assert not detect_rods(image, paper_board()).found.any()


def test_a_lattice_is_no_board() -> None:
    """Bars in two directions: three columns of gaps fit three rods, and so do all others."""
    rng = np.random.default_rng([200, 0, 77])
    image = photographed(lattice((400, 260), rng), rng)
    board = board_of([0.0, 1.0, 2.0], [0.3 * i for i in range(1, 7)])
    detection = detect_rods(image, board)
    assert not detection.found.any()
    assert 'goes on between its rods or beyond its ends' in detection.messages[0]


def test_one_thing_more_that_looks_like_a_rod_does_no_harm() -> None:
    """A spare rod between two others is not listed; a second one would make it a pattern."""
    standing = board_of([0.0, 0.6, 0.9, 1.2, 1.8, 2.4], [0.3 * i for i in range(1, 7)])
    image, placed = image_of(standing, (0.0, 1.2, 8.0))
    detection = detect_rods(image, paper_board())
    assert detection.found.all()
    truth = placed.marks_px(LEFT)[[0, 1, 3, 4, 5]]
    assert np.abs(detection.marks_px - truth).max() < 0.3


def test_what_stands_beside_a_cut_rod_is_none() -> None:
    """Three edges of a window beside the image border, 0.1 m from where the fifth rod must be."""
    board = paper_board()
    placed = place_board(board, np.zeros(3), np.array([0.0, 1.2, 8.0]), np.random.default_rng(0))
    marks = placed.marks_px(LEFT)
    size = LEFT.camera.size
    scale = np.linalg.norm(marks[4, 5] - marks[4, 0]) / 1.5
    marks[4, [0, 1, 4]] = np.nan
    assert not stray_rods(board, marks, size).any()
    beside = marks.copy()
    beside[4, :, 0] -= 0.13 * scale
    np.testing.assert_array_equal(stray_rods(board, beside, size), [0, 0, 0, 0, 1])
    leaning = marks.copy()
    leaning[4, :, 0] += 0.08 * scale * np.linspace(-0.75, 0.75, 6)
    np.testing.assert_array_equal(stray_rods(board, leaning, size), [0, 0, 0, 0, 1])
    whole = placed.marks_px(LEFT)
    whole[4, :, 0] -= 0.13 * scale  # six marks with the right spacing vouch for themselves
    assert not stray_rods(board, whole, size).any()
    lone = placed.marks_px(LEFT)
    lone[2, 1:] = np.nan
    np.testing.assert_array_equal(stray_rods(board, lone, size), [0, 0, 1, 0, 0])
    few = beside.copy()
    few[1:3] = np.nan  # of two rods nothing can be said of a third one
    assert not stray_rods(board, few, size)[4]


def test_trees_are_no_board(shared_data: Path) -> None:
    """Poles without bands among trees and snow."""
    photographs = sorted((shared_data / 'poles').glob('*pole1.jpg'))
    assert len(photographs) == 2
    for path in photographs:
        image = read_image_file(path)
        share = 500 / max(image.shape)
        small = cv2.resize(image, None, fx=share, fy=share, interpolation=cv2.INTER_AREA)
        assert not detect_rods(small, paper_board()).found.any(), path.name


def test_scattered_marks_are_no_board() -> None:
    """Eight marks of thirty, as trees gave them; what people leave of a board is one."""
    board = paper_board()
    placed = place_board(board, np.zeros(3), np.array([0.0, 1.2, 8.0]), np.random.default_rng(0))
    marks = placed.marks_px(LEFT)

    def seen(*rows: str) -> np.ndarray[Any, Any]:
        shown = np.array([[mark == 'x' for mark in row] for row in rows])
        return np.where(shown[..., None], marks, np.nan)

    none = '......'
    for rows in (
        ('xxxx..', none, none, none, '..xxxx'),  # rods missing in between
        ('x.x..x', none, 'x..x.x', none, none),  # gaps along the rods
        (none, 'x..x.x', 'x.x..x', '..x..x', none),
        ('x.x.x.', none, 'x..xxx', none, none),  # few in short stretches, as in birches
    ):
        assert scattered(board, seen(*rows), LEFT.camera.size)
    for rows in (
        ('xxxxxx', none, none, none, 'xxxxxx'),  # people before three rods
        ('xxx...', 'xxx...', none, none, none),
        ('xx..xx', 'xx..xx', 'xx..xx', 'xx..xx', 'xx..xx'),  # a barrier before all
        ('xxxxx.', '.xxxx.', 'x....x', '.xxxx.', 'xxxxxx'),
    ):
        assert not scattered(board, seen(*rows), LEFT.camera.size)
    # only what the image can show counts
    away = place_board(board, np.zeros(3), np.array([-2.5, 1.2, 8.0]), np.random.default_rng(0))
    cut = away.marks_px(LEFT)
    cut[:3] = np.nan
    cut[3:, 3:] = np.nan
    assert not scattered(board, cut, LEFT.camera.size)


def test_two_posts_with_nothing_in_between_are_no_board(monkeypatch: pytest.MonkeyPatch) -> None:
    """Four marks on each, though nothing contradicts that identity; with six it is a board."""
    board = paper_board()
    image, placed = image_of(board, (0.0, 1.2, 8.0))
    monkeypatch.setattr(detect, 'settle_identity', lambda *given: given[-1].marks_px)
    truth = placed.marks_px(LEFT)
    columns = truth[..., 0].mean(axis=1).astype(int)
    for x in columns[1:4]:
        image[:, x - 15 : x + 16] = 110
    assert detect_rods(image, board).found.sum() == 12
    for rod in (0, 4):
        bottom = int(truth[rod, 4, 1]) + 18
        image[:bottom, columns[rod] - 15 : columns[rod] + 16] = 110
    assert not detect_rods(image, board).found.any()


@pytest.mark.parametrize('shape', [(1, 1), (1, 200), (31, 500), (33, 64, 3)])
def test_tiny_images_hold_no_board(shape: tuple[int, ...]) -> None:
    detection = detect_rods(np.zeros(shape, np.uint8), paper_board())
    assert not detection.found.any()
    small = min(shape[:2]) < 32
    assert (f'{shape[1]}x{shape[0]} px is too small' in detection.messages[0]) == small


@pytest.mark.parametrize(
    ('image', 'message'),
    [
        (np.zeros((20, 20), np.float32), r'uint8 or uint16, got \(20, 20\) float32'),
        (np.zeros((20,), np.uint8), r'uint8 or uint16, got \(20,\)'),
        (np.zeros((20, 20, 4), np.uint8), 'must have 3 channels, got 4'),
    ],
)
def test_other_images_are_refused(image: np.ndarray[Any, Any], message: str) -> None:
    with pytest.raises(ImageError, match=message):
        detect_rods(image, paper_board())
