# SPDX-License-Identifier: Apache-2.0
"""The report and what it is made of: charts, mark errors, advice."""

from __future__ import annotations

import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest

from binocular_recon.calibration.report.mark_errors import mark_errors_m
from binocular_recon.calibration.report.report import BoardImage, render_report
from binocular_recon.calibration.session.points_csv import read_points
from binocular_recon.calibration.solve import calibrate
from binocular_recon.calibration.target.capture import Capture
from binocular_recon.calibration.target.target import Target
from binocular_recon.drawing.svg import Chart, ticks
from binocular_recon.rotations import rotation
from binocular_recon.simulation.rig import survey_rig
from binocular_recon.simulation.rods import place_board
from test.calibration_tools import CHESSBOARD, SIZE, board_of, captures_of, solved, truth

pytestmark = pytest.mark.long

VOID = {'meta', 'rect', 'path', 'polyline', 'polygon', 'br', 'img'}


class Balanced(HTMLParser):
    """Check that every element is closed, and collect what the page refers to."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.references: list[str] = []
        self.charts = 0

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.charts += tag == 'svg'
        self.references += [value or '' for name, value in attrs if name in {'src', 'href'}]
        if tag not in {'meta', 'img'}:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        assert tag in VOID
        self.references += [value or '' for name, value in attrs if name in {'src', 'href'}]

    def handle_endtag(self, tag: str) -> None:
        assert self.open and self.open.pop() == tag


def test_report_is_one_complete_page() -> None:
    result = solved(0.005)
    page = render_report(result)
    parser = Balanced()
    parser.feed(page)
    assert not parser.open and not parser.references
    assert parser.charts == 12
    assert 'nan' not in re.sub(r'<style>.*</style>', '', page, flags=re.DOTALL).lower()
    for name in result.names:
        assert f'<td>{name}</td>' in page
    assert f'{1e3 * result.calibration.baseline_m:.2f} mm' in page
    assert f'{result.planar.board_error_px[3]:.3f}' in page
    assert 'What to capture next' in page
    assert len(page) < 500_000


def test_report_of_points_and_of_lost_boards() -> None:
    table = read_points(CHESSBOARD)
    broken = Capture('<b>&', np.full((54, 1, 2), np.nan), np.full((54, 1, 2), np.nan))
    result = calibrate((*table.captures, broken), table.target, table.least_size)
    page = render_report(result)
    parser = Balanced()
    parser.feed(page)
    assert not parser.open
    assert 'Board <b>&lt;b&gt;&amp;</b> was left out: 0 of 54 marks' in page


def test_rods_of_two_marks_have_a_report() -> None:
    """Nothing but the length of a rod can be compared."""
    two = [
        replace(c, left_px=c.left_px[:, [0, 5]], right_px=c.right_px[:, [0, 5]])
        for c in captures_of(0.003)
    ]
    board = board_of(0.003)
    result = calibrate(two, replace(board, marks_m=board.marks_m[[0, 5]]), SIZE)
    errors = mark_errors_m(result.adjusted.marks_m, result.estimate.problem.target)
    assert 1e-4 < np.sqrt(np.nanmean(errors**2)) < 0.005
    np.testing.assert_allclose(errors[..., 0], errors[..., 1])
    page = render_report(result)
    assert 'Reconstructed marks against their known places' in page


def test_report_shows_images() -> None:
    """They are inside the page: nothing is fetched."""
    images = [BoardImage('01', b'first'), BoardImage('<2>', b'', 'an image is missing')]
    page = render_report(solved(0.005), images)
    parser = Balanced()
    parser.feed(page)
    assert not parser.open
    assert parser.references == ['data:image/jpeg;base64,Zmlyc3Q=', 'data:image/jpeg;base64,']
    assert 'Board &lt;2&gt; was left out: an image is missing.' in page


def test_chart_places_data() -> None:
    chart = Chart((0, 10), (5, 0), (218, 116))
    np.testing.assert_allclose(chart.place(np.array([[0, 0], [10, 5]])), [[6, 10], [206, 110]])
    chart.dots(np.array([[5, 2.5], [np.nan, 1]]), '#000')
    assert 'M106.0 60.0h0"' in chart.svg('a <chart>')
    assert 'aria-label="a &lt;chart&gt;"' in chart.svg('a <chart>')


@pytest.mark.parametrize(
    ('limits', 'expected'),
    [
        ((0, 10), [0, 2, 4, 6, 8, 10]),
        ((-1.2, 1.3), [-1, -0.5, 0, 0.5, 1]),
        ((0.011, 0.042), [0.015, 0.02, 0.025, 0.03, 0.035, 0.04]),
        ((100, 0), [0, 20, 40, 60, 80, 100]),
    ],
)
def test_ticks_are_round(limits: tuple[float, float], expected: list[float]) -> None:
    np.testing.assert_allclose(ticks(*limits), expected, atol=1e-12)


def test_mark_errors_ignore_where_a_rod_stands() -> None:
    target = Target.from_rods(board_of(0.005))
    rng = np.random.default_rng(0)
    marks, _ = target.marks(rng.normal(0, 0.1, (2, 5, 5)))
    marks = marks @ rotation(np.array([0.3, -0.5, 0.1])).T + np.array([1.0, 2.0, 9.0])
    np.testing.assert_allclose(mark_errors_m(marks, target), 0, atol=1e-12)
    # 1 % too large: the outermost marks are 0.75 m from the middle
    errors = mark_errors_m(1.01 * marks, target)
    np.testing.assert_allclose(errors[:, :, 5], 0.0075, atol=1e-9)
    np.testing.assert_allclose(errors[:, :, 0], 0.0075, atol=1e-9)
    marks[0, 0, 1:] = np.nan
    assert np.isnan(mark_errors_m(marks, target)[0, 0]).all()


def test_mark_errors_of_points() -> None:
    table = read_points(CHESSBOARD)
    points = table.target.anchors_m @ rotation(np.array([0.3, -0.5, 0.1])).T + 3.0
    errors = mark_errors_m(1.02 * points[None, :, None], table.target)
    radius = np.linalg.norm(table.target.anchors_m - table.target.anchors_m.mean(axis=0), axis=1)
    np.testing.assert_allclose(errors[0, :, 0], 0.02 * radius, atol=1e-9)


def test_advised_board_gains_what_was_promised() -> None:
    result = solved(0.005)
    best, *others = result.advice
    assert best.gain > 0.05
    assert all(other.sigma_before_m < best.sigma_before_m for other in others)
    assert best.sigma_before_m == pytest.approx(result.depth_sigma_m(best.depth_m, 0.0))
    # put such a board up and calibrate again
    board, rig = board_of(0.005), survey_rig()
    half = SIZE[0] / 2 / truth().K_left[0, 0]
    middle = np.array([best.column * half * best.distance_m, 1.2, best.distance_m])
    rng = np.random.default_rng(1)
    placed = place_board(board, np.array([0, -np.radians(best.turn_deg), 0]), middle, rng)
    pixels = [placed.marks_px(view) for view in rig.views()]
    noisy = [px + rng.normal(0, 0.2, px.shape) for px in pixels]
    more = calibrate([*captures_of(), Capture('12', *noisy)], board, SIZE)
    assert more.depth_sigma_m(best.depth_m, 0.0) == pytest.approx(best.sigma_after_m, rel=0.15)


def test_advice_in_words() -> None:
    words = str(solved(0.005).advice[0])
    assert re.fullmatch(
        r'a board at [\d.]+ m, (far )?(left|right|middle) of the image, (turned by \d+ degrees,'
        r' its (left|right) end away from the cameras|facing the cameras): depth sigma at [\d.]+ m'
        r' falls from [\d.]+ to [\d.]+ mm \(-\d+ %\)',
        words,
    )
