# SPDX-License-Identifier: Apache-2.0
"""Write docs/nodes.md: every node's topics, services and parameters, from its declarations."""

from __future__ import annotations

import argparse
import dataclasses
import importlib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from binocular_recon.cli import play
from binocular_recon.config import PRESETS
from binocular_recon.options import Options

PAGE = Path(__file__).with_name('nodes.md')
NODES = {
    'rectify_node': 'RectifyNode',
    'match_node': 'MatchNode',
    'wls_filter_node': 'WlsFilterNode',
    'calibration_node': 'CalibrationNode',
}
INTRODUCTION = """\
# Nodes

This page is made by `make docs` from what the nodes declare.

Names are relative: a rig runs in one namespace. All outputs carry the stamp of the left input;
outputs of the right camera keep its frame, all others have the left one. A message is made only
when somebody subscribes to it, and a node subscribes only while somebody listens to it. Work on a
frame happens beside the executor, the newest pair first: a node that cannot keep up drops old
pairs and counts them. In `wls_filter_node` pictures wait for their disparities: it holds matching
time times frame rate of them, at most `queue_size`, and says so when these are too few.

Publishers are reliable, volatile, keep last 1; subscribers have sensor data QoS (best effort,
volatile, depth 5). `qos_overrides.<topic>.<publisher|subscription>.<history|depth|reliability>`
changes both. With `image_transport` = `compressed` a picture comes from `<topic>/compressed`.
Every node publishes `/diagnostics` once a second: received, published and dropped by reason,
processing time, the calibration in use and the last error; `wls_filter_node` also the iterations
and the estimated error of the last frame.

A *live* parameter can be changed while the node runs; a value that is refused comes back with the
reason. `preset` sets every parameter that was not set explicitly.
"""


def page() -> str:
    """Return the whole page."""
    parts = [INTRODUCTION]
    for module, name in NODES.items():
        node: Any = getattr(importlib.import_module(f'binocular_recon.nodes.{module}'), name)
        parts.append(f'## {module}\n\n{node.__doc__.splitlines()[0]}\n')
        topics = [('subscribes', one) for one in node.INPUTS]
        topics += [('publishes', one) for one in node.OUTPUTS]
        parts.append(
            _table(
                ('', 'topic', 'type', ''),
                ((way, f'`{one.topic}`', _type(one.type), _remark(one)) for way, one in topics),
            )
        )
        services = getattr(node, 'SERVICES', {})
        if services:
            rows = ((f'`~/{service}`', text) for service, text in services.items())
            parts.append(_table(('service (std_srvs/Trigger)', ''), rows))
        presets = [name for name, values in PRESETS.items() if values]
        if not any(_in_presets(group) for group in node.LIVE):
            presets = []
        rows = [
            _row(spec, presets, live=group in node.LIVE)
            for group in (*node.LIVE, *node.FIXED)
            for spec in dataclasses.fields(group)
        ]
        head = ('parameter', 'unit', 'range', 'default', *(f'`{name}`' for name in presets))
        parts.append(_table((*head, 'live', 'meaning'), rows))
    return '\n'.join([*parts, _player()])


def _player() -> str:
    """Return the section of the node that publishes a bag: it has arguments, no parameters."""
    parser = argparse.ArgumentParser(add_help=False)
    play.add_arguments(parser)
    rows = [
        (f'`{" ".join([*one.option_strings, str(one.metavar or "")]).strip()}`', str(one.help))
        for one in parser._actions  # noqa: SLF001 - argparse offers no other way
    ]
    rows = [(name, text.replace('%(default)g', '1')) for name, text in rows]
    return (
        '## play_bag\n\nPublish a bag as it was recorded: its bytes, its timing, its QoS, and'
        ' `/clock` on request.\n\n' + _table(('argument', ''), rows)
    )


def _row(spec: Any, presets: Iterable[str], *, live: bool) -> tuple[str, ...]:
    meta = spec.metadata
    span = f'{meta["minimum"]:g} .. {meta["maximum"]:g}' if meta['minimum'] is not None else ''
    if meta['choices']:
        span = ', '.join(meta['choices'])
    differing = tuple(
        _value(PRESETS[name][spec.name]) if spec.name in PRESETS[name] else '' for name in presets
    )
    mark = 'yes' if live else ''
    default = _value(spec.default)
    return f'`{spec.name}`', meta['unit'], span, default, *differing, mark, meta['description']


def _in_presets(group: type[Options]) -> bool:
    names = {spec.name for spec in dataclasses.fields(group)}  # type: ignore[arg-type]
    return any(names & values.keys() for values in PRESETS.values())


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return value if isinstance(value, str) else f'{value:g}'


def _type(kind: Any) -> str:
    return f'{kind.__module__.split(".")[0]}/{kind.__name__}'


def _remark(one: Any) -> str:
    remarks = [('transported', 'follows image_transport'), ('optional', 'optional')]
    return ', '.join(text for name, text in remarks if getattr(one, name, False))


def _table(head: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    head = tuple(head)
    lines = [head, ('---',) * len(head), *rows]
    return '\n'.join(f'| {" | ".join(line)} |' for line in lines) + '\n'


if __name__ == '__main__':
    PAGE.write_text(page(), encoding='utf-8')
