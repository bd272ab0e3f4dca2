# SPDX-License-Identifier: Apache-2.0
"""The messages between a page and its view: JSON, one action or one state each."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from binocular_recon.errors import BinocularReconError, ConfigError, MeasurementError, shortened
from binocular_recon.io.text_files import number, whole_number
from binocular_recon.measurement.kinds import KINDS
from binocular_recon.measurement.picks import Pick, Request, holds_requests
from binocular_recon.measurement.results import Measurement
from binocular_recon.stereo.point_covariance import sigma_shares
from binocular_recon.viewer.coloured_frame import COLOURS
from binocular_recon.viewer.picks_board import default_request
from binocular_recon.viewer.shared_view import SharedView

LONGEST_MESSAGE = 10_000
Fields = Mapping[str, Any]


def answer(view: SharedView, message: str | bytes) -> str:
    """Do what a page asks for.

    Parameters
    ----------
    view : SharedView
    message : str
        JSON: ``do``, a key of `ACTIONS`, ``id``, which the answer repeats, and the fields of
        the action.

    Returns
    -------
    str
        JSON: ``id``, and ``done`` or ``error``, a sentence.

    """
    found: dict[str, Any] = {'id': None}
    try:
        fields = _fields(message)
        found['id'] = fields.get('id')
        action = ACTIONS.get(str(fields.get('do')))
        if action is None:
            raise ConfigError(f'there is no action {shortened(fields.get("do"))}')
        found['done'] = action(view, fields)
    except BinocularReconError as error:
        found['error'] = str(error)
    return json.dumps(found)


def state_of(view: SharedView) -> str:
    """Return all that a page shows, but for the images, as JSON under ``state``."""
    with view.held():
        return json.dumps({'state': _state(view)}, allow_nan=False)


def _fields(message: str | bytes) -> Fields:
    if len(message) > LONGEST_MESSAGE:
        raise ConfigError(f'a message may have {LONGEST_MESSAGE} characters, not {len(message)}')
    try:
        fields = json.loads(message)
    except (ValueError, RecursionError) as error:
        raise ConfigError('a message must be JSON') from error
    if not isinstance(fields, dict):
        raise ConfigError('a message must be a mapping')
    return fields


def _pixel(fields: Fields) -> tuple[float, float]:
    u, v = (number(name, fields.get(name), ConfigError) for name in 'uv')
    return u, v


def _show(view: SharedView, fields: Fields) -> None:
    changes: dict[str, Any] = {}
    if 'frame' in fields:
        changes['frame'] = whole_number('frame', fields['frame'], ConfigError)
    if 'colour' in fields:
        changes['colour'] = str(fields['colour'])
    for name, none in (('near_m', 0.0), ('far_m', math.inf)):
        if name in fields:
            given = fields[name]
            changes[name] = none if given is None else number(name, given, ConfigError)
    view.show(**changes)


def _probe(view: SharedView, fields: Fields) -> dict[str, str]:
    try:
        return {'text': _text(view.probe(*_pixel(fields)))}
    except MeasurementError as error:
        return {'problem': str(error)}


# What a page may ask for.
ACTIONS: dict[str, Callable[[SharedView, Fields], object]] = {
    'click': lambda view, fields: view.click(*_pixel(fields), both=fields.get('both') is True),
    'click_right': lambda view, fields: view.click_right(*_pixel(fields)),
    'await_right': lambda view, fields: view.await_right(str(fields.get('name'))),
    'take': lambda view, fields: view.take(str(fields.get('name'))),
    'finish': lambda view, _: view.finish(),
    'cancel': lambda view, _: view.cancel(),
    'kind': lambda view, fields: view.set_kind(str(fields.get('kind'))),
    'delete_pick': lambda view, fields: view.delete_pick(str(fields.get('name'))),
    'delete_measurement': lambda view, fields: view.delete_measurement(
        whole_number('number', fields.get('number'), ConfigError)
    ),
    'rename': lambda view, fields: view.rename(str(fields.get('name')), str(fields.get('to'))),
    'undo': lambda view, _: view.undo(),
    'redo': lambda view, _: view.redo(),
    'show': _show,
    'probe': _probe,
}


def _state(view: SharedView) -> dict[str, Any]:
    board, shown, displayed = view.board, view.shown, view.displayed
    depths = view.frame.points_xyz[..., 2]
    depths = depths[np.isfinite(depths)]
    width, height = view.frame.size
    calibrated = view.frame.rig.covariance is not None
    has_right = view.folder.has_right(shown.frame) and not view.frame.rig.turns
    return {
        'revision': view.revision,
        'folder': str(view.folder.folder.resolve()),
        'frames': view.folder.count,
        'file': str(board.path),
        'keeps_measurements': holds_requests(board.path),
        'can_undo': board.can_undo,
        'can_redo': board.can_redo,
        'kinds': {
            name: {'least': kind.least, 'most': kind.most, 'text': kind.text}
            for name, kind in KINDS.items()
        },
        'kind': view.kind,
        'chosen': board.marks.chosen,
        'awaited': None if view.awaited is None else _pick(view.awaited),
        'colours': {name: colour.text for name, colour in COLOURS.items()},
        'shown': {
            'frame': shown.frame,
            'colour': shown.colour,
            'near_m': shown.near_m,
            'far_m': None if math.isinf(shown.far_m) else shown.far_m,
            'left': f'left.png?{view.image_revision}',
            'right': f'right.png?{view.image_revision}' if has_right else None,
            'size': [width, height],
            'depth_m': [float(depths.min()), float(depths.max())] if depths.size else None,
            'legend': displayed.legend._asdict(),
            'points': len(displayed.cloud[0]),
            'points_of': displayed.count,
            'step': displayed.step,
        },
        'sigma': sigma_shares(calibrated),
        'picks': [
            {
                **_pick(pick),
                **_measurement(view, default_request('point', (pick.name,))),
            }
            for pick in board.marks.picks.values()
        ],
        'measurements': [
            {
                'name': one.name,
                'kind': one.kind,
                'points': one.points,
                **_measurement(view, one),
            }
            for one in board.marks.requests
        ],
    }


def _pick(pick: Pick) -> dict[str, Any]:
    """Return where a pick is: its pixels of the left and, if it is known, the right image."""
    right = None if pick.right is None else pick.right.tolist()
    return {
        'name': pick.name, 'frame': pick.frame, 'left': pick.pixel.tolist(), 'right': right
    }  # fmt: skip


def _measurement(view: SharedView, request: Request) -> dict[str, Any]:
    try:
        found = view.measured(request)
    except MeasurementError as error:
        return {'problem': str(error)}
    return {
        'label': found.label,
        'text': _text(found),
        'frame': found.frame,
        'closed': found.closed,
        'quantities': [
            {'what': what, 'text': str(one), 'from': one.main_source}
            for what, one in found.quantities.items()
        ],
    }


def _text(found: Measurement) -> str:
    return ', '.join(f'{what} {one}' for what, one in found.quantities.items())
