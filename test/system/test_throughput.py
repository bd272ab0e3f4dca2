# SPDX-License-Identifier: Apache-2.0
"""Under a load that they can bear the nodes lose nothing; beyond it they drop, and say so."""

from __future__ import annotations

import time
from collections.abc import Iterator

import pytest
from sensor_msgs.msg import PointCloud2
from stereo_msgs.msg import DisparityImage

from binocular_recon.io.messages.images import stamp_ns
from test.system.chain import prime, start_chain
from test.system.conftest import StartNode
from test.system.graph import Graph, Inbox, wait_until
from test.system.rig import CameraPair, header, pictures, raw_rig

SIZE = (96, 72)
FRAMES = 100
IMAGES = pictures(3, *SIZE)
Running = tuple[CameraPair, Inbox, Inbox]


@pytest.fixture(scope='module')
def running(graph: Graph, start_node: StartNode) -> Iterator[Running]:
    start_chain(start_node, disparity_range=24)
    cameras = CameraPair(graph, raw_rig(0.0, *SIZE))
    topics = ('/rig/disparity_wls', DisparityImage), ('/rig/points2', PointCloud2)
    with graph.listening(*topics) as (disparities, clouds):
        graph.wait_for_subscriber(*cameras.topics)
        prime(cameras, [disparities, clouds], IMAGES)
        yield cameras, disparities, clouds


@pytest.fixture(scope='module')
def sustained_hz(running: Running) -> float:
    """Return how many frames a second come out when more are sent."""
    cameras, disparities, _ = running
    begun, index = time.monotonic(), 0
    while time.monotonic() - begun < 3:
        cameras.send(index, IMAGES)
        index += 1
        time.sleep(0.003)
    time.sleep(0.5)
    stamps = [stamp_ns(message.header) for message in disparities.messages]
    assert stamps == sorted(set(stamps)), 'in order, each once, also under overload'
    assert len(stamps) > 10
    return len(stamps) / (time.monotonic() - begun - 0.5)


def test_replay_at_a_fifth_of_what_can_be_sustained_is_complete(
    running: Running, sustained_hz: float
) -> None:
    cameras, disparities, clouds = running
    for inbox in (disparities, clouds):
        inbox.messages.clear()
    period_s = 1 / (0.2 * sustained_hz)
    begun = time.monotonic()
    for index in range(FRAMES):
        time.sleep(max(0.0, begun + index * period_s - time.monotonic()))
        cameras.send(index, IMAGES)
    expected = [stamp_ns(header(index)) for index in range(FRAMES)]
    for inbox in (disparities, clouds):
        inbox.wait(FRAMES)
        assert [stamp_ns(message.header) for message in inbox.messages] == expected


def test_overload_drops_old_frames_says_how_many_and_leaves_no_backlog(
    graph: Graph, running: Running, sustained_hz: float
) -> None:
    cameras, disparities, _ = running
    disparities.messages.clear()
    said: list[str] = []

    def overload() -> bool:
        for _ in range(20):
            cameras.send(next(indices), IMAGES)
            time.sleep(0.003)
        for node in ('rectify_node', 'match_node', 'wls_filter_node'):
            status = graph.status(f'/rig/{node}')
            if status is not None and 'cannot keep up: dropped' in status.message:
                assert status.level == status.WARN
                said.append(status.message)
        return bool(said)

    indices = iter(range(1000, 1_000_000))
    wait_until(overload, 'a node that says that it cannot keep up')
    last = next(indices)
    ended = time.monotonic()
    cameras.send(last, IMAGES)
    wait_until(lambda: stamp_ns(header(last)) in disparities.by_stamp(), 'the last frame')
    # at most what each node is doing and what waits there is done before it
    assert time.monotonic() - ended < 1 + 10 / sustained_hz
