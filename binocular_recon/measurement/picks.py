# SPDX-License-Identifier: Apache-2.0
"""Picked pixels by name, and the files that hold them.

A table (CSV) has the columns ``name``, ``frame``, ``u``, ``v`` and, where the point was picked in
the right image too, ``u_right``, ``v_right``: pixels of the rectified images, pixel centres at
whole numbers. A YAML file has the same under ``picks``, a list of mappings, and may list what is
measured between them under ``measurements``: ``name``, ``kind`` and ``points``.
"""

from __future__ import annotations

import csv
import io
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from binocular_recon.camera import FloatArray
from binocular_recon.errors import MeasurementError, shortened
from binocular_recon.io.files import complete_file
from binocular_recon.io.text_files import number, read_text, read_yaml, whole_number

COLUMNS = ('name', 'frame', 'u', 'v', 'u_right', 'v_right')
_FORMAT = 'the columns are name,frame,u,v and, if picked in the right image too, u_right,v_right'
_LARGEST, _MOST_PICKS = 2_000_000, 10_000


@dataclass(frozen=True, eq=False)
class Pick:
    """A picked pixel.

    Attributes
    ----------
    name : str
    pixel : (2,) float64
        Column and row in the rectified left image, px.
    right : (2,) float64, optional
        The same point in the rectified right image, px.
    frame : int
        Number of the frame.

    """

    name: str
    pixel: FloatArray
    right: FloatArray | None = None
    frame: int = 0


@dataclass(frozen=True)
class Request:
    """What to measure between which picks.

    Attributes
    ----------
    kind : str
        A key of `KINDS`.
    points : tuple of str
        Names of the picks, in order.
    name : str
        What the result is called.

    """

    kind: str
    points: tuple[str, ...]
    name: str

    @classmethod
    def of(cls, text: str) -> Request:
        """Return the request of a text such as ``distance A B``."""
        words = text.split()
        if not words:
            raise MeasurementError('a measurement is its kind and picks, such as: distance A B')
        return cls(words[0], tuple(words[1:]), ' '.join(words))


def read_picks(path: Path, *, may_be_empty: bool = False) -> tuple[dict[str, Pick], list[Request]]:
    """Read picks, by name, and what is to be measured between them.

    Raises
    ------
    FileError
        If the file cannot be read.
    MeasurementError
        If a value is missing or wrong, or a name appears twice; the message names the place.

    """
    if holds_requests(path):
        content = read_yaml(path, f'give picks; {_FORMAT}')
        rows, requests = _yaml_rows(path, content)
    else:
        rows, requests = table_rows(path, COLUMNS[:4]), []
    picks = [pick_of(row, where) for where, row in rows]
    counts = Counter(pick.name for pick in picks)
    twice = next((name for name, count in counts.items() if count > 1), None)
    if twice is not None:
        raise MeasurementError(f'{path}: {shortened(twice)} is picked twice; rename one')
    if not picks and not may_be_empty:
        raise MeasurementError(f'{path} holds no picks; {_FORMAT}')
    return {pick.name: pick for pick in picks}, requests


def holds_requests(path: Path) -> bool:
    """Return whether a picks file of this name holds what is measured too: YAML, not a table."""
    return path.suffix.lower() in {'.yaml', '.yml'}


def write_picks(path: Path, picks: Iterable[Pick], requests: Iterable[Request] = ()) -> None:
    """Write picks as a table, or as YAML with what is to be measured, by the name of the file.

    Raises a FileError if it cannot be written.
    """
    rows = list(picks)
    if holds_requests(path):
        content = {
            'picks': [_entry(pick) for pick in rows],
            'measurements': [
                {'name': one.name, 'kind': one.kind, 'points': list(one.points)}
                for one in requests
            ],
        }
        text = yaml.safe_dump(content, sort_keys=False, allow_unicode=True, width=1000)
        with complete_file(path) as file:
            file.write(text.encode())
        return
    both = any(pick.right is not None for pick in rows)
    table = []
    for pick in rows:
        pixels = pick.pixel.tolist()
        if both:
            pixels += ['', ''] if pick.right is None else pick.right.tolist()
        table.append([pick.name, pick.frame, *pixels])
    write_table(path, COLUMNS if both else COLUMNS[:4], table)


