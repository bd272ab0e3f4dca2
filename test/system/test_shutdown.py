# SPDX-License-Identifier: Apache-2.0
"""A node that is interrupted ends, with status 0 and without a traceback."""

from __future__ import annotations

import itertools
import signal
from pathlib import Path

import pytest
from stereo_msgs.msg import DisparityImage

from binocular_recon.stereo.rectification import Rectifier
from test.system.graph import Graph, NodeProcess, wait_until
from test.system.rig import CameraPair, image_pair, raw_rig


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_interrupted_in_the_middle_of_a_frame(
    graph: Graph, tmp_path: Path, number: signal.Signals
) -> None:
    rectify = Rectifier(raw_rig(width=480, height=360))
    images = rectify(*image_pair(1, 480, 360))
    # so slow that another frame always waits when one is done
    node = NodeProcess('match_node', tmp_path / 'log', disparity_range=300)
    cameras = CameraPair(graph, rectify.rig, image='image_rect')
    indices = itertools.count()
    with graph.listening(('/rig/disparity', DisparityImage)) as (inbox,):
        graph.wait_for_subscriber(*cameras.topics)

        def first_came() -> bool:
            cameras.send(next(indices), images)
            return bool(inbox.messages)

        wait_until(first_came, 'the first disparity')
        assert node.stop(number) == 0
    assert 'Traceback' not in node.text(), node.text()
    assert len(inbox.messages) < next(indices)


def test_interrupted_while_it_starts(tmp_path: Path) -> None:
    node = NodeProcess('match_node', tmp_path / 'log')
    memory = Path(f'/proc/{node.process.pid}/maps')
    wait_until(lambda: 'librcl' in memory.read_text(), 'the node to load ROS')
    assert node.stop() in (0, -signal.SIGINT), node.text()
