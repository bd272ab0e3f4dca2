# SPDX-License-Identifier: Apache-2.0
"""The chain in one node: it computes what is asked for, and says what is missing, as three do."""

from __future__ import annotations

import pytest
from sensor_msgs.msg import Image, PointCloud2
from stereo_msgs.msg import DisparityImage

from test.system.chain import prime, start_chain
from test.system.conftest import StartNode
from test.system.graph import Graph
from test.system.rig import SIDES, CameraPair, header, image_message, image_pair, raw_rig

NODE = '/rig/stereo_node'
IMAGES = image_pair(4)
# a status of each stage: what it states of a frame that it has processed
STATED = {'rectify': 'left rectified frame', 'match': 'search range', 'filter': 'iterations'}


@pytest.fixture(scope='module')
def cameras(graph: Graph, start_node: StartNode) -> CameraPair:
    start_chain(start_node, composed='true', disparity_range='32')
    return CameraPair(graph, raw_rig())


def stated(graph: Graph) -> dict[str, str]:
    (status,) = graph.next_status(NODE)
    return {pair.key: pair.value for pair in status.values}


@pytest.mark.parametrize(
    ('topic', 'kind', 'stages'),
    [
        ('right/image_rect', Image, ['rectify']),
        ('disparity', DisparityImage, ['rectify', 'match']),
        ('points2', PointCloud2, ['rectify', 'match', 'filter']),
    ],
)
def test_stages_run_while_somebody_subscribes_to_their_results(
    graph: Graph, cameras: CameraPair, topic: str, kind: type, stages: list[str]
) -> None:
    """In this order: what a stage has stated once stays in the status."""
    graph.wait_for_status(NODE, 'idle: no subscribers on left/camera_info_rect')
    with graph.listening((f'/rig/{topic}', kind)) as inboxes:
        graph.wait_for_subscriber(*cameras.topics)
        prime(cameras, inboxes, IMAGES)
        values = stated(graph)
        assert [stage for stage, key in STATED.items() if key in values] == stages
        assert [name for name in STATED if f'time of {name}' in values] == stages
        published = {key for key in values if key.startswith('published ')}
        assert f'published {topic}' in published and len(published) == len(stages)


def test_a_bad_image_is_dropped_with_the_reason(graph: Graph, cameras: CameraPair) -> None:
    with graph.listening(('/rig/points2', PointCloud2)) as inboxes:
        graph.wait_for_subscriber(*cameras.topics)
        prime(cameras, inboxes, IMAGES)
        bad = image_message(IMAGES[1], header(40_000, SIDES[1]))
        bad.encoding = 'jpeg2000'
        cameras.send(40_000, IMAGES, right_image=bad)
        graph.wait_for_status(NODE, "right image has encoding 'jpeg2000'")
        assert stated(graph)['dropped: bad input'] == '1'
        prime(cameras, inboxes, IMAGES)