def _entry(pick: Pick) -> dict[str, Any]:
    pixels = [*pick.pixel.tolist(), *([] if pick.right is None else pick.right.tolist())]
    return dict(zip(COLUMNS, [pick.name, pick.frame, *pixels], strict=False))


def table_rows(path: Path, columns: Sequence[str]) -> list[tuple[str, dict[str, str]]]:
    """Return the rows of a table with at least some columns, each with where it stands.

    Raises
    ------
    FileError
        If the file cannot be read.
    MeasurementError
        If a column is missing, or there are too many rows.

    """
    text = read_text(path, 'give a table with the columns ' + ','.join(columns), _LARGEST)
    reader = csv.DictReader(io.StringIO(text, newline=''), skipinitialspace=True)
    try:
        names = [name.strip() for name in reader.fieldnames or ()]
        reader.fieldnames = names
        missing = [name for name in columns if name not in names]
        if missing and any(';' in name for name in names):
            raise MeasurementError(
                f'{path} has semicolons between its columns; save it with commas between them and'
                f' points in numbers: {",".join(columns)}'
            )
        if missing:
            raise MeasurementError(
                f'{path} lacks the columns {", ".join(missing)}; its first line must name'
                f' {",".join(columns)}'
            )
        rows: list[tuple[str, dict[str, str]]] = []
        for row in reader:
            if len(rows) == _MOST_PICKS:
                raise MeasurementError(f'{path} has more than {_MOST_PICKS} rows, the limit')
            filled = {k: v.strip() for k, v in row.items() if isinstance(v, str) and v.strip()}
            if filled:
                rows.append((f'{path}, line {reader.line_num}', filled))
    except csv.Error as error:
        raise MeasurementError(f'{path} is not a table: {error}; use commas') from error
    return rows


def write_table(path: Path, columns: Sequence[str], rows: Iterable[Iterable[object]]) -> None:
    """Write a table with a first line that names its columns.

    Raises a FileError if it cannot be written.
    """
    text = io.StringIO(newline='')
    writer = csv.writer(text, lineterminator='\n')
    writer.writerow(columns)
    writer.writerows(rows)
    with complete_file(path) as file:
        file.write(text.getvalue().encode())


def pick_of(row: Mapping[str, Any], where: str) -> Pick:
    """Return the pick of a row of a file; raises a MeasurementError that begins with ``where``."""

    def read(name: str) -> float:
        return number(f'{where}: {name}', row.get(name), MeasurementError)

    name = row.get('name')
    if not isinstance(name, (str, int)) or isinstance(name, bool) or not str(name).strip():
        raise MeasurementError(f'{where}: name must be a name, got {shortened(name)}')
    frame = whole_number(f'{where}: frame', row.get('frame', 0), MeasurementError)
    right = None
    if 'u_right' in row or 'v_right' in row:
        right = np.array([read('u_right'), read('v_right')])
    return Pick(str(name).strip(), np.array([read('u'), read('v')]), right, frame)


def _yaml_rows(path: Path, content: Any) -> tuple[list[tuple[str, Any]], list[Request]]:
    if not isinstance(content, dict) or not isinstance(content.get('picks'), list):
        raise MeasurementError(
            f'{path} must have a list under picks: name, frame, u and v of each'
        )
    parts = {key: content.get(key) or [] for key in ('picks', 'measurements')}
    for key, entries in parts.items():
        if not isinstance(entries, list) or not all(isinstance(one, dict) for one in entries):
            raise MeasurementError(f'{path}: {key} must be a list of mappings')
    rows = [(f'{path}, pick {i}', row) for i, row in enumerate(parts['picks'], 1)]
    requests = [
        _request(row, f'{path}, measurement {i}') for i, row in enumerate(parts['measurements'], 1)
    ]
    return rows, requests


def _request(row: Mapping[str, Any], where: str) -> Request:
    kind, points = row.get('kind'), row.get('points')
    if not isinstance(kind, str) or not isinstance(points, list):
        raise MeasurementError(f'{where}: kind must be a name and points a list of picks')
    names = tuple(str(point) for point in points)
    return Request(kind, names, str(row.get('name') or ' '.join((kind, *names))))
