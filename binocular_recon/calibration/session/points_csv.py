# SPDX-License-Identifier: Apache-2.0
"""Marks that another detector found: a table of points (chessboards, circles, ChArUco ...).

Columns: ``name`` (of the board), ``side`` (``left`` or ``right``), ``id`` (of the point),
``X_m``, ``Y_m`` (its place on the flat target, metres) and ``u_px``, ``v_px`` (its image, pixel
centres at integers).
"""

from __future__ import annotations

import csv
import io
import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from binocular_recon.calibration.target.capture import Capture
from binocular_recon.calibration.target.target import Target
from binocular_recon.errors import CalibrationError, FileError, plain_text, shortened
from binocular_recon.io.text_files import read_text
from binocular_recon.number_text import counted

COLUMNS = ('name', 'side', 'id', 'X_m', 'Y_m', 'u_px', 'v_px')
# Usual sizes of sensors, from small to large, to guess the image's size from its points.
_SIZES = (
    (320, 240), (640, 480), (752, 480), (800, 600), (1024, 768), (1280, 720), (1280, 800),
    (1280, 960), (1280, 1024), (1440, 1080), (1600, 1200), (1920, 1080), (1920, 1200),
    (2048, 1536), (2448, 2048), (2592, 1944), (3840, 2160), (4096, 3000), (5472, 3648),
    (8192, 8192),
)  # fmt: skip


# Largest file, and most boards times points of the target: marks not found take room too.
_LARGEST, _MOST_ROWS, _MOST_MARKS = 20_000_000, 150_000, 2_000_000
# Calibration targets are smaller, m; places that differ by less are one.
_LARGEST_TARGET_M, _SAME_M = 100.0, 1e-6


@dataclass(frozen=True, eq=False)
class PointTable:
    """The content of a table of points.

    Attributes
    ----------
    captures : tuple of Capture
        Marks of each board, (N, 1, 2) px per side.
    target : Target
        The points' places.
    least_size : (int, int)
        Smallest usual image size, px, that holds all points.
    left_out : tuple of str
        Rows without numbers, and what is wrong with each.

    """

    captures: tuple[Capture, ...]
    target: Target
    least_size: tuple[int, int]
    left_out: tuple[str, ...]


def read_points(path: Path) -> PointTable:
    """Read a table of points.

    Raises
    ------
    FileError
        If the file cannot be read.
    CalibrationError
        If a column is missing or a row contradicts another one; the message names file and line.

    """
    text = read_text(path, 'give a table of points', _LARGEST)
    try:
        reader = csv.reader(io.StringIO(text, newline=''))
        columns = _columns(path, next(reader, []))
        rows: list[_Row | str] = []
        for count, values in enumerate(reader):
            if count == _MOST_ROWS:
                raise CalibrationError(
                    f'{path} has more than {_MOST_ROWS} rows, the limit; use fewer boards'
                )
            if values:
                rows.append(_row(values, columns, f'{path}, line {reader.line_num}'))
    except csv.Error as error:
        raise FileError(f'{path} cannot be read: {error}; give a table of points') from error
    left_out = tuple(row for row in rows if isinstance(row, str))
    points = [row for row in rows if not isinstance(row, str)]
    if not points:
        raise CalibrationError(f'{path} holds no points; {left_out[0] if left_out else "fill it"}')
    return _table(points, left_out)


class _Columns(NamedTuple):
    """How many columns there are, and where each of `COLUMNS` is."""

    width: int
    places: tuple[int, ...]


def _columns(path: Path, names: Sequence[str]) -> _Columns:
    """Return the columns; raises a CalibrationError unless the first line names each once."""
    counts = Counter(names)
    for problem, wrong in (
        ('lacks the columns', [name for name in COLUMNS if not counts[name]]),
        ('has several columns', [name for name in COLUMNS if counts[name] > 1]),
    ):
        if wrong:
            raise CalibrationError(
                f'{path} {problem} {", ".join(wrong)}; its first line must name'
                f' {", ".join(COLUMNS)}'
            )
    return _Columns(len(names), tuple(names.index(name) for name in COLUMNS))


class _Row(NamedTuple):
    where: str
    name: str
    side: str
    point: str
    place: tuple[float, float]
    pixel: tuple[float, float]


def _row(values: list[str], columns: _Columns, where: str) -> _Row | str:
    """Return a row, or why it is left out."""
    if len(values) > columns.width:
        return f'{where}: there are more values than columns'
    values += [''] * (columns.width - len(values))
    name, side, point, *numbers = (values[place] for place in columns.places)
    if side not in {'left', 'right'}:
        raise CalibrationError(f'{where}: side must be left or right, got {shortened(side)}')
    if not name or not point:
        return f'{where}: name or id is missing'
    try:
        X, Y, u, v = map(float, numbers)
    except ValueError:
        X = Y = u = v = math.nan
    if not math.isfinite(X + Y + u + v):
        return f'{where}: {", ".join(COLUMNS[3:])} must be numbers; leave out points not found'
    if max(abs(X), abs(Y)) > _LARGEST_TARGET_M:
        raise CalibrationError(
            f'{where}: X_m and Y_m must be within {_LARGEST_TARGET_M:g} m, got {X:g} and {Y:g};'
            ' they are in metres'
        )
    if min(u, v) < -0.5:
        raise CalibrationError(
            f'{where}: u_px and v_px must be in the image, got {u:g} and {v:g}; they are in pixels'
        )
    return _Row(where, name, side, point, (X, Y), (u, v))


def _table(rows: list[_Row], left_out: tuple[str, ...]) -> PointTable:
    places: dict[str, tuple[float, float]] = {}
    for row in rows:
        place = places.setdefault(row.point, row.place)
        if math.dist(place, row.place) > _SAME_M:
            raise CalibrationError(
                f'{row.where}: point {shortened(row.point)} lies at {row.place} m, elsewhere at'
                f' {place} m; all boards must be the same target'
            )
    index = {point: i for i, point in enumerate(places)}
    names = dict.fromkeys(row.name for row in rows)
    if len(names) * len(index) > _MOST_MARKS:
        raise CalibrationError(
            f'{rows[0].where}: {counted(len(names), "board")} of a target with'
            f' {counted(len(index), "point")} are more than {_MOST_MARKS} marks, the limit; id'
            ' must be that of the point on the target, the same on all boards'
        )
    boards = {
        name: {side: np.full((len(index), 1, 2), np.nan) for side in ('left', 'right')}
        for name in names
    }
    for row in rows:
        marks = boards[row.name][row.side]
        if not np.isnan(marks[index[row.point], 0, 0]):
            raise CalibrationError(
                f'{row.where}: point {shortened(row.point)} appears twice in the {row.side} image'
                f' of {plain_text(row.name)}'
            )
        marks[index[row.point], 0] = row.pixel
    extent = np.max([row.pixel for row in rows], axis=0) + 0.5
    fitting = [size for size in _SIZES if (extent <= size).all()]
    if not fitting:
        raise CalibrationError(f'points reach to {extent} px; u_px and v_px must be in pixels')
    points = np.array([(*place, 0.0) for place in places.values()])
    return PointTable(
        captures=tuple(
            Capture(name, **{f'{s}_px': px for s, px in sides.items()})
            for name, sides in boards.items()
        ),
        target=Target.from_points(points),
        left_out=left_out,
        least_size=min(fitting, key=lambda size: size[0] * size[1]),
    )
