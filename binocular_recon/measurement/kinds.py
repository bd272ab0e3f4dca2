# SPDX-License-Identifier: Apache-2.0
"""What can be measured: one entry of `KINDS` per kind.

To add a kind, write a function that takes the session and the names of the picks and returns a
`Measurement`, and add an entry; the command line, picks files and the documentation take it from
there.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from binocular_recon.camera import FloatArray
from binocular_recon.errors import MeasurementError
from binocular_recon.measurement.faces import measure_plane, measure_section
from binocular_recon.measurement.picks import Request
from binocular_recon.measurement.planes import height_above
from binocular_recon.measurement.results import Measurement, Quantity, quantities
from binocular_recon.measurement.session import MeasuringSession
from binocular_recon.measurement.uncertain import Uncertain, joined, propagate
from binocular_recon.number_text import counted

Names = tuple[str, ...]
# Points closer than this are one, m.
_SAME_M = 1e-6


class Kind(NamedTuple):
    """A kind of measurement.

    Attributes
    ----------
    least, most : int
        Fewest and most picks; 0 = any number.
    text : str
        What it is.
    measure : callable
        How it is made.
    located : bool
        Whether each pick shows a point by itself, so that one on a hole is of no use.

    """

    least: int
    most: int
    text: str
    measure: Callable[[MeasuringSession, Names], Measurement]
    located: bool = True


def measure(session: MeasuringSession, request: Request) -> Measurement:
    """Return what is asked for.

    Raises
    ------
    MeasurementError
        If the kind is unknown, picks are missing or too many, or they cannot be measured.

    """
    kind = KINDS.get(request.kind)
    if kind is None:
        raise MeasurementError(
            f'{request.kind!r} is no kind of measurement; kinds are {", ".join(KINDS)}'
        )
    count = len(request.points)
    if count < kind.least or (kind.most and count > kind.most):
        needed = counted(kind.least, 'pick')
        if kind.most != kind.least:
            needed = f'at least {needed}'
        raise MeasurementError(f'{request.kind} needs {needed}, got {count}')
    repeated = next((n for n in request.points if request.points.count(n) > 1), None)
    if repeated is not None:
        raise MeasurementError(f'{request.name} names the pick {repeated} twice')
    for name in request.points:
        session.pick(name)
    return replace(kind.measure(session, request.points), name=request.name)


def _result(
    session: MeasuringSession,
    kind: str,
    names: Names,
    found: dict[str, Quantity],
    *,
    closed: bool = False,
) -> Measurement:
    frame = session.pick(names[0]).frame
    here = [session.pick(name).pixel for name in names if session.pick(name).frame == frame]
    return Measurement(kind, kind, names, found, np.array(here), frame, closed)


def _one(found: Uncertain, unit: str = 'm') -> Quantity:
    return quantities(found, unit)[0]


def _point(session: MeasuringSession, names: Names) -> Measurement:
    point = session.point(names[0])
    axes = dict(zip(('x', 'y', 'z'), quantities(point), strict=True))
    if session.site is not None:
        frame = session.frame(session.pick(names[0]).frame)
        tied = quantities(session.site.to_site(point, frame))
        axes = {**dict(zip(session.site.names, tied, strict=True)), **axes}
    return _result(session, 'point', names, axes)


def _ends(session: MeasuringSession, names: Names) -> Uncertain:
    """Return points one after the other, (3 n,), in one frame of the rig."""
    points = joined(*(session.point(name) for name in names))
    places = zip(names, points.values.reshape(-1, 3), strict=True)
    for (first, here), (last, there) in itertools.pairwise(places):
        if np.linalg.norm(here - there) < _SAME_M:
            raise MeasurementError(f'{first} and {last} are the same point')
    return points


def _distance(session: MeasuringSession, names: Names) -> Measurement:
    found = propagate(_length, _ends(session, names))
    return _result(session, 'distance', names, {'length': _one(found)})


def _length(points: FloatArray) -> float:
    """Return the length of a line through points (3 n,)."""
    return float(np.linalg.norm(np.diff(points.reshape(-1, 3), axis=0), axis=1).sum())


def _horizontal(session: MeasuringSession, names: Names) -> Measurement:
    source, up_of = session.up(session.number(names))

    def across(ends: FloatArray, values: FloatArray) -> float:
        step, up = ends[3:] - ends[:3], up_of(values)
        return float(np.linalg.norm(step - (step @ up) * up))

    found = propagate(across, _ends(session, names), source)
    return _result(session, 'horizontal', names, {'length': _one(found)})


def _vertical(session: MeasuringSession, names: Names) -> Measurement:
    source, up_of = session.up(session.number(names))
    found = propagate(
        lambda ends, values: (ends[3:] - ends[:3]) @ up_of(values), _ends(session, names), source
    )
    return _result(session, 'vertical', names, {'height': _one(found)})


def _above_ground(session: MeasuringSession, names: Names) -> Measurement:
    support = session.ground(session.number(names)).support
    found = propagate(
        lambda point, ground: height_above(ground, point), session.point(names[0]), support
    )
    return _result(session, 'height', names, {'height': _one(found)})


def _upright(session: MeasuringSession, names: Names) -> Measurement:
    ruler = session.ruler(session.number(names))
    top, sole = (session.pick(name) for name in names)
    return _result(
        session,
        'upright',
        names,
        {
            'height': _one(ruler.height(top, sole)),
            'above_ground': _one(ruler.height_above_ground(top, sole)),
        },
    )


def _wheelbase(session: MeasuringSession, names: Names) -> Measurement:
    ruler = session.ruler(session.number(names))
    found = ruler.wheelbase(*(session.pick(name) for name in names))
    return _result(session, 'wheelbase', names, {'length': _one(found)})


def _angle(session: MeasuringSession, names: Names) -> Measurement:
    def degrees(points: FloatArray) -> float:
        first, corner, last = points.reshape(3, 3)
        a, b = first - corner, last - corner
        return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b)))

    found = propagate(degrees, _ends(session, names))
    return _result(session, 'angle', names, {'angle': _one(found, 'deg')})


def _polyline(session: MeasuringSession, names: Names) -> Measurement:
    points = _ends(session, names)
    found = {'length': _one(propagate(_length, points))}
    for i, (first, last) in enumerate(itertools.pairwise(names)):
        leg = propagate(lambda all_, i=i: _length(all_[3 * i : 3 * i + 6]), points)
        found[f'{first}-{last}'] = _one(leg)
    return _result(session, 'polyline', names, found)


def _area(session: MeasuringSession, names: Names) -> Measurement:
    def area(points: FloatArray) -> float:
        corners = points.reshape(-1, 3)
        corners = corners - corners.mean(axis=0)
        return float(np.linalg.norm(np.cross(corners, np.roll(corners, -1, axis=0)).sum(0)) / 2)

    points = _ends(session, names)
    if area(points.values) < _SAME_M:
        raise MeasurementError(f'{", ".join(names)} lie on one line and enclose no area')

    def around(points: FloatArray) -> float:
        return _length(np.concatenate([points, points[:3]]))

    found = {
        'area': _one(propagate(area, points), 'm2'),
        'perimeter': _one(propagate(around, points)),
    }
    return _result(session, 'area', names, found, closed=True)


# Every kind of measurement, by the name that files and the command line use.
KINDS = {
    'point': Kind(1, 1, 'coordinates of a point', _point),
    'distance': Kind(2, 2, '3-D distance of two points', _distance),
    'horizontal': Kind(2, 2, 'horizontal distance of two points', _horizontal),
    'vertical': Kind(2, 2, 'how much higher the second point is', _vertical),
    'height': Kind(1, 1, 'height of a point above the ground plane', _above_ground),
    'upright': Kind(
        2, 2, 'height of a standing person or post: top, foot', _upright, located=False
    ),
    'wheelbase': Kind(
        2, 2, 'distance of hubs in an upright plane: rear, front', _wheelbase, located=False
    ),
    'angle': Kind(3, 3, 'angle at the second of three points', _angle),
    'polyline': Kind(2, 0, 'length of a line through points, and of its legs', _polyline),
    'area': Kind(3, 0, 'area and perimeter of a polygon', _area),
    'plane': Kind(
        3, 0, 'flatness and slope of the cloud within a polygon', measure_plane, located=False
    ),
    'section': Kind(
        2, 2, 'cross-section of the cloud between two points', measure_section, located=False
    ),
}
