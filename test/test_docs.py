# SPDX-License-Identifier: Apache-2.0
"""The documentation says what the code does."""

from __future__ import annotations

import dataclasses
import importlib.util
import re

import pytest

from binocular_recon.config import PRESETS, ChainConfig, MatchConfig
from binocular_recon.io.messages.images import ENCODINGS
from binocular_recon.lenses import LENSES
from binocular_recon.stereo.rectification import LARGEST_SIDE_PX
from test.conftest import REPOSITORY


@pytest.mark.ros
def test_nodes_page_is_what_the_nodes_declare() -> None:
    spec = importlib.util.spec_from_file_location(
        'make_nodes', REPOSITORY / 'docs' / 'make_nodes.py'
    )
    assert spec and spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    assert module.PAGE.read_text() == module.page(), 'run make docs'


def _readme_row(first: str) -> str:
    """Return the second cell of the row of the README's tables that begins with ``first``."""
    (cell,) = re.findall(rf'^\| {first} \| (.*) \|$', README, re.MULTILINE)
    return str(cell)


README = (REPOSITORY / 'README.md').read_text()


@pytest.mark.ros
def test_readme_states_the_defaults_of_real_parameters() -> None:
    from binocular_recon.nodes.runtime import options

    groups = [value for value in vars(options).values() if dataclasses.is_dataclass(value)]
    groups += [type(group) for group in vars(ChainConfig()).values()]
    # what a group changes of the one that it is derived from is stated in words
    late = options.LateInputOptions()
    assert f'{late.queue_size} in `wls_filter_node`' in README
    defaults = {s.name: s.default for g in reversed(groups) for s in dataclasses.fields(g)}
    table = README.partition('| parameter |')[2].partition('\n\n')[0]
    rows = [line.split('|')[1:3] for line in table.splitlines()[2:]]
    assert len(rows) >= 5
    for names, stated in rows:
        for name, value in zip(re.findall('`(.*?)`', names), stated.split(','), strict=True):
            default = defaults[name]
            shown = str(default).lower() if isinstance(default, (bool, str)) else f'{default:g}'
            assert value.strip() == shown, name
    assert all(f'`{preset}`' in table for preset in PRESETS)


def test_readme_states_the_limits() -> None:
    assert f'{LARGEST_SIDE_PX} px a side' in _readme_row('pictures')
    assert _readme_row('lenses').split(', ') == list(LENSES)
    stated = re.sub(r'\(.*?\)', '', _readme_row('encodings').partition(';')[0])
    assert {name.strip() for name in stated.split(',')} == set(ENCODINGS)
    limits = {spec.name: spec.metadata for spec in dataclasses.fields(MatchConfig)}
    count, least = limits['disparity_range'], limits['min_disparity']
    assert _readme_row('disparities') == (
        f'{count["minimum"]} to {count["maximum"]}, the smallest within {least["minimum"]} to'
        f' {least["maximum"]} px'
    )
