# SPDX-License-Identifier: Apache-2.0
"""The report of a soak, one HTML file."""

from __future__ import annotations

import statistics
from collections.abc import Mapping, Sequence
from html import escape
from typing import NamedTuple

import numpy as np

from binocular_recon.drawing.page import figure, legend, page, section, table
from binocular_recon.drawing.svg import Chart

_COLOURS = ('#0b7a75', '#c8553d', '#e0a13a', '#0a3d4a', '#71808f', '#6fbfb8')
# After its start a process fills its caches.
_SETTLED_S = 300.0


class Episode(NamedTuple):
    """One fault in one rig: how long until clouds came again, and what was said of it."""

    fault: str
    rig: str
    at_s: float
    recovery_s: float
    cause: str
    problem: str


class Life(NamedTuple):
    """Memory of a process over its life: times, s, and resident memory, MB."""

    node: str
    times_s: list[float]
    memory_mb: list[float]


def growth(life: Life) -> float:
    """Return by how much memory grew after the first minutes, 0 if its life was shorter."""
    settled_s = life.times_s[0] + _SETTLED_S
    values = [mb for at, mb in zip(life.times_s, life.memory_mb, strict=True) if at >= settled_s]
    part = len(values) // 4
    if part < 10:
        return 0.0
    return statistics.median(values[-part:]) / statistics.median(values[:part]) - 1


def soak_page(
    summary: str,
    episodes: Sequence[Episode],
    lives: Sequence[Life],
    counts: Mapping[str, Mapping[str, str]],
    problems: Sequence[str],
) -> str:
    """Return the report: faults, memory over time, and what each node has counted."""
    rows = [
        [
            escape(one.fault),
            one.rig,
            f'{one.at_s:.0f}',
            f'{one.recovery_s:.2f}',
            escape(one.cause),
            escape(one.problem),
        ]
        for one in episodes
    ]
    wrong = [number for number, one in enumerate(episodes) if one.problem]
    verdict = '; '.join(escape(one) for one in problems) or 'None.'
    return page(
        'Soak of the running nodes',
        [
            section('Problems', escape(summary), verdict),
            section(
                'Faults',
                'Recovery is the time from the end of the fault to the first cloud of a pair'
                ' recorded after it. Marked rows have a problem.',
                '<div class="scroll">'
                + table(
                    ['fault', 'rig', 'at s', 'recovery s', 'said in /diagnostics', 'problem'],
                    rows,
                    marked=wrong,
                )
                + '</div>',
            ),
            section('Memory', 'Resident memory of each process.', _memory(lives)),
            section(
                'Frames',
                'What each node counted in its last life.',
                *(
                    figure(table([node, ''], sorted(values.items())), '')
                    for node, values in counts.items()
                ),
            ),
        ],
    )


def _memory(lives: Sequence[Life]) -> str:
    lives = [one for one in lives if one.times_s]
    if not lives:
        return ''
    end_s = max(one.times_s[-1] for one in lives)
    top = 1.1 * max(max(one.memory_mb) for one in lives)
    chart = Chart((0, max(1.0, end_s)), (0, top), (960, 300), ('time, s', 'memory, MB'))
    names = list(dict.fromkeys(one.node for one in lives))
    colours = {name: _COLOURS[i % len(_COLOURS)] for i, name in enumerate(names)}
    for one in lives:
        chart.line(np.column_stack([one.times_s, one.memory_mb]), colours[one.node])
    rows = []
    for one in lives:
        lived_s = one.times_s[-1] - one.times_s[0]
        grown = f'{growth(one):.1%}' if lived_s > _SETTLED_S else ''
        rows.append([one.node, f'{lived_s:.0f}', f'{one.memory_mb[-1]:.0f}', grown])
    drawing = chart.svg('Memory of each process over time')
    return figure(drawing, legend(*colours.items()), kind='wide') + table(
        ['process', 'lived s', 'MB at the end', 'growth after 5 minutes'], rows
    )
