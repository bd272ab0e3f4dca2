# SPDX-License-Identifier: Apache-2.0
"""Real node processes, on the DDS profile that the launch files choose."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Protocol

import pytest

PROFILE = Path(__file__).resolve().parents[2] / 'config' / 'fastdds_shared_memory.xml'
for variable in ('FASTDDS_DEFAULT_PROFILES_FILE', 'FASTRTPS_DEFAULT_PROFILES_FILE'):
    os.environ[variable] = str(PROFILE)


class StartNode(Protocol):
    def __call__(self, executable: str, **parameters: object) -> Any: ...


@pytest.fixture(scope='session', autouse=True)
def _compiled_kernels() -> None:
    """Compile before the nodes start: that takes longer than tests wait for a node."""
    from binocular_recon.nodes.registry import node_class, node_names

    for name in node_names():
        node_class(name).compile_kernels()


@pytest.fixture(scope='module')
def graph() -> Iterator[Any]:
    """Join the graph with a node of the test's own."""
    from test.system.graph import Graph

    own = Graph()
    yield own
    own.close()


@pytest.fixture(scope='module')
def start_node(tmp_path_factory: pytest.TempPathFactory) -> Iterator[StartNode]:
    """Start nodes; at the end of the module, stop them and check that they end cleanly."""
    from test.system.graph import NodeProcess

    folder: Path = tmp_path_factory.mktemp('nodes')
    started: list[Any] = []

    def start(executable: str, **parameters: object) -> Any:
        node = NodeProcess(executable, folder / f'{executable}_{len(started)}.log', **parameters)
        started.append(node)
        return node

    yield start
    for node in started:
        text = f'{node.log.name}:\n{node.text()}'
        assert node.stop() == 0, text
        assert 'Traceback' not in node.text(), text
