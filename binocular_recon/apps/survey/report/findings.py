# SPDX-License-Identifier: Apache-2.0
"""Sections about what was measured, and how the site is tied to control points."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from binocular_recon.apps.survey.report.images import cut_out, photo
from binocular_recon.apps.survey.report.sources import ReportSources, text
from binocular_recon.drawing.measurements import Drawn, draw_measurement
from binocular_recon.drawing.page import section, table
from binocular_recon.images import to_bgr8
from binocular_recon.measurement.results import Quantity
from binocular_recon.number_text import counted, fixed

# Measurements that are drawn; of more the first.
_MOST_IMAGES = 24
_CLOSED = {'area', 'plane'}
_KINDS = (('residual_m', 'residual'), ('left_out_m', 'left out'), ('error_m', 'check'))


def measurements(sources: ReportSources) -> str:
    """Return the section with everything that was measured, and the images of it."""
    content = sources.measurements
    if content is None:
        return section(
            'Measurements',
            sources.lacks('measurements', 'nothing was measured (binocular-recon measure)'),
        )
    rows = []
    for one in content['measurements']:
        for number, (what, quantity) in enumerate(quantities(one)):
            rows.append(
                (
                    text(one['name']) if number == 0 else '',
                    text(what),
                    f'{quantity}'.replace('+-', '±'),
                    text(max(quantity.shares, key=lambda k: quantity.shares[k], default='')),
                    text(', '.join(one['points'])) if number == 0 else '',
                )
            )
    drawn = [
        _drawn(sources, one, content['picks']) for one in content['measurements'][:_MOST_IMAGES]
    ]
    head = ('measurement', 'quantity', 'value ± sigma', 'mostly from', 'picks')
    return section(
        'Measurements',
        f'Each with one standard deviation of {text(content.get("sigma", "matching"))} and of'
        f' picks ({text(content.get("pick_sigma_px", "?"))} px), and what contributes most to it.',
        table(head, rows, kind='long wide left'),
        f'<div class="small">{"".join(drawn)}</div>',
    )


def _drawn(sources: ReportSources, one: Mapping[str, Any], picks: Mapping[str, Any]) -> str:
    """Return the figure of a measurement: the part of the left image around its picks."""
    path = sources.folder.folder / f'{one["frame"]:06d}_left.png'
    found = [quantity for _, quantity in quantities(one)]
    label = f'{found[0]}' if found and one['kind'] != 'point' else str(one['name'])
    caption = f'<b>{text(one["name"])}</b>: {text(label)}, frame {one["frame"]}'
    if not path.exists():
        return (
            f'<p>{caption}: {sources.lacks("image of a measurement", f"{path.name} is gone")}</p>'
        )
    places = [
        picks[name]['left_px'] for name in one['points'] if picks[name]['frame'] == one['frame']
    ]
    outline = np.array(places, np.float64)
    image, moved = cut_out(to_bgr8(sources.image(path)), outline)
    draw_measurement(image, Drawn(moved, one['kind'] in _CLOSED, label))
    return photo(image, caption.replace('+-', '±'))


def quantities(measurement: Mapping[str, Any]) -> Iterator[tuple[str, Quantity]]:
    """Yield the quantities of an entry of ``measurements.json``."""
    for name, one in measurement.items():
        if isinstance(one, dict) and 'sigma' in one:
            shares = one.get('sigma_by_source') or {}
            yield name, Quantity(one['value'], one['sigma'], one['unit'], shares)


def control_points(sources: ReportSources) -> str:
    """Return the section about control and check points."""
    tie = sources.tie
    if tie is None:
        words = 'the cloud is in the frame of the camera (binocular-recon georeference)'
        return section('Control and check points', sources.lacks('tie to the site', words))
    if 'points' not in tie:
        how = f'Made level by {text(tie.get("level_by", "?"))}'
        if 'tilt_sigma_deg' in tie:
            how += f', sigma {fixed(tie["tilt_sigma_deg"], 3)} degrees'
        return section('Frame of the site', f'{how}; there were no control points.')
    axes = [text(name) for name in tie['axes']]
    rows = []
    for key, what in _KINDS:
        for point in tie['points']:
            if key in point:
                off, sigma = point[key], point[key.replace('_m', '_sigma_m')]
                rows.append(
                    (
                        text(point['name']),
                        what,
                        *(
                            f'{1e3 * a:+.1f} ± {1e3 * b:.1f}'
                            for a, b in zip(off, sigma, strict=True)
                        ),
                        _ratio(off, sigma, point.get(key.replace('_m', '_is_odd'))),
                    )
                )
    places = [
        (text(point['name']), 'check' if point['check'] else 'control',
         *(fixed(value, 3) for value in point['place']))
        for point in tie['points']
    ]  # fmt: skip
    checks = [point for point in tie['points'] if 'error_m' in point]
    verdict = (
        f'{counted(len(checks), "check point")}, with no part in the adjustment: off by'
        f' {_rms_mm(checks, "error_m")} mm (RMS of a coordinate).'
        if checks
        else 'No check points were measured.'
    )
    head = ('point', '', *(f'{name}, mm' for name in axes), 'off / sigma')
    return section(
        'Control and check points',
        'Residuals of the adjustment; where the others put a control point (left out); errors of'
        f' points that only check. {verdict}{_scale(tie)}',
        table(head, rows, kind='long wide left'),
        table(('point', '', *(f'{name}, m' for name in axes)), places, kind='wide left'),
    )


def _scale(tie: Mapping[str, Any]) -> str:
    found = tie.get('scale_estimated')
    if not found:
        return ' The scale was held.'
    return f' The scale was estimated: {found["value"]:.5f} ± {found["sigma"]:.5f}.'


def _ratio(off: list[float], sigma: list[float], odd: bool | None) -> str:
    """Return how far off a point is in standard deviations (RMS of its coordinates), HTML."""
    ratio = float(np.sqrt(np.mean((np.array(off) / np.maximum(sigma, 1e-9)) ** 2)))
    shown = fixed(ratio, 2)
    return f'<span class="bad">{shown}</span>' if odd else shown


def _rms_mm(points: list[dict[str, Any]], key: str) -> str:
    return fixed(1e3 * float(np.sqrt(np.mean([np.square(one[key]) for one in points]))), 1)


def control_rms_mm(tie: Mapping[str, Any] | None) -> str:
    """Return the RMS of the residuals of control points, mm, '' without control points."""
    used = [one for one in (tie or {}).get('points', ()) if 'residual_m' in one]
    return _rms_mm(used, 'residual_m') if used else ''
