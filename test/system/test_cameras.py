# SPDX-License-Identifier: Apache-2.0
"""Cameras with topics of other names, or that rectify, give what the offline chain gives."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from sensor_msgs.msg import CameraInfo, Image
from stereo_msgs.msg import DisparityImage

from binocular_recon.camera import StereoRig
from binocular_recon.config import ChainConfig
from binocular_recon.stereo.pipeline import Chain
from binocular_recon.stereo.rectification import Rectifier
from test.system.chain import start_chain
from test.system.conftest import StartNode
from test.system.graph import Graph, NodeProcess, wait_until
from test.system.rig import SIDES, header, image_message, image_pair, info_message, raw_rig

DEPTH: tuple[str, type[Image]] = ('/rig/depth', Image)
RANGE = {'min_disparity': '0', 'disparity_range': '48'}
CONFIG = ChainConfig.preset('default', min_disparity=0, disparity_range=48)
IMAGES = image_pair(3)
# alpha 0 gives the rectified images another focal length than P of the cameras
CROPPED = Chain(raw_rig(), CONFIG, alpha=0.0)


def depth(graph: Graph, rig: StereoRig, images: Any, topics: dict[str, str]) -> np.ndarray:
    """Send a pair on topics named by side and kind until its depth comes, and return that."""
    with graph.listening(DEPTH) as (inbox,):

        def came() -> bool:
            for side, image, camera in zip(SIDES, images, (rig.left, rig.right), strict=True):
                infos = graph.publisher(topics[f'{side}_camera_info'], CameraInfo)
                infos.publish(info_message(camera, header(1, side)))
                sender = graph.publisher(topics[f'{side}_image'], Image)
                sender.publish(image_message(image, header(1, side)))
            return bool(inbox.messages)

        wait_until(came, 'a depth image', every_s=0.2)
        message = inbox.messages[0]
    return np.frombuffer(message.data, np.float32).reshape(message.height, message.width)


def check_depth(found: np.ndarray, chain: Chain, images: Any) -> None:
    """Compare a depth image with that of the offline chain: 39 % were wrong with other infos."""
    expected = chain(*images).cloud.depth_m
    assert np.isfinite(expected).mean() > 0.6
    np.testing.assert_allclose(found, expected, rtol=1e-3)


def end(nodes: list[NodeProcess]) -> None:
    """Stop the nodes, so that the next test's are alone."""
    for node in nodes:
        assert node.stop() == 0


def test_a_remapping_around_the_launch_file_reaches_the_rectifier_only(
    graph: Graph, start_node: StartNode
) -> None:
    """As `SetRemap` in a group, or a driver's launch file, gives it to all three nodes."""
    assert CROPPED.rig.focal_px > 1.01 * raw_rig().focal_px
    names = {'left/image_raw': 'cam0/image', 'left/camera_info': 'cam0/info'}
    names |= {'right/image_raw': 'cam1/image', 'right/camera_info': 'cam1/info'}
    nodes = start_chain(start_node, names, alpha='0', **RANGE)
    topics = {f'{side}_image': f'/rig/cam{i}/image' for i, side in enumerate(SIDES)}
    topics |= {f'{side}_camera_info': f'/rig/cam{i}/info' for i, side in enumerate(SIDES)}
    check_depth(depth(graph, raw_rig(), IMAGES, topics), CROPPED, IMAGES)
    end(nodes)


def test_topics_and_namespaces_of_the_cameras_are_arguments(
    graph: Graph, start_node: StartNode
) -> None:
    given = {'left_image': '/cam0/image', 'left_camera_info': 'cam0/info'}
    nodes = start_chain(start_node, alpha='0', right_namespace='/cams/right', **given, **RANGE)
    topics = {
        'left_image': '/cam0/image',
        'left_camera_info': '/rig/cam0/info',
        'right_image': '/cams/right/image_raw',
        'right_camera_info': '/cams/right/camera_info',
    }
    check_depth(depth(graph, raw_rig(), IMAGES, topics), CROPPED, IMAGES)
    assert graph.node.count_publishers('/cams/right/camera_info_rect') == 1
    end(nodes)


@pytest.mark.parametrize('named', [False, True])
def test_rectified_images_go_to_the_matcher_directly(
    graph: Graph, start_node: StartNode, named: bool
) -> None:
    rectify = Rectifier(raw_rig())
    images, rig = rectify(*IMAGES), rectify.rig
    kinds = {'image': 'image_rect', 'camera_info': 'camera_info'}
    topics = {f'{side}_{kind}': f'/rig/{side}/{kinds[kind]}' for side in SIDES for kind in kinds}
    given = {}
    if named:
        given = {'left_image': 'left/image_rect_color', 'right_camera_info': '/cam1/info'}
        topics |= {'left_image': '/rig/left/image_rect_color', 'right_camera_info': '/cam1/info'}
    nodes = start_chain(start_node, rectify='false', **given, **RANGE)
    assert len(nodes) == 2
    check_depth(depth(graph, rig, images, topics), Chain(rig, CONFIG, rectify=False), images)
    end(nodes)


def test_infos_of_raw_images_beside_those_of_rectified_ones_are_said(
    graph: Graph, start_node: StartNode
) -> None:
    """Nodes started one by one, without the parameter: P of the raw infos has another f."""
    graph.publisher('/rig/left/camera_info_rect', CameraInfo)
    node = start_node('match_node', disparity_range=32)
    rig = raw_rig()
    with graph.listening(('/rig/disparity', DisparityImage)):
        for side, image, camera in zip(SIDES, IMAGES, (rig.left, rig.right), strict=True):
            graph.publisher(f'/rig/{side}/image_rect', Image)
            graph.publisher(f'/rig/{side}/camera_info', CameraInfo)
            graph.wait_for_subscriber(f'/rig/{side}/image_rect', f'/rig/{side}/camera_info')
            sent = image_message(image, header(2, side)), info_message(camera, header(2, side))
            graph.publisher(f'/rig/{side}/image_rect', Image).publish(sent[0])
            graph.publisher(f'/rig/{side}/camera_info', CameraInfo).publish(sent[1])
        status = graph.wait_for_status('/rig/match_node', 'is that of raw images')
    assert status.level == status.WARN
    assert '/rig/left/camera_info (f 200.00 px, baseline 0.2500 m)' in status.message
    assert '/rig/left/camera_info_rect is published' in status.message
    assert (
        'set camera_info to camera_info_rect in match_node and wls_filter_node' in status.message
    )
    end([node])
