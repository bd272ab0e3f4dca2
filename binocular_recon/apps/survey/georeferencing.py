# SPDX-License-Identifier: Apache-2.0
"""Tie an output folder to control points, or level it: ``georeference.json``."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from binocular_recon.apps.survey.measured_folder import MeasuredFolder
from binocular_recon.apps.survey.measuring import open_session
from binocular_recon.errors import MeasurementError
from binocular_recon.io.files import write_json
from binocular_recon.measurement.picks import Pick
from binocular_recon.measurement.session import MeasuringSession
from binocular_recon.measurement.site.adjustment import Adjustment, adjust
from binocular_recon.measurement.site.control_points import ControlPoint
from binocular_recon.measurement.site.fitting import PointError
from binocular_recon.measurement.site.levelling import level_by_ground, level_by_uprights
from binocular_recon.measurement.site.reference_systems import ReferenceSystem, reference_system
from binocular_recon.measurement.site.tie import TIE_FILE, SiteTie
from binocular_recon.number_text import fixed


def tie_folder(
    folder: MeasuredFolder,
    control: Sequence[ControlPoint],
    *,
    epsg: int | None = None,
    free_scale: bool = False,
    pick_sigma_px: float,
) -> tuple[Adjustment, str]:
    """Tie the rig of a folder to control points and write ``georeference.json``.

    Returns the result, and a text for a person.

    Raises
    ------
    MeasurementError
        If the control points do not suffice or contradict each other.
    DependencyError
        If ``epsg`` needs a package that is not installed.

    """
    if not control:
        raise MeasurementError('there are no control points; give the places of three or more')
    session = open_session(folder, [one.pick for one in control], pick_sigma_px)
    places = np.stack([one.place for one in control])
    system = None if epsg is None else reference_system(epsg, places.mean(axis=0))
    points = [session.point(one.name) for one in control]
    frame = session.frame(control[0].pick.frame)
    found = adjust(
        points, control, frame, free_scale=free_scale, scale=system.scale if system else 1.0
    )
    facts = _facts(found, control, system)
    names = ('E', 'N', 'H') if system else ('X', 'Y', 'Z')
    tie = dataclasses.replace(
        found.tie, names=names, epsg=system.epsg if system else None, facts=facts
    )
    write_json(folder.folder / TIE_FILE, tie.to_mapping())
    return dataclasses.replace(found, tie=tie), _text(found, system)


def level_folder(
    folder: MeasuredFolder,
    by: str,
    picks: Mapping[str, Pick],
    *,
    number: int = 0,
    pick_sigma_px: float,
) -> tuple[SiteTie, str]:
    """Level the rig of a folder by the ground, rods or plumb lines; write ``georeference.json``.

    ``by`` is ``ground``, or a key of `TILT_SIGMA_RAD`: then the picks are the ends of upright
    things, one pair after the other. Returns the frame, and a text for a person.

    Raises
    ------
    MeasurementError
        If the ground is not seen, or the picks are not those of something upright.

    """
    if by == 'ground':
        tie = level_by_ground(folder.frame(number))
    else:
        if not picks or len(picks) % 2:
            raise MeasurementError(
                f'{by} need pairs of picks, but there are {len(picks)}; pick both ends of each'
                ' upright thing, one after the other'
            )
        session = open_session(folder, list(picks.values()), pick_sigma_px)
        tie = _by_uprights(session, list(picks), by)
    write_json(folder.folder / TIE_FILE, tie.to_mapping())
    down = np.degrees(np.arcsin(np.clip(-tie.R[2, 2], -1, 1)))
    roll = np.degrees(np.arctan2(tie.R[2, 0], -tie.R[2, 1]))
    text = (
        f'level by {tie.facts["level_by"]}, sigma {tie.facts["tilt_sigma_deg"]:.3f} degrees; the'
        f' left camera looks {down:.2f} degrees down and is rolled by {roll:.2f} degrees'
    )
    if by == 'ground':
        text += f', {tie.pivot_site[2]:.3f} m above the ground'
    return tie, text


def _by_uprights(session: MeasuringSession, names: Sequence[str], kind: str) -> SiteTie:
    ends = {
        f'{first} {last}': (session.point(first), session.point(last))
        for first, last in zip(names[::2], names[1::2], strict=True)
    }
    return level_by_uprights(session.frame(session.pick(names[0]).frame), ends, kind)


def _facts(
    found: Adjustment, control: Sequence[ControlPoint], system: ReferenceSystem | None
) -> dict[str, Any]:
    points = []
    for one in control:
        entry: dict[str, Any] = {'name': one.name, 'check': one.check, 'place': one.place.tolist()}
        for key, errors in (
            ('residual_m', found.residuals),
            ('left_out_m', found.left_out),
            ('error_m', found.checks),
        ):
            if one.name in errors:
                entry[key] = errors[one.name].off_m.tolist()
                entry[key.replace('_m', '_sigma_m')] = errors[one.name].sigma_m.tolist()
                entry[key.replace('_m', '_is_odd')] = errors[one.name].is_odd
        points.append(entry)
    facts: dict[str, Any] = {'points': points, 'crs': None, 'scale_estimated': None}
    if system is not None:
        facts['crs'] = dataclasses.asdict(system)
    if np.isfinite(found.scale_sigma):
        grid = 1.0 if system is None else system.scale
        facts['scale_estimated'] = {'value': found.scale / grid, 'sigma': found.scale_sigma / grid}
    return facts


def _text(found: Adjustment, system: ReferenceSystem | None) -> str:
    header = f'{"point":>12} {"":>9} {"dx mm":>8} {"dy mm":>8} {"dz mm":>8} {"off / sigma":>12}'
    lines = [header]
    for what, errors in (
        ('residual', found.residuals), ('left out', found.left_out), ('check', found.checks)
    ):  # fmt: skip
        lines += [_line(name, what, error) for name, error in errors.items()]
    if not found.left_out:
        lines.append('three control points cannot be left out one by one; a fourth checks them')
    lines += [
        f'warning: check point {name} is {np.linalg.norm(error.off_m):.3f} m from where the tie'
        ' puts it, more than its standard deviation explains; check its coordinates, name and'
        ' pick, and those of the control points'
        for name, error in found.checks.items()
        if error.is_odd
    ]
    if system is not None:
        lines.append(
            f'EPSG:{system.epsg} {system.name}: the site is at {system.place}; lengths on the map'
            f' are {1e6 * (system.scale - 1):+.0f} ppm of those on the ground, which is taken into'
            ' account'
        )
    if np.isfinite(found.scale_sigma):
        grid = 1.0 if system is None else system.scale
        off, sigma = found.scale / grid - 1, found.scale_sigma / grid
        verdict = 'agrees with' if abs(off) < 3 * sigma else 'contradicts'
        lines.append(
            f'scale {1 + off:.5f} +- {sigma:.5f}: {100 * off:+.3f} % from 1'
            f' ({abs(off) / sigma:.1f} sigma), which {verdict} the calibration'
        )
    return '\n'.join(lines)


def _line(name: str, what: str, error: PointError) -> str:
    values = ' '.join(f'{fixed(1e3 * value, 1):>8}' for value in error.off_m)
    ratio = np.sqrt(np.mean((error.off_m / np.maximum(error.sigma_m, 1e-9)) ** 2))
    return f'{name:>12} {what:>9} {values} {fixed(float(ratio), 2):>12}'
