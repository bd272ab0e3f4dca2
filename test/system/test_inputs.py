# SPDX-License-Identifier: Apache-2.0
"""How images arrive: compressed, with different stamps, truncated, while nobody listens."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import CameraInfo, Image

from binocular_recon.io.messages.camera_infos import camera_from_message
from binocular_recon.io.messages.images import read_image, stamp_ns
from binocular_recon.stereo.rectification import Rectifier
from test.system.conftest import StartNode
from test.system.graph import Graph, wait_until
from test.system.rig import (
    CameraPair,
    compressed_message,
    header,
    image_pair,
    raw_rig,
)
from test.unit.io.calibrations.foreign_files import opencv_of_ros

LEFT: tuple[str, type[Image]] = ('/rig/left/image_rect', Image)
RIGHT: tuple[str, type[Image]] = ('/rig/right/image_rect', Image)


@pytest.fixture(scope='module')
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a calibration that OpenCV wrote, with another offset than the cameras state."""
    path = tmp_path_factory.mktemp('calibration')
    opencv_of_ros(path, ('a', 'b'), raw_rig(offset_px=5.0))
    return path


@pytest.fixture(scope='module', autouse=True)
def _node(start_node: StartNode, folder: Path) -> None:
    start_node(
        'rectify_node',
        image_transport='compressed',
        approximate_sync=True,
        approximate_sync_tolerance_seconds=0.004,
        calibration=folder,
        alpha=0.0,
    )


def test_compressed_images_with_different_stamps_and_a_calibration_folder(
    graph: Graph,
) -> None:
    """All at once: each leaves its trace in the rectified image or its header."""
    images = image_pair(4, colour=True)
    cameras = CameraPair(graph, raw_rig(), compressed=True)
    infos = [(f'/rig/{side}/camera_info_rect', CameraInfo) for side in ('left', 'right')]
    with graph.listening(LEFT, RIGHT, *infos) as (left, right, _, right_info):
        graph.wait_for_subscriber(*cameras.topics[::2])
        indices = itertools.count()

        def both_came() -> set[int]:
            index = next(indices)
            late = header(index, 'right')
            late.stamp.nanosec += 2_000_000
            cameras.send(
                index,
                images,
                right_image=compressed_message(images[1], late),
                left_info=None,
                right_info=None,
            )
            return left.by_stamp().keys() & right.by_stamp().keys() & right_info.by_stamp().keys()

        stamp = min(wait_until(both_came, 'both rectified images', every_s=0.1))
        (status,) = graph.next_status('/rig/rectify_node')
    rectify = Rectifier(raw_rig(offset_px=5.0), alpha=0.0)
    for inbox, expected in zip((left, right), rectify(*images), strict=True):
        message = inbox.by_stamp()[stamp]
        assert message.encoding == 'bgr8' and message.header.frame_id.endswith('_optical')
        np.testing.assert_array_equal(read_image(message).image, expected)
    assert right.by_stamp()[stamp].header.frame_id == 'right_optical'
    camera = camera_from_message(right_info.by_stamp()[stamp])
    np.testing.assert_allclose(camera.P, rectify.rig.right.P)
    facts = {item.key: item.value for item in status.values}
    assert 'cx_left - cx_right 5.' in facts['calibration']
    assert 'turned by 0.344 deg against' in facts['left rectified frame']


def test_a_truncated_image_is_named_and_the_next_one_used(graph: Graph) -> None:
    images = image_pair(4)
    cameras = CameraPair(graph, raw_rig(), compressed=True)
    with graph.listening(LEFT) as (inbox,):
        graph.wait_for_subscriber(*cameras.topics[::2])
        cut = compressed_message(images[1], header(20, 'right'), '.jpg')
        cut.data = cut.data[: len(cut.data) // 2]
        cameras.send(20, images, right_image=cut, left_info=None, right_info=None)
        status = graph.wait_for_status('/rig/rectify_node', 'right image is truncated')
        assert status.level == status.ERROR
        cameras.send(21, images, left_info=None, right_info=None)
        assert stamp_ns(inbox.wait()[0].header) == stamp_ns(header(21))


def test_nothing_is_received_without_subscribers(graph: Graph) -> None:
    cameras = CameraPair(graph, raw_rig(), compressed=True)
    publisher = graph.publisher(cameras.topics[0], Image)
    wait_until(lambda: publisher.get_subscription_count() == 0, 'the node to unsubscribe')
    status = graph.wait_for_status('/rig/rectify_node', 'idle: no subscribers on left/')
    assert status.level == status.OK
    with graph.listening(LEFT):
        graph.wait_for_subscriber(cameras.topics[0])
    wait_until(lambda: publisher.get_subscription_count() == 0, 'the node to unsubscribe')


def test_incompatible_qos_is_explained(graph: Graph) -> None:
    keeps = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    with graph.listening(LEFT, qos=keeps):
        status = graph.wait_for_status('/rig/rectify_node', 'is incompatible')
    assert status.level == status.WARN
    assert '/rig/left/image_rect: the QoS of' in status.message
    assert 'transient local' in status.message
    assert 'qos_overrides./rig/left/image_rect.publisher' in status.message
