# SPDX-License-Identifier: Apache-2.0
"""The section about the calibration: its age, how well it is known, and the check distance."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import date, datetime
from typing import Any

from binocular_recon.apps.survey.report.sources import ReportSources, text
from binocular_recon.drawing.page import section, table
from binocular_recon.number_text import counted, day_text, fixed, significant


def calibration(sources: ReportSources) -> str:
    """Return the section."""
    content = sources.calibration
    if isinstance(content, str):
        return section('Calibration', sources.lacks('calibration', content), _checks(sources))
    sigma = content['sigma']
    rows = [
        (
            'baseline',
            f'{1e3 * content["baseline_m"]:.2f} ± {significant(1e3 * sigma["baseline_m"], 2)} mm',
        )
    ]
    for side in ('left', 'right'):
        for name, (row, column) in (
            ('fx', (0, 0)),
            ('fy', (1, 1)),
            ('cx', (0, 2)),
            ('cy', (1, 2)),
        ):
            value, one = content[side]['K'][row][column], sigma.get(f'{name}_{side}_px')
            known = '' if one is None else f' ± {significant(one, 2)}'
            rows.append((f'{name} {side}', f'{value:.2f}{known} px'))
    depths = [
        (f'{text(depth)} m', '-' if one is None else f'{significant(1e3 * one)} mm')
        for depth, one in content['depth_sigma_m'].items()
    ]
    boards = content['boards']
    marks = sum(board['marks'] for board in boards)
    rejected = [(text(one['name']), text(one['reason'])) for one in content['rejected']]
    warnings = ''.join(f'<li>{text(one)}</li>' for one in content.get('warnings') or ())
    return section(
        'Calibration',
        f'{_age(sources, content)} {counted(len(boards), "board")} with {counted(marks, "mark")}'
        f' in both images; RMS of the marks {fixed(content["rms_px"], 3)} px, mean row difference'
        f' {fixed(content["row_difference_px"]["adjusted"]["mean"], 3)} px.',
        table(('parameter', 'value ± sigma'), rows),
        table(('distance', 'predicted sigma of depth'), depths),
        table(('board left out', 'reason'), rejected, kind='words wide') if rejected else '',
        f'<ul class="advice">{warnings}</ul>' if warnings else '',
        _checks(sources),
    )


def _age(sources: ReportSources, content: Mapping[str, Any]) -> str:
    stated = content.get('date')
    if not stated:
        return f'Date: {sources.lacks("age of the calibration", "calibration.json has no date")}.'
    words = f'Calibrated on {text(day_text(stated))}'
    if sources.details.date:
        taken = date.fromisoformat(sources.details.date)
    elif sources.recorded:
        taken = sources.recorded[0].date()
    else:
        return f'{words}; its age is not known, since the images have no time.'
    days = (taken - datetime.fromisoformat(stated).date()).days
    if days == 0:
        return f'{words}, the same day as the survey.'
    count = f'{abs(days)} day{"" if abs(days) == 1 else "s"}'
    return f'{words}, {count} {"before" if days > 0 else "after"} the survey.'


def _checks(sources: ReportSources) -> str:
    check = sources.check
    if check is None:
        remedy = 'calibrate ... --check RIG --output OUTPUT'
        return f'<p>Check distance: {sources.lacks("check distance", remedy)}</p>'
    rows = [
        (
            text(one['name']),
            f'{fixed(one["measured_m"], 3)} ± {fixed(one["sigma_m"], 3)} m',
            f'{fixed(one["known_m"], 3)} m',
            f'{significant(one["depth_m"])} m',
            f'{one["off_sigmas"]:+.1f}',
            'passed' if one['passed'] else '<span class="bad">FAILED</span>',
        )
        for one in check['distances']
    ]
    head = ('check distance', 'measured ± sigma', 'known', 'at', 'off / sigma', '')
    faults = ''.join(f'<li class="bad">{text(one)}</li>' for one in check['faults'])
    return (
        f'<p>Checked on {text(day_text(check["date"]))}: {text(check["rows"])}.</p>'
        + table(head, rows, kind='wide')
        + (f'<ul class="advice">{faults}</ul>' if faults else '')
    )


def check_verdict(sources: ReportSources) -> str:
    """Return what the check distances say, in a word or two."""
    check = sources.check
    if check is None:
        return 'none'
    if check['faults']:
        return 'FAILED'
    count = len(check['distances'])
    return 'passed' if count == 1 else f'{count} passed'
