# SPDX-License-Identifier: Apache-2.0
"""calibration_node: what it refuses to capture, and to start with."""

from __future__ import annotations

import itertools
import re
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from std_srvs.srv import Trigger

from binocular_recon.calibration.target.rods import save_rods
from test.system.calibration_crew import BOARD, NODE, Operator, simulated
from test.system.conftest import StartNode
from test.system.graph import Graph, NodeProcess, wait_until

pytestmark = pytest.mark.long


def test_rods_that_move_are_not_captured(
    graph: Graph, start_node: StartNode, tmp_path: Path
) -> None:
    save_rods(BOARD, tmp_path / 'rods.yaml')
    node = start_node('calibration_node', rods=tmp_path / 'rods.yaml', output=tmp_path / 'rig')
    operator = Operator(graph)
    operator.wait_for_node()
    shown = simulated(1)
    client = graph.do(partial(graph.node.create_client, Trigger, f'{NODE}/capture'))
    assert client.wait_for_service(10)
    offsets_px = itertools.cycle(range(100))

    def show_moving_rods() -> None:
        offset_px = next(offsets_px)
        operator.show(*(np.roll(image, offset_px, axis=1) for image in (shown.left, shown.right)))

    def received() -> bool:
        show_moving_rods()
        return operator.received() > 0

    def answered() -> bool:
        show_moving_rods()
        return bool(call.done())

    wait_until(received, 'a pair at the node', every_s=0.1)
    call = client.call_async(Trigger.Request())
    wait_until(answered, 'the answer', every_s=0.1)
    answer = call.result()
    assert not answer.success
    assert re.search(r'the marks moved by \d+\.\d px', answer.message), answer.message
    assert node.stop() == 0


@pytest.mark.parametrize(
    ('parameters', 'message'),
    [
        ({}, 'parameter rods is empty'),
        ({'rods': '/nowhere/rods.yaml', 'output': 'out'}, '/nowhere/rods.yaml'),
    ],
)
def test_node_refuses_to_start(
    tmp_path: Path, parameters: dict[str, object], message: str
) -> None:
    node = NodeProcess('calibration_node', tmp_path / 'log', **parameters)
    wait_until(lambda: node.process.poll() is not None, 'the end of the node')
    assert node.process.returncode == 1
    assert message in node.text()
    assert 'Traceback' not in node.text(), node.text()
