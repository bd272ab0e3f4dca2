# SPDX-License-Identifier: Apache-2.0
"""The progress bar."""

from __future__ import annotations

import io
import sys

import pytest

from binocular_recon.apps.progress import ProgressBar, duration


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_progress_is_drawn_on_a_terminal_only(monkeypatch: pytest.MonkeyPatch) -> None:
    for stream, seen in ((Terminal(), True), (io.StringIO(), False)):
        monkeypatch.setattr(sys, 'stderr', stream)
        with ProgressBar(4, 'frames') as bar:
            bar.show(2)
            assert ('2 of 4 frames' in stream.getvalue()) is seen
            assert ('####' in stream.getvalue()) is seen
            bar.show(3)  # too soon to be drawn
            assert '3 of 4 frames' not in stream.getvalue()
        assert stream.getvalue().endswith('\r\033[K') is seen


def test_without_a_terminal_a_line_comes_every_ten_seconds(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    stream, now_s = io.StringIO(), 0.0
    monkeypatch.setattr(sys, 'stderr', stream)
    monkeypatch.setattr('time.monotonic', lambda: now_s)
    with ProgressBar(40, 'frames') as bar:
        for done in range(1, 40):
            now_s = float(done)
            bar.show(done)
    assert stream.getvalue().splitlines() == [
        '10 of 40 frames, 1.0 per second, 30 s left',
        '20 of 40 frames, 1.0 per second, 20 s left',
        '30 of 40 frames, 1.0 per second, 10 s left',
    ]


def test_what_is_done_once_does_not_lengthen_the_time_left(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    stream, now_s = io.StringIO(), 0.0
    monkeypatch.setattr(sys, 'stderr', stream)
    monkeypatch.setattr('time.monotonic', lambda: now_s)
    with ProgressBar(31, 'frames') as bar:
        now_s = 30.0  # kernels are compiled
        bar.restart_clock()
        for done in range(1, 12):
            now_s += 1.0
            bar.show(done)
    assert stream.getvalue() == '10 of 31 frames, 1.0 per second, 21 s left\n'


def test_rate_and_time_left_are_those_that_people_read(monkeypatch: pytest.MonkeyPatch) -> None:
    texts = [duration(seconds) for seconds in (0.4, 99, 100, 5000, 36_100)]
    assert texts == ['0 s', '99 s', '2 min', '83 min', '10 h 02 min']
    stream, now_s = io.StringIO(), 0.0
    monkeypatch.setattr(sys, 'stderr', stream)
    monkeypatch.setattr('time.monotonic', lambda: now_s)
    with ProgressBar(1000, 'frames') as bar:
        for second in (12.5, 15.0, 25.0):  # while one frame takes long
            now_s = second
            bar.show(1)
    assert stream.getvalue().splitlines() == [
        '1 of 1000 frames, 12 s each, 3 h 28 min left',
        '1 of 1000 frames, 25 s each, 6 h 56 min left',
    ]
