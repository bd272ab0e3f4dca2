# SPDX-License-Identifier: Apache-2.0
"""Picks and what is measured between them, with undo, in step with a picks file."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import count
from pathlib import Path
from types import MappingProxyType

import numpy as np

from binocular_recon.errors import FileError, MeasurementError, shortened
from binocular_recon.measurement.picks import Pick, Request, read_picks, write_picks

MOST_PICKS, LONGEST_NAME = 1000, 60
_MOST_STEPS = 500


@dataclass(frozen=True)
class Marks:
    """One state of the board.

    Attributes
    ----------
    picks : mapping of str to Pick
        By name, in the order in which they were made.
    requests : tuple of Request
        What is measured.
    chosen : tuple of str
        Picks of the measurement that is being made.

    """

    picks: Mapping[str, Pick] = field(default_factory=lambda: MappingProxyType({}))
    requests: tuple[Request, ...] = ()
    chosen: tuple[str, ...] = ()

    def with_pick(self, pick: Pick) -> Marks:
        """Return the marks with one more pick, or in place of that of its name."""
        return replace(self, picks={**self.picks, pick.name: pick})

    def without(self, name: str) -> Marks:
        """Return the marks without a pick and all that is measured with it."""
        return Marks(
            {key: pick for key, pick in self.picks.items() if key != name},
            tuple(one for one in self.requests if name not in one.points),
            tuple(one for one in self.chosen if one != name),
        )

    def without_request(self, index: int) -> Marks:
        """Return the marks without a measurement and the picks that only it used."""
        others = self.requests[:index] + self.requests[index + 1 :]
        used = {name for one in others for name in one.points} | set(self.chosen)
        gone = set(self.requests[index].points) - used
        kept = {name: pick for name, pick in self.picks.items() if name not in gone}
        return Marks(kept, others, self.chosen)

    def renamed(self, name: str, to: str) -> Marks:
        """Return the marks with another name of a pick, wherever it stands."""
        picks = {
            to if key == name else key: replace(pick, name=to) if key == name else pick
            for key, pick in self.picks.items()
        }
        requests = tuple(_renamed(one, name, to) for one in self.requests)
        return Marks(picks, requests, tuple(to if one == name else one for one in self.chosen))

    def free_name(self) -> str:
        """Return a name that no pick has: P1, P2, ..."""
        return next(name for i in count(1) if (name := f'P{i}') not in self.picks)


class PicksBoard:
    """The marks of a page; every change is in the file before it is shown.

    Parameters
    ----------
    path : Path
        Picks file, CSV or YAML; read if it exists.

    Attributes
    ----------
    path : Path
    marks : Marks

    Raises
    ------
    FileError, MeasurementError
        If the file cannot be read.

    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._past: list[Marks] = []
        self._future: list[Marks] = []
        self._seen = _signature(path)
        self.marks = Marks()
        if self._seen is not None:
            picks, requests = read_picks(path, may_be_empty=True)
            self.marks = Marks(picks, tuple(requests))

    @property
    def can_undo(self) -> bool:
        """Whether there is a change to take back."""
        return bool(self._past)

    @property
    def can_redo(self) -> bool:
        """Whether there is a change to make again."""
        return bool(self._future)

    def change(self, marks: Marks) -> None:
        """Go to other marks, and remember these.

        Raises
        ------
        FileError
            If they cannot be saved; then nothing has changed.
        MeasurementError
            If there are too many picks.

        """
        if len(marks.picks) > MOST_PICKS:
            raise MeasurementError(
                f'there are {MOST_PICKS} picks, the limit; delete some, or begin another file'
                ' (--picks)'
            )
        self._save(marks)
        self._past = [*self._past[-_MOST_STEPS:], self.marks]
        self._future = []
        self.marks = marks

    def undo(self) -> None:
        """Take the last change back; raises a FileError as `change`."""
        self._step(self._past, self._future)

    def redo(self) -> None:
        """Make the change again that was taken back last; raises a FileError as `change`."""
        self._step(self._future, self._past)

    def rename(self, name: str, to: str) -> None:
        """Give a pick another name; raises a MeasurementError if it cannot have it."""
        to = to.strip()
        self.pick(name)
        if not to or not to.isprintable() or len(to) > LONGEST_NAME or len(to.split()) != 1:
            raise MeasurementError(
                f'{shortened(to)} is no name of a pick; give 1 to {LONGEST_NAME} letters without'
                ' spaces'
            )
        if to != name:
            if to in self.marks.picks:
                raise MeasurementError(f'there is a pick {to} already; choose another name')
            self.change(self.marks.renamed(name, to))

    def pick(self, name: str) -> Pick:
        """Return a pick by name; raises a MeasurementError if there is none."""
        if name not in self.marks.picks:
            raise MeasurementError(f'there is no pick {shortened(name)} any more')
        return self.marks.picks[name]

    def new_pick(self, frame: int, u: float, v: float) -> Pick:
        """Return a pick with a name of its own; it is not on the board yet."""
        return Pick(self.marks.free_name(), np.round([u, v], 2), frame=frame)

    def _step(self, source: list[Marks], other: list[Marks]) -> None:
        if source:
            self._save(source[-1])
            other.append(self.marks)
            self.marks = source.pop()

    def _save(self, marks: Marks) -> None:
        same = self.marks
        if marks.picks == same.picks and marks.requests == same.requests:
            return
        if _signature(self.path) != self._seen:
            raise FileError(
                f'{self.path} was changed by another program, so it is not replaced; start view'
                ' again to read it, or choose another file with --picks'
            )
        write_picks(self.path, marks.picks.values(), marks.requests)
        self._seen = _signature(self.path)


def _renamed(request: Request, name: str, to: str) -> Request:
    points = tuple(to if one == name else one for one in request.points)
    if request == default_request(request.kind, request.points):
        return default_request(request.kind, points)
    return replace(request, points=points)


def default_request(kind: str, points: tuple[str, ...]) -> Request:
    """Return a request with the name that it has if nobody gives one."""
    name = points[0] if kind == 'point' else ' '.join((kind, *points))
    return Request(kind, points, name)


def _signature(path: Path) -> tuple[int, int, int] | None:
    """Return what changes when a file is replaced; None if there is none."""
    try:
        found: os.stat_result = path.stat()
    except FileNotFoundError:
        return None
    except OSError as error:
        raise FileError(f'{path} cannot be read: {error.strerror}; choose another file') from error
    return found.st_ino, found.st_size, found.st_mtime_ns
