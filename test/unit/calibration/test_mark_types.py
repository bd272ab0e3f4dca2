# SPDX-License-Identifier: Apache-2.0
"""Types of marks: the registry, rods that begin with a light band, and a wrong ``mark_type``."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from binocular_recon.calibration.detection.detect import detect_rods
from binocular_recon.calibration.session.captures import (
    BoardFiles,
    BoardReading,
    capture_set,
    read_captures,
)
from binocular_recon.calibration.target.capture import Capture
from binocular_recon.calibration.target.mark_types import (
    BAND_EDGE,
    BAND_EDGE_LIGHT,
    MARK_TYPES,
    MarkType,
    find_mark_type,
)
from binocular_recon.calibration.target.rods import RodBoard, load_rods, save_rods
from binocular_recon.calibration.target.target import Target
from binocular_recon.errors import CalibrationError
from binocular_recon.evaluation.calibration.detection import score_capture, summarise_scores
from binocular_recon.inputs.common_size import CommonSize
from binocular_recon.io.image_files import write_image_file
from binocular_recon.simulation.capture import mixed_options, simulate_capture
from binocular_recon.simulation.rods import paper_board
from test.rod_images import LEFT, RIG, board_of, image_of

DARK = paper_board()
LIGHT = replace(DARK, mark_type=BAND_EDGE_LIGHT)
SAYS_LIGHT = 'the rods begin with a light band; set mark_type: band_edge_light in rods.yaml'
SAYS_DARK = 'the rods begin with a dark band; set mark_type: band_edge in rods.yaml'

pytestmark = pytest.mark.long


def test_bands_alternate_from_the_lowest_one() -> None:
    assert BAND_EDGE.light_bands(3).tolist() == [False, True, False, True]
    assert BAND_EDGE.dark_below(3).tolist() == [True, False, True]
    assert BAND_EDGE_LIGHT.light_bands(3).tolist() == [True, False, True, False]
    assert BAND_EDGE_LIGHT.dark_below(3).tolist() == [False, True, False]
    assert DARK.dark_below.shape == (6,) and DARK.light_bands.shape == (7,)


def test_types_are_found_by_name() -> None:
    assert {name: mark_type.name for name, mark_type in MARK_TYPES.items()} == {
        'band_edge': 'band_edge',
        'band_edge_light': 'band_edge_light',
    }
    assert find_mark_type('band_edge_light') is BAND_EDGE_LIGHT
    for name in ('ring', 3, ['band_edge']):
        with pytest.raises(CalibrationError, match='one of band_edge, band_edge_light, got '):
            find_mark_type(name)


def test_each_type_knows_the_one_with_bands_exchanged(monkeypatch: pytest.MonkeyPatch) -> None:
    assert BAND_EDGE.reversed() is BAND_EDGE_LIGHT
    assert BAND_EDGE_LIGHT.reversed() is BAND_EDGE
    monkeypatch.delitem(MARK_TYPES, 'band_edge_light')
    assert BAND_EDGE.reversed() is None


def test_type_is_kept_in_rods_yaml(tmp_path: Path) -> None:
    save_rods(LIGHT, tmp_path / 'rods.yaml')
    assert 'mark_type: band_edge_light' in (tmp_path / 'rods.yaml').read_text()
    assert load_rods(tmp_path / 'rods.yaml').mark_type is BAND_EDGE_LIGHT


def test_type_says_where_the_mark_is_seen() -> None:
    """On the surface, or as here on the axis: simulation and adjustment follow."""
    on_axis = replace(DARK, mark_type=MarkType('axis', lowest_band='dark', offset_radii=0.0))
    assert (DARK.mark_offset_m, on_axis.mark_offset_m) == (0.02, 0.0)
    assert (Target.from_rods(DARK).radius_m, Target.from_rods(on_axis).radius_m) == (0.02, 0.0)
    _, placed = image_of(on_axis, (0.0, 1.2, 8.0))
    np.testing.assert_array_equal(placed.marks_px(LEFT), LEFT.project(placed.marks_xyz()))


def test_simulation_paints_the_bands_of_the_type() -> None:
    """The level below the first mark against that above it."""
    for board, sign in ((DARK, 1), (LIGHT, -1)):
        image, placed = image_of(board, (0.0, 1.2, 8.0))
        for x, y in np.rint(placed.marks_px(LEFT)[:, 0]).astype(int):
            below, above = image[y + 8, x].mean(), image[y - 8, x].mean()
            assert sign * (above - below) > 100


def test_light_lowest_band_is_measured_to_hundredths() -> None:
    image, placed = image_of(LIGHT, (0.2, 1.2, 8.0), (0.05, 0.4, 0.1))
    detection = detect_rods(image, LIGHT)
    assert detection.found.all() and detection.messages == ()
    assert np.sqrt(np.mean((detection.marks_px - placed.marks_px(LEFT)) ** 2)) < 0.04


def test_both_types_on_clutter() -> None:
    """Bounds of test_clutter_occlusion_border_and_tilt, for a board of each type."""
    scores = []
    for seed, board in enumerate((DARK, LIGHT)):
        rng = np.random.default_rng([12, seed])
        capture = simulate_capture(board, RIG, rng, mixed_options(rng))
        scores.append(score_capture(board, capture))
    figures = summarise_scores(scores)
    assert figures['wrong_identities'] == 0
    assert figures['boards_complete'] == 2
    assert max(figures['rms_px'].values()) < 0.12


def test_uneven_spacing_with_a_light_lowest_band() -> None:
    uneven = board_of([0.0, 0.5, 1.4], [0.2, 0.5, 0.7, 1.1, 1.8], 0.05)
    image, placed = image_of(replace(uneven, mark_type=BAND_EDGE_LIGHT), (0.0, 1.1, 6.0))
    detection = detect_rods(image, placed.board)
    assert detection.found.all()
    assert np.abs(detection.marks_px - placed.marks_px(LEFT)).max() < 0.25
    # nothing of the board fits the other way round
    assert detect_rods(image, uneven).messages == (SAYS_LIGHT,)


@pytest.mark.parametrize(
    ('stands', 'said', 'message'), [(LIGHT, DARK, SAYS_LIGHT), (DARK, LIGHT, SAYS_DARK)]
)
@pytest.mark.parametrize('background', [60.0, 110.0, 230.0])
def test_wrong_type_is_refused(
    stands: RodBoard, said: RodBoard, message: str, background: float
) -> None:
    image, _ = image_of(stands, (0.0, 1.2, 8.0), (0.0, 0.3, 0.0), background=background)
    detection = detect_rods(image, said)
    assert not detection.found.any()
    assert detection.messages == (message,)
    assert detect_rods(image, stands).found.all()


def test_wrong_type_of_a_part_of_a_board_is_refused() -> None:
    """Two of five rods are out of the image to the left, and one mark is hidden."""
    image, placed = image_of(LIGHT, (-2.5, 1.2, 8.0))
    x, y = placed.marks_px(LEFT)[4, 2].astype(int)
    image[y - 10 : y + 10, x - 14 : x + 14] = 110
    assert detect_rods(image, DARK).messages == (SAYS_LIGHT,)


def test_hidden_tops_and_feet_on_snow_are_not_the_other_type() -> None:
    """Feet on ground as light as the bands look like marks of the other type."""
    for level in (215.0, 225.0):
        image, placed = image_of(DARK, (0.0, 1.2, 8.0), background=level)
        truth = placed.marks_px(LEFT)
        x0, y0 = truth[:, -1].min(0).astype(int) - 60
        x1, y1 = truth[:, -1].max(0).astype(int) + 20
        image[max(0, y0) : y1, x0:x1] = 90
        detection = detect_rods(image, DARK)
        assert 'begin with' not in ''.join(detection.messages)
        assert np.nanmax(np.abs(detection.marks_px - truth), initial=0) < 0.3


def test_reason_is_given_for_captures_on_disk(tmp_path: Path) -> None:
    image, _ = image_of(LIGHT, (0.0, 1.2, 8.0))
    for side in ('left', 'right'):
        write_image_file(tmp_path / f'{side}_1.png', image)
    with pytest.raises(CalibrationError, match=f'on 1 of 1 boards of .* {SAYS_LIGHT}'):
        read_captures(tmp_path, DARK)


def reading(name: str, *, read: bool, other: MarkType | None = None) -> BoardReading:
    """Return what became of a board of 1920x1200 px."""
    files = BoardFiles(name, Path(f'left_{name}.png'), Path(f'right_{name}.png'))
    marks = np.zeros((5, 6, 2))
    capture = Capture(name, marks, marks) if read else None
    reason = '' if read else f'left: {SAYS_LIGHT}'
    return BoardReading(files, capture, CommonSize((1920, 1200), (1920, 1200)), reason, other)


def test_boards_that_fit_either_type_are_refused_with_those_that_do_not(tmp_path: Path) -> None:
    """Of 100 boards with the wrong type, about 8 show too little to tell."""
    contradict = [reading(f'{i}', read=False, other=BAND_EDGE_LIGHT) for i in range(4)]
    fit = [reading(f'{i}', read=True) for i in range(4, 7)]
    with pytest.raises(CalibrationError, match=f'on 4 of 7 boards of .* {SAYS_LIGHT}'):
        capture_set([*contradict, *fit], tmp_path)
    # a few boards of other rods spoil nothing
    found = capture_set([*contradict[:2], *fit], tmp_path)
    assert len(found.captures) == 3 and [board.name for board in found.rejected] == ['0', '1']


def test_only_images_without_rods_point_at_the_description(tmp_path: Path) -> None:
    lost = BoardReading(BoardFiles('1', None, None, ''), None, None, 'there is no left image')
    with pytest.raises(CalibrationError, match=r'nothing can be used of the 1 .*no left') as error:
        capture_set([lost], tmp_path)
    assert 'rods.yaml' not in str(error.value)
