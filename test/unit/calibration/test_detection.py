# SPDX-License-Identifier: Apache-2.0
"""Rod detection on ray-cast images: what is found, and how exactly."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from binocular_recon.calibration.adjustment.bundle_adjustment import ROD_ERROR_PX
from binocular_recon.calibration.detection.detect import detect_rods
from binocular_recon.evaluation.calibration.detection import score_capture, summarise_scores
from binocular_recon.io.image_files import read_image_file
from binocular_recon.simulation.capture import mixed_options, simulate_capture
from binocular_recon.simulation.rods import PlacedBoard, paper_board
from test.rod_images import LEFT, RIG, board_of, image_of


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


@pytest.mark.long
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
    seconds = figures['seconds_per_image']
    assert 0 < seconds['median'] <= seconds['p90']
    assert figures['wrong_identities'] == 0
    assert figures['boards_complete'] >= 3
    assert figures['rms_px']['x'] < 0.12
    assert figures['rms_px']['y'] < 0.12


@pytest.mark.long
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


@pytest.mark.long
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


@pytest.mark.long
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


@pytest.mark.long
@pytest.mark.parametrize(
    ('sun', 'ambient', 'place', 'turn'),
    [
        ((1.0, -0.2, -0.1), 0.3, (-0.2, 1.2, 4.2), 0.0),
        ((-0.9, -0.3, -0.3), 0.3, (-0.2, 1.2, 4.2), 0.3),
        ((0.7, -0.3, 0.6), 0.3, (-0.2, 1.2, 4.4), -0.3),
        ((0.837, -0.259, -0.483), 0.4, (0.0, 1.2, 5.0), 0.5),
        ((-0.966, -0.259, 0.0), 0.15, (0.0, 1.2, 5.0), 0.3),
        ((0.621, -0.259, -0.740), 0.15, (0.0, 1.2, 5.0), 0.3),
    ],
)
def test_light_from_the_side_does_not_push_rods_aside(
    sun: tuple[float, ...], ambient: float, place: tuple[float, float, float], turn: float
) -> None:
    """Rods along a row show different sides to the sun; each rod's bias stays below its sigma.

    With one shading for all rods of a row the bias was up to 0.22 px.
    """
    direction = np.array(sun) / np.linalg.norm(sun)
    image, placed = image_of(
        paper_board(), place, (0.0, turn, 0.0), sun_xyz=tuple(direction), ambient=ambient
    )
    detection = detect_rods(image, placed.board)
    assert detection.found.all()
    bias_px = (detection.marks_px - placed.marks_px(LEFT))[..., 0].mean(axis=1)
    assert np.abs(bias_px).max() < ROD_ERROR_PX
