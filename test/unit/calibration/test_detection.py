# SPDX-License-Identifier: Apache-2.0
"""Rod detection on ray-cast images: what is found, how exactly, and what is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from binocular_recon.calibration.detection._board_layout import Layout
from binocular_recon.calibration.detection.detect import _settle, detect_rods
from binocular_recon.calibration.target.board_plane import slant
from binocular_recon.calibration.target.rods import RodBoard
from binocular_recon.errors import ImageError
from binocular_recon.evaluation.calibration.detection import score_capture, summarise_scores
from binocular_recon.io.image_files import read_image_file
from binocular_recon.simulation.capture import CaptureOptions, mixed_options, simulate_capture
from binocular_recon.simulation.render import RodPaint, Sensor, draw_rods, expose
from binocular_recon.simulation.rig import survey_rig
from binocular_recon.simulation.rods import PlacedBoard, paper_board, place_board

RIG = survey_rig()
LEFT = RIG.views()[0]


def board_of(
    rods: list[float] | list[tuple[float, float]], marks: list[float], diameter: float = 0.04
) -> RodBoard:
    """Return a board with rods at x, or x and z."""
    places = [rod if isinstance(rod, tuple) else (rod, 0.0) for rod in rods]
    return RodBoard.from_mapping(
        {
            'rods': [{'x': float(x), 'z': z} for x, z in places],
            'marks': marks,
            'rod_diameter': diameter,
            'placement_sigma': 0.003,
        }
    )


def image_of(
    board: RodBoard,
    translation: tuple[float, float, float],
    rotation: tuple[float, float, float] = (0.0, 0.0, 0.0),
    background: float = 110.0,
    **paint: Any,
) -> tuple[np.ndarray[Any, Any], PlacedBoard]:
    """Return an image of a board before a plain wall, and the board."""
    rng = np.random.default_rng(5)
    placed = place_board(board, np.array(rotation), np.array(translation), rng)
    canvas = np.full((1200, 1920, 3), background, np.float32)
    length = board.marks_m[-1] + 0.2
    draw_rods(canvas, LEFT, placed, RodPaint(length_m=length, **paint))
    return expose(canvas, Sensor(), rng), placed


def errors(image: np.ndarray[Any, Any], placed: PlacedBoard) -> np.ndarray[Any, Any]:
    detection = detect_rods(image, placed.board)
    error: np.ndarray[Any, Any] = detection.marks_px - placed.marks_px(LEFT)
    return error


def test_plain_board_is_measured_to_hundredths() -> None:
    image, placed = image_of(paper_board(), (0.2, 1.2, 8.0), (0.05, 0.4, 0.1))
    error = errors(image, placed)
    assert np.isfinite(error).all()
    assert np.sqrt(np.mean(error**2)) < 0.04
    detection = detect_rods(image, placed.board)
    assert detection.found.all() and detection.messages == ()
    assert 0.02 < np.median(detection.sigma_px) < 0.05
    honesty = np.sqrt(np.mean((error[..., 1] / detection.sigma_px) ** 2))
    assert 0.4 < honesty < 1.4


@pytest.mark.parametrize('sun', [(0.95, -0.3, 0.0), (-0.95, -0.3, 0.0), (0.1, -0.2, -0.97)])
def test_light_from_the_side_does_not_shift_the_middle(sun: tuple[float, float, float]) -> None:
    """A fit of plain sides is off by 0.2 px here."""
    image, placed = image_of(paper_board(), (0.2, 1.2, 13.0), sun_xyz=sun, ambient=0.5)
    assert abs(np.nanmean(errors(image, placed)[..., 0])) < 0.04


def test_clutter_occlusion_border_and_tilt(shared_data: Path) -> None:
    """The figures of a large run, on few boards; the command's --evaluate option runs more."""
    photographs = tuple(
        read_image_file(shared_data / 'poles' / f'{name}.jpg') for name in ('c1_pole1', 'c3_pole2')
    )
    board = paper_board()
    scores = []
    for seed in range(4):
        rng = np.random.default_rng([11, seed])
        options = mixed_options(rng, photographs)
        scores.append(score_capture(board, simulate_capture(board, RIG, rng, options)))
    figures = summarise_scores(scores)
    assert figures['wrong_identities'] == 0
    assert figures['boards_complete'] >= 3
    assert figures['rms_px']['x'] < 0.12
    assert figures['rms_px']['y'] < 0.12


