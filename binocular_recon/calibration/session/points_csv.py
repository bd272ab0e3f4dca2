# SPDX-License-Identifier: Apache-2.0
"""Marks that another detector found: a table of points (chessboards, circles, ChArUco ...).

Columns: ``name`` (of the board), ``side`` (``left`` or ``right``), ``id`` (of the point),
``X_m``, ``Y_m`` (its place on the flat target, metres) and ``u_px``, ``v_px`` (its image, pixel
centres at integers).
"""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from binocular_recon.calibration.target.capture import Capture
from binocular_recon.calibration.target.target import Target
from binocular_recon.errors import CalibrationError, FileError

COLUMNS = ('name', 'side', 'id', 'X_m', 'Y_m', 'u_px', 'v_px')
# Usual sizes of sensors, from small to large, to guess the image's size from its points.
_SIZES = (
    (320, 240), (640, 480), (752, 480), (800, 600), (1024, 768), (1280, 720), (1280, 800),
    (1280, 960), (1280, 1024), (1440, 1080), (1600, 1200), (1920, 1080), (1920, 1200),
    (2048, 1536), (2448, 2048), (2592, 1944), (3840, 2160), (4096, 3000), (5472, 3648),
    (8192, 8192),
)  # fmt: skip


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
    try:
        with path.open(newline='', encoding='utf-8-sig') as file:
            reader = csv.DictReader(file)
            missing = [name for name in COLUMNS if name not in (reader.fieldnames or ())]
            if missing:
                raise CalibrationError(
                    f'{path} lacks the columns {", ".join(missing)}; its first line must name'
                    f' {", ".join(COLUMNS)}'
                )
            rows = [_row(row, f'{path}, line {reader.line_num}') for row in reader]
        left_out = tuple(row for row in rows if isinstance(row, str))
        points = [row for row in rows if not isinstance(row, str)]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        reason = getattr(error, 'strerror', None) or error
        raise FileError(f'{path} cannot be read: {reason}; give a table of points') from error
    if not points:
        raise CalibrationError(f'{path} holds no points; {left_out[0] if left_out else "fill it"}')
    return _table(points, left_out)


@dataclass(frozen=True)
class _Row:
    where: str
    name: str
    side: str
    point: str
    place: tuple[float, float]
    pixel: tuple[float, float]


def _row(row: dict[str, str], where: str) -> _Row | str:
    """Return a row, or why it is left out."""
    if row['side'] not in {'left', 'right'}:
        raise CalibrationError(f'{where}: side must be left or right, got {row["side"]!r}')
    try:
        numbers = [float(row[name]) for name in COLUMNS[3:]]
    except (TypeError, ValueError):
        numbers = [np.nan]
    if not np.isfinite(numbers).all():
        return f'{where}: {", ".join(COLUMNS[3:])} must be numbers; leave out points not found'
    X, Y, u, v = numbers
    return _Row(where, row['name'], row['side'], row['id'], (X, Y), (u, v))


def _table(rows: list[_Row], left_out: tuple[str, ...]) -> PointTable:
    places: dict[str, tuple[float, float]] = {}
    for row in rows:
        if not np.allclose(places.setdefault(row.point, row.place), row.place, atol=1e-6):
            raise CalibrationError(
                f'{row.where}: point {row.point} lies at {row.place} m, elsewhere at'
                f' {places[row.point]} m; all boards must be the same target'
            )
    index = {point: i for i, point in enumerate(places)}
    boards: dict[str, dict[str, np.ndarray]] = {}
    for row in rows:
        empty = {side: np.full((len(index), 1, 2), np.nan) for side in ('left', 'right')}
        marks = boards.setdefault(row.name, empty)[row.side]
        if np.isfinite(marks[index[row.point]]).all():
            raise CalibrationError(
                f'{row.where}: point {row.point} appears twice in the {row.side} image of'
                f' {row.name}'
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
