# SPDX-License-Identifier: Apache-2.0
"""A node without messages says whose fault that is: nobody's, the camera's, the node's before."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from stereo_msgs.msg import DisparityImage

from test.system.conftest import StartNode
from test.system.graph import Graph, wait_until
from test.system.rig import CameraPair, header, image_pair, info_message, raw_rig

pytestmark = pytest.mark.long

REMAPS = {f'{side}/camera_info': f'{side}/camera_info_rect' for side in ('left', 'right')}
DISPARITY: tuple[str, type[DisparityImage]] = ('/rig/disparity', DisparityImage)


@pytest.fixture(scope='module')
def matcher(start_node: StartNode) -> Any:
    return start_node('match_node', disparity_range=32, remaps=REMAPS)


def test_the_node_that_drops_the_frames_is_named(
    graph: Graph, start_node: StartNode, matcher: Any
) -> None:
    del matcher  # it runs
    with graph.listening(DISPARITY):
        status = graph.wait_for_status('/rig/match_node', 'nobody publishes them: start the came')
        assert status.level == DiagnosticStatus.STALE
        start_node('rectify_node')
        cameras = CameraPair(graph, raw_rig())
        graph.wait_for_subscriber(*cameras.topics)
        index = iter(range(100_000))

        def damaged(node: str, text: str) -> bool:
            """Send a frame whose calibration is refused; tell whether a node's status says so."""
            i = next(index)
            info = info_message(cameras.rig.left, header(i))
            info.p = 0 * np.asarray(info.p)
            cameras.send(i, image_pair(1), left_info=info)
            found = graph.status(node)
            return found is not None and text in found.message

        for node, text in (
            ('/rig/match_node', '/rig/rectify_node publishes them'),
            ('/rig/rectify_node', 'left camera: P is not that of a rectified'),
        ):
            wait_until(partial(damaged, node, text), f'{node} says {text!r}', every_s=0.1)
        status = graph.wait_for_status('/rig/match_node', 'sends nothing')
        assert 'its status on /diagnostics say why' in status.message

        def good() -> bool:
            cameras.send(next(index), image_pair(1))
            found = graph.status('/rig/match_node')
            return found is not None and 'frames in the last second' in found.message

        wait_until(good, 'frames are matched again', every_s=0.1)
        status = graph.wait_for_status('/rig/rectify_node', 'no messages on left/image_raw for 1.')
        assert status.level == DiagnosticStatus.WARN
