# SPDX-License-Identifier: Apache-2.0
"""The nodes together, wired as the launch file wires them."""

from __future__ import annotations

import itertools
from typing import Any

from sensor_msgs.msg import CameraInfo, Image, PointCloud2
from stereo_msgs.msg import DisparityImage

from binocular_recon.io.messages.images import stamp_ns
from test.launch_tools import launched_nodes
from test.system.conftest import StartNode
from test.system.graph import Inbox, NodeProcess, wait_until
from test.system.rig import SIDES, CameraPair, header, image_pair

OUTPUTS: dict[str, type[Any]] = {
    'left/camera_info_rect': CameraInfo,
    'right/camera_info_rect': CameraInfo,
    'left/image_rect': Image,
    'right/image_rect': Image,
    'disparity': DisparityImage,
    'confidence': Image,
    'match_validity': Image,
    'disparity_wls': DisparityImage,
    'points2': PointCloud2,
    'depth': Image,
    'depth/camera_info': CameraInfo,
    'disparity_color': Image,
    'validity': Image,
}
# What cameras publish, those that rectify too.
CAMERAS = [
    f'{side}/{topic}' for side in SIDES for topic in ('image_raw', 'image_rect', 'camera_info')
]


def reliable(topics: list[str], depth: int = 0) -> dict[str, object]:
    """Return the parameters that make subscriptions reliable, and deeper if ``depth`` says so."""
    prefixes = [f'qos_overrides./rig/{topic}.subscription' for topic in topics]
    parameters: dict[str, object] = {f'{one}.reliability': 'reliable' for one in prefixes}
    return parameters | ({f'{one}.depth': depth for one in prefixes} if depth else {})


def start_chain(
    start_node: StartNode, outer: dict[str, str] | None = None, /, **arguments: str
) -> list[NodeProcess]:
    """Start what the launch file starts with these arguments, reliable from the cameras on.

    The nodes are separate ones unless the arguments compose them.
    ``outer`` are remappings around the launch file: to each node they come before its own.
    """
    nodes = []
    arguments = {'composed': 'false'} | arguments
    for node in launched_nodes(namespace='rig', **arguments):
        remaps = {**dict(node.remappings), **(outer or {})}
        cameras = [remaps.get(topic, topic) for topic in CAMERAS]
        parameters = {**reliable(cameras), **node.parameters[-1]}
        nodes.append(start_node(node.executable, remaps=remaps, **parameters))
    return nodes


def prime(cameras: CameraPair, inboxes: list[Inbox], frame: Any = None) -> None:
    """Send frames until every output has come: then all processes have found each other.

    Then send a last one and wait for it: frames keep their order, so no other is on its way.
    """
    images = image_pair(0) if frame is None else frame
    last_ns = stamp_ns(header(20_000))
    indices = itertools.count(10_000)  # stamps that stand still are refused

    def all_came() -> bool:
        cameras.send(next(indices), images)
        return all(inbox.messages for inbox in inboxes)

    wait_until(all_came, 'every output', every_s=0.2)
    cameras.send(20_000, images)
    wait_until(lambda: all(last_ns in inbox.by_stamp() for inbox in inboxes), 'the last frame')
    for inbox in inboxes:
        inbox.messages.clear()
