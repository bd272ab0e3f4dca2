# SPDX-License-Identifier: Apache-2.0
"""Cameras with other names, of two sizes, or that rectify, give what the offline chain gives."""

from __future__ import annotations

import itertools
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest
from sensor_msgs.msg import CameraInfo, Image

from binocular_recon.camera import StereoRig
from binocular_recon.config import ChainConfig
from binocular_recon.stereo.pipeline import Chain
from binocular_recon.stereo.rectification import Rectifier
from test.system.chain import start_chain
from test.system.conftest import StartNode
from test.system.graph import Graph, wait_until
from test.system.rig import SIDES, header, image_message, image_pair, info_message, raw_rig

DEPTH: tuple[str, type[Image]] = ('/rig/depth', Image)
RANGE = {'min_disparity': '0', 'disparity_range': '48'}
CONFIG = ChainConfig.preset('default', min_disparity=0, disparity_range=48)
IMAGES = image_pair(3)


def of_two_sizes() -> tuple[StereoRig, tuple[np.ndarray, np.ndarray]]:
    """Return the rig, and its images, with a right camera of 1.5 times the resolution."""
    rig, (left, right) = raw_rig(), IMAGES
    scale = np.array([[1.5, 0, 0.25], [0, 1.5, 0.25], [0, 0, 1]])
    fine = cv2.resize(right, None, fx=1.5, fy=1.5, interpolation=cv2.INTER_CUBIC)
    size = {'width': fine.shape[1], 'height': fine.shape[0]}
    return StereoRig(rig.left, replace(rig.right, K=scale @ rig.right.K, **size)), (left, fine)


RIG, PAIR = of_two_sizes()
# alpha 0 gives the rectified images another focal length than P of the cameras
CROPPED = Chain(RIG, CONFIG, alpha=0.0)


def depth(graph: Graph, rig: StereoRig, images: Any, topics: dict[str, str]) -> Image:
    """Send a pair on topics named by side and kind until its depth comes, and return that."""
    indices = itertools.count()  # stamps that stand still are refused
    with graph.listening(DEPTH) as (inbox,):

        def came() -> bool:
            index = next(indices)
            for side, image, camera in zip(SIDES, images, (rig.left, rig.right), strict=True):
                infos = graph.publisher(topics[f'{side}_camera_info'], CameraInfo)
                infos.publish(info_message(camera, header(index, side)))
                sender = graph.publisher(topics[f'{side}_image'], Image)
                sender.publish(image_message(image, header(index, side)))
            return bool(inbox.messages)

        wait_until(came, 'a depth image', every_s=0.2)
        return inbox.messages[0]


def check_depth(message: Image, chain: Chain, images: Any) -> None:
    """Compare a depth image with that of the offline chain; other infos give another scale."""
    expected = chain(*images).cloud.depth_m
    assert np.isfinite(expected).mean() > 0.6
    found = np.frombuffer(message.data, np.float32).reshape(message.height, message.width)
    np.testing.assert_allclose(found, expected, rtol=1e-3)


def test_remappings_around_the_launch_file_reach_the_rectifier_only(
    graph: Graph, start_node: StartNode
) -> None:
    """As `SetRemap` in a group gives them to all nodes; topics of the right one are arguments."""
    assert CROPPED.rig.focal_px > 1.01 * RIG.focal_px
    outer = {'left/image_raw': 'cam0/image', 'left/camera_info': 'cam0/info'}
    given = {'right_namespace': '/cams/right', 'right_camera_info': 'cam1/info'}
    given |= {'alpha': '0', 'frame_suffix': '_rectified'}
    nodes = start_chain(start_node, outer, **given, **RANGE)
    topics = {
        'left_image': '/rig/cam0/image',
        'left_camera_info': '/rig/cam0/info',
        'right_image': '/cams/right/image_raw',
        'right_camera_info': '/rig/cam1/info',
    }
    message = depth(graph, RIG, PAIR, topics)
    check_depth(message, CROPPED, PAIR)
    # the frame comes from the rectified image; where tf2_msgs is missing, its transform is said
    assert message.header.frame_id == 'left_optical_rectified'
    said = 'from left_optical to left_optical_rectified is not published, because tf2_msgs'
    offered = bool(graph.node.count_publishers('/tf_static'))
    assert nodes[0].text().count(said) == (0 if offered else 1)
    assert graph.node.count_publishers('/cams/right/camera_info_rect') == 1
    for node in nodes:  # the next test's are to be alone
        assert node.stop() == 0


@pytest.mark.parametrize(('composed', 'count'), [('false', 2), ('true', 1)])
def test_rectified_images_go_to_the_matcher_directly(
    graph: Graph, start_node: StartNode, composed: str, count: int
) -> None:
    rectify = Rectifier(raw_rig())
    images, rig = rectify(*IMAGES), rectify.rig
    given = {'left_image': 'left/image_rect_color', 'right_camera_info': '/cam1/info'}
    started = start_chain(start_node, rectify='false', composed=composed, **given, **RANGE)
    assert len(started) == count
    topics = {
        'left_image': '/rig/left/image_rect_color',
        'left_camera_info': '/rig/left/camera_info',
        'right_image': '/rig/right/image_rect',
        'right_camera_info': '/cam1/info',
    }
    check_depth(depth(graph, rig, images, topics), Chain(rig, CONFIG, rectify=False), images)
    for node in started:  # the next ones are to be alone
        assert node.stop() == 0
