# SPDX-License-Identifier: Apache-2.0
"""A progress bar for the terminal, and plain lines for logs."""

from __future__ import annotations

import shutil
import sys
import time

from binocular_recon.errors import plain_text
from binocular_recon.number_text import significant

# Steps may take microseconds; drawing the line takes longer.
_REDRAW_PERIOD_S = 0.1
# Without a terminal: often enough to show progress.
PLAIN_PERIOD_S = 10.0


class ProgressBar:
    """One line on stderr that is redrawn; a line every ten seconds where that is not a terminal.

    Parameters
    ----------
    total : int
        Number of steps.
    unit : str
        Name of the steps, in the plural.
    before : int
        Steps that are done already.

    """

    def __init__(self, total: int, unit: str, before: int = 0) -> None:
        self._total, self._unit, self._before = max(1, total), unit, before
        self._visible = sys.stderr.isatty()
        self.restart_clock()

    def __enter__(self) -> ProgressBar:  # noqa: PYI034 - Self is newer than Python 3.10
        """Draw the empty bar."""
        self.show(self._before)
        return self

    def __exit__(self, *error: object) -> None:
        """Remove the bar."""
        if self._visible:
            print(end='\r\033[K', file=sys.stderr, flush=True)

    def restart_clock(self) -> None:
        """Estimate the time left from now on: what was done until here is done once."""
        self._start = time.monotonic()
        self._next_s = 0.0 if self._visible else self._start + PLAIN_PERIOD_S

    def show(self, done: int, note: str = '') -> None:
        """Draw the bar with ``done`` finished steps, and ``note`` after it."""
        now_s = time.monotonic()
        begun = done > self._before
        if begun and now_s < self._next_s:
            return
        if self._visible:
            self._next_s = now_s + _REDRAW_PERIOD_S if begun else 0.0
            self._redraw(done, self._text(done, note, now_s))
        else:
            self._next_s = now_s + PLAIN_PERIOD_S
            if begun:
                print(self._text(done, note, now_s), file=sys.stderr, flush=True)

    def _text(self, done: int, note: str, now_s: float) -> str:
        text = f'{done} of {self._total} {self._unit}'
        if done > self._before:
            step_s = (now_s - self._start) / (done - self._before)
            left_s = step_s * max(0, self._total - done)
            text += f', {_rate(step_s)}, {duration(left_s)} left'
        return f'{text}  {plain_text(note)}' if note else text

    def _redraw(self, done: int, text: str) -> None:
        share = min(1.0, done / self._total)
        columns = shutil.get_terminal_size().columns
        width = max(0, min(40, columns - len(text) - 4))
        bar = f'[{"#" * round(width * share):<{width}}]' if width >= 5 else ''
        print(end=f'\r\033[K{bar} {text}'[: columns + 3], file=sys.stderr, flush=True)


def _rate(step_s: float) -> str:
    """Return how fast steps are done, with a number that is not below 1."""
    if step_s > 1:
        return f'{significant(step_s, 2)} s each'
    return f'{significant(1 / max(step_s, 1e-9), 2)} per second'


def duration(seconds: float) -> str:
    """Return a duration as people say it: in seconds, minutes or hours and minutes."""
    if seconds < 100:
        return f'{seconds:.0f} s'
    minutes = round(seconds / 60)
    return f'{minutes} min' if minutes < 100 else f'{minutes // 60} h {minutes % 60:02d} min'
