# SPDX-License-Identifier: Apache-2.0
"""Under a load that they can bear the nodes lose nothing; beyond it they drop, and say so."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import NamedTuple

import pytest
from sensor_msgs.msg import PointCloud2
from stereo_msgs.msg import DisparityImage

from binocular_recon.io.messages.images import stamp_ns
from test.system.chain import prime, start_chain
from test.system.conftest import StartNode
from test.system.graph import Graph, Inbox, wait_until
from test.system.rig import CameraPair, header, image_pair, raw_rig

SIZE = (96, 72)
IMAGES = image_pair(3, *SIZE)
# an output of each node
OUTPUT = {
    'rectify_node': 'left/image_rect',
    'match_node': 'disparity',
    'wls_filter_node': 'disparity_wls',
}
Running = tuple[CameraPair, Inbox, Inbox]


@pytest.fixture(scope='module')
def running(graph: Graph, start_node: StartNode) -> Iterator[Running]:
    start_chain(start_node, disparity_range='24')
    cameras = CameraPair(graph, raw_rig(0.0, *SIZE))
    topics = ('/rig/disparity_wls', DisparityImage), ('/rig/points2', PointCloud2)
    with graph.listening(*topics) as (disparities, clouds):
        graph.wait_for_subscriber(*cameras.topics)
        prime(cameras, [disparities, clouds], IMAGES)
        yield cameras, disparities, clouds


def stamps(inbox: Inbox) -> list[int]:
    return [stamp_ns(message.header) for message in inbox.messages]


def test_frames_at_a_rate_that_the_nodes_sustain_all_come_once(running: Running) -> None:
    """Each frame is sent when the one before has come: no faster, but no slower either."""
    cameras, disparities, clouds = running
    count = 100
    for index in range(count):
        cameras.send(index, IMAGES)
        for inbox in (disparities, clouds):
            inbox.wait(index + 1)
    expected = [stamp_ns(header(index)) for index in range(count)]
    for inbox in (disparities, clouds):
        assert stamps(inbox) == expected


class Counts(NamedTuple):
    """What a node has counted since its start."""

    received: int
    published: int
    superseded: int


def counts_at_rest(graph: Graph) -> dict[str, Counts]:
    """Return the counts of each node once they stand still from one report to the next."""

    def counts() -> dict[str, Counts]:
        statuses = graph.next_status(*(f'/rig/{node}' for node in OUTPUT))
        found = {}
        for (node, output), status in zip(OUTPUT.items(), statuses, strict=True):
            values = {item.key: int(item.value) for item in status.values if item.value.isdigit()}
            superseded = values.get('dropped: a newer set came before it was begun', 0)
            found[node] = Counts(
                values['received sets'], values[f'published {output}'], superseded
            )
        return found

    def at_rest() -> dict[str, Counts] | None:
        earlier, later = counts(), counts()
        return later if earlier == later else None

    found: dict[str, Counts] = wait_until(at_rest, 'the nodes to be at rest')
    return found


def test_overload_drops_old_frames_says_how_many_and_leaves_no_backlog(
    graph: Graph, running: Running
) -> None:
    cameras, disparities, _ = running
    before = counts_at_rest(graph)
    disparities.messages.clear()
    indices = itertools.count(1000)
    warnings: list[str] = []

    def overload() -> bool:
        sent = 0
        for _ in range(5):
            sent = next(indices)
            cameras.send(sent, IMAGES)
        for node in OUTPUT:
            status = graph.status(f'/rig/{node}')
            if status is not None and 'cannot keep up: dropped' in status.message:
                assert status.level == status.WARN
                warnings.append(status.message)
        return bool(warnings) and sent > 1400

    wait_until(overload, 'a node that says that it cannot keep up')
    last = next(indices)
    cameras.send(last, IMAGES)
    done = len(disparities.messages)
    wait_until(lambda: stamp_ns(header(last)) in disparities.by_stamp(), 'the last frame')
    came = stamps(disparities)
    assert came == sorted(set(came)), 'in order, each once, also under overload'
    # only what each node processes, what waits there and what DDS holds is before the last one
    assert len(came) - done < 40
    # every frame that a node does not publish is in its count of those dropped
    superseded = 0
    for node, after in counts_at_rest(graph).items():
        change = Counts(*(now - then for now, then in zip(after, before[node], strict=True)))
        assert change.received == change.published + change.superseded, node
        superseded += change.superseded
    assert superseded > 0