@pytest.mark.parametrize(
    ('rods', 'marks', 'diameter', 'depth'),
    [
        ([0.0], [0.3, 0.6, 0.9, 1.2, 1.5, 1.8], 0.04, 7.0),
        ([0.0, 0.7], [0.4, 0.8, 1.2], 0.05, 7.0),
        ([0.0, 0.5, 1.4], [0.2, 0.5, 0.7, 1.1, 1.8], 0.05, 6.0),
        ([0.25 * i for i in range(20)], [0.3 + 0.15 * i for i in range(10)], 0.03, 11.0),
        ([0.0, 1.0], [0.3, 0.6, 0.9, 1.2], 0.1, 4.2),
        # 3 px wide
        ([0.0, 0.6, 1.2, 1.8, 2.4], [0.3, 0.6, 0.9, 1.2, 1.5, 1.8], 0.028, 15.4),
    ],
)
def test_any_number_of_rods_and_any_spacing(
    rods: list[float], marks: list[float], diameter: float, depth: float
) -> None:
    image, placed = image_of(board_of(rods, marks, diameter), (0.0, 1.1, depth), (0.05, 0.3, 0.05))
    error = errors(image, placed)
    assert np.isfinite(error).all()
    assert np.abs(error).max() < 0.25


@pytest.mark.parametrize(
    ('z', 'yaw', 'hidden'),
    [
        ([0.0, 0.2, 0.0, 0.2, 0.0], 0.8, None),
        ([0.0, 0.2, 0.0, 0.2, 0.0], -0.7, 3),
        ([0.0, -0.3, 0.1, 0.3, 0.05], 0.7, None),
    ],
)
def test_rods_off_their_row_keep_their_identity(
    z: list[float], yaw: float, hidden: int | None
) -> None:
    """Seen from the side they stand elsewhere along the row, rods 3 and 4 like 4 and 5."""
    board = board_of(list(zip(np.arange(5) * 0.6, z, strict=True)), [0.3 * i for i in range(1, 7)])
    image, placed = image_of(board, (0.0, 1.1, 8.0), (0.05, yaw, 0.0))
    truth = placed.marks_px(LEFT)
    expected = np.ones((5, 6), np.bool_)
    if hidden is not None:
        x = int(truth[hidden, :, 0].mean())
        image[:, x - 15 : x + 16] = 110
        expected[hidden] = False
    detection = detect_rods(image, board)
    np.testing.assert_array_equal(detection.found, expected)
    assert np.nanmax(np.abs(detection.marks_px - truth)) < 0.25


@pytest.mark.parametrize('roll_deg', [-20.0, -12.0, 12.0, 20.0])
def test_rods_leaning_up_to_20_degrees(roll_deg: float) -> None:
    image, placed = image_of(
        paper_board(), (0.0, 1.0, 8.0), (0.0, 0.2, float(np.deg2rad(roll_deg)))
    )
    error = errors(image, placed)
    assert np.isfinite(error).all()
    assert np.sqrt(np.mean(error**2)) < 0.06


def test_red_and_white_8_and_16_bits_grey_and_dark() -> None:
    image, placed = image_of(paper_board(), (0.0, 1.2, 9.0), dark_bgr=(40.0, 35.0, 190.0))
    grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    for other in (image, grey, grey[..., None], grey.astype(np.uint16) * 40, grey // 3):
        error = errors(other, placed)
        assert np.isfinite(error).all()
        assert np.sqrt(np.mean(error**2)) < 0.08


def test_bands_that_differ_in_colour_only() -> None:
    """Red and grey of one luminance: seen in the smallest channel."""
    red, grey = (20.0, 20.0, 222.0), (80.0, 80.0, 80.0)
    image, placed = image_of(
        paper_board(), (0.0, 1.2, 9.0), background=180.0, dark_bgr=red, light_bgr=grey
    )
    assert np.isfinite(errors(image, placed)).all()


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
    assert detection.messages == ('28 of 30 marks',)


@pytest.mark.parametrize('marks', [0, 1])
def test_missing_rod_is_named(marks: int) -> None:
    """A lone mark has nothing that vouches for it."""
    image, placed = image_of(paper_board(), (0.0, 1.2, 8.0))
    x, y = placed.marks_px(LEFT)[2, -1].astype(int)
    image[marks * (y + 15) :, x - 15 : x + 16] = 110
    detection = detect_rods(image, placed.board)
    assert detection.messages == ('rod 3 of 5 not found', '24 of 30 marks')
    assert np.nanmax(np.abs(detection.marks_px - placed.marks_px(LEFT))) < 0.3


def test_rods_cut_by_the_image_border_keep_their_identity() -> None:
    """Two of five rods are out of the image to the left."""
    image, placed = image_of(paper_board(), (-4.3, 1.2, 8.0))
    truth = placed.marks_px(LEFT)
    detection = detect_rods(image, placed.board)
    seen = (truth[..., 0] > 3) & (truth[..., 0] < 1916)
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
