# SPDX-License-Identifier: Apache-2.0
"""Control points: places that a survey gives, and check points beside them.

A table (CSV) with the columns ``name``, ``x``, ``y``, ``z``, metres, and on request ``sigma_x``,
``sigma_y``, ``sigma_z``, ``check`` (yes or no) and the pick: ``frame``, ``u``, ``v``,
``u_right``, ``v_right``; else the picks of the same names are in a file of their own.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from binocular_recon.camera import FloatArray
from binocular_recon.errors import MeasurementError, shortened
from binocular_recon.io.text_files import number
from binocular_recon.measurement.picks import Pick, pick_of, table_rows

COLUMNS = ('name', 'x', 'y', 'z')
# One standard deviation of coordinates that state none, m.
CONTROL_SIGMA_M = 0.005
_YES, _NO = {'1', 'yes', 'true', 'check', 'y'}, {'0', 'no', 'false', 'control', 'n', ''}


@dataclass(frozen=True, eq=False)
class ControlPoint:
    """A point whose place on the site is known.

    Attributes
    ----------
    name : str
    place : (3,) float64
        m, in the frame of the site.
    sigma_m : (3,) float64
        One standard deviation of each coordinate.
    pick : Pick
    check : bool
        Whether it only checks the result.

    """

    name: str
    place: FloatArray
    sigma_m: FloatArray
    pick: Pick
    check: bool = False


def read_control(
    path: Path, picks: Mapping[str, Pick] | None = None, sigma_m: float = CONTROL_SIGMA_M
) -> list[ControlPoint]:
    """Read control and check points.

    Parameters
    ----------
    path : Path
    picks : mapping of str to Pick, optional
        Picks by the name of the point, for rows without one.
    sigma_m : float
        One standard deviation where the table states none, m.

    Raises
    ------
    FileError
        If the file cannot be read.
    MeasurementError
        If a value is missing or wrong, a name appears twice, or a point is not picked.

    """
    found: dict[str, ControlPoint] = {}
    for where, row in table_rows(path, COLUMNS):
        point = _point(where, row, picks or {}, sigma_m)
        if point.name in found:
            raise MeasurementError(f'{where}: {shortened(point.name)} appears twice')
        found[point.name] = point
    return list(found.values())


def _point(
    where: str, row: Mapping[str, str], picks: Mapping[str, Pick], sigma_m: float
) -> ControlPoint:
    name = row.get('name', '')
    if not name:
        raise MeasurementError(f'{where}: the name is missing')
    place, sigma = np.empty(3), np.empty(3)
    for i, axis in enumerate('xyz'):
        place[i] = number(f'{where}: {axis}', row.get(axis), MeasurementError)
        sigma[i] = number(
            f'{where}: sigma_{axis}', row.get(f'sigma_{axis}', sigma_m), MeasurementError
        )
    if not (sigma > 0).all():
        raise MeasurementError(f'{where}: sigma_x, sigma_y and sigma_z must be above 0, metres')
    check = row.get('check', '').lower()
    if check not in _YES | _NO:
        raise MeasurementError(f'{where}: check must be yes or no, got {shortened(check)}')
    if 'u' in row:
        pick = pick_of({**row, 'name': name}, where)
    elif name in picks:
        pick = picks[name]
    else:
        raise MeasurementError(
            f'{where}: {shortened(name)} is not picked; add the columns frame,u,v, or a row of its'
            ' name to the file of --picks, or remove it'
        )
    return ControlPoint(name, place, sigma, pick, check in _YES)
