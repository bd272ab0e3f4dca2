# SPDX-License-Identifier: Apache-2.0
"""A node that is interrupted ends soon, with status 0 and without a traceback."""

from __future__ import annotations

import signal
import time
from pathlib import Path

import pytest
from stereo_msgs.msg import DisparityImage

from binocular_recon.stereo.rectification import Rectifier
from test.system.graph import Graph, NodeProcess
from test.system.rig import CameraPair, pictures, raw_rig


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_interrupted_in_the_middle_of_a_frame(
    graph: Graph, tmp_path: Path, number: signal.Signals
) -> None:
    rectify = Rectifier(raw_rig(width=480, height=360))
    images = rectify(*pictures(1, 480, 360))
    # so slow that it is busy all the time
    node = NodeProcess('match_node', tmp_path / 'log', disparity_range=300)
    cameras = CameraPair(graph, rectify.rig, image='image_rect')
    with graph.listening(('/rig/disparity', DisparityImage)) as (inbox,):
        graph.wait_for_subscriber(*cameras.topics)
        for index in range(20):
            cameras.send(index, images)
            time.sleep(0.02)
        inbox.wait(1)
        begun = time.monotonic()
        assert node.stop(number) == 0
        assert time.monotonic() - begun < 3
    assert 'Traceback' not in node.text(), node.text()
    assert len(inbox.messages) < 20


def test_interrupted_while_it_starts(tmp_path: Path) -> None:
    node = NodeProcess('match_node', tmp_path / 'log')
    time.sleep(0.7)
    assert node.stop() in (0, -signal.SIGINT), node.text()
