# SPDX-License-Identifier: Apache-2.0
"""The three nodes together, wired as the launch file wires them."""

from __future__ import annotations

from typing import Any

from sensor_msgs.msg import CameraInfo, Image, PointCloud2
from stereo_msgs.msg import DisparityImage

from binocular_recon.io.messages.images import stamp_ns
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
    'disparity_wls': DisparityImage,
    'points2': PointCloud2,
    'depth': Image,
    'depth/camera_info': CameraInfo,
    'disparity_color': Image,
}
RAW = [f'{side}/{topic}' for side in SIDES for topic in ('image_raw', 'camera_info')]
RECTIFIED = [f'{side}/{topic}' for side in SIDES for topic in ('image_rect', 'camera_info_rect')]
MEASURED = ['disparity', 'confidence', 'left/image_rect', *RECTIFIED[1::2]]


def reliable(topics: list[str], depth: int = 0) -> dict[str, object]:
    """Return the parameters that make subscriptions reliable, and deeper if ``depth`` says so."""
    prefixes = [f'qos_overrides./rig/{topic}.subscription' for topic in topics]
    parameters: dict[str, object] = {f'{one}.reliability': 'reliable' for one in prefixes}
    return parameters | ({f'{one}.depth': depth for one in prefixes} if depth else {})


def start_chain(start_node: StartNode, **match_options: object) -> list[NodeProcess]:
    """Start the chain, reliable from the cameras on."""
    infos = {f'{side}/camera_info': f'{side}/camera_info_rect' for side in SIDES}
    return [
        start_node('rectify_node', **reliable(RAW)),
        start_node('match_node', remaps=infos, **reliable(RECTIFIED), **match_options),
        start_node('wls_filter_node', remaps=infos, **reliable(MEASURED)),
    ]


def prime(cameras: CameraPair, inboxes: list[Inbox], frame: Any = None) -> None:
    """Send frames until every output has come: then all processes have found each other.

    Then send a last one and wait for it: frames keep their order, so no other is on its way.
    """
    images = image_pair(0) if frame is None else frame
    last_ns = stamp_ns(header(20_000))

    def all_came() -> bool:
        cameras.send(10_000, images)
        return all(inbox.messages for inbox in inboxes)

    wait_until(all_came, 'every output', every_s=0.2)
    cameras.send(20_000, images)
    wait_until(lambda: all(last_ns in inbox.by_stamp() for inbox in inboxes), 'the last frame')
    for inbox in inboxes:
        inbox.messages.clear()
