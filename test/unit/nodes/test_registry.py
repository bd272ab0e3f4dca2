# SPDX-License-Identifier: Apache-2.0
"""Every node declares what executables, documentation and tests take from its module."""

from __future__ import annotations

import dataclasses
import importlib

import pytest

from test.conftest import REPOSITORY

pytestmark = pytest.mark.ros
NAMES = sorted(path.stem for path in REPOSITORY.glob('binocular_recon/nodes/*_node.py'))


def test_nodes_are_found_by_the_names_of_their_modules() -> None:
    from binocular_recon.nodes.registry import node_names

    assert node_names() == NAMES
    assert {'calibration_node', 'match_node', 'rectify_node', 'wls_filter_node'} <= set(NAMES)


@pytest.mark.parametrize('name', NAMES)
def test_a_node_declares_its_topics_services_and_options(name: str) -> None:
    from binocular_recon.nodes.registry import node_class

    node = node_class(name)
    assert name == node.NAME and node.SUBJECT and node.__doc__
    topics = [one.topic for one in node.INPUTS] + [one.topic for one in node.OUTPUTS]
    assert topics and len(set(topics)) == len(topics)
    assert not any(topic.startswith('/') for topic in topics)  # a rig runs in one namespace
    assert all(description for description in node.SERVICES.values())
    options = [spec for group in (*node.LIVE, *node.FIXED) for spec in dataclasses.fields(group)]  # type: ignore[arg-type]
    assert options and len({spec.name for spec in options}) == len(options)
    assert all(spec.metadata['description'] for spec in options)


@pytest.mark.parametrize('name', NAMES)
def test_a_node_has_a_main_function_and_an_executable(name: str) -> None:
    from binocular_recon.nodes import executables

    assert callable(getattr(executables, name))
    assert callable(importlib.import_module(f'binocular_recon.nodes.{name}').main)
