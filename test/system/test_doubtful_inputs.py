# SPDX-License-Identifier: Apache-2.0
"""Inputs that state one thing and hold another: used where that is possible, and said."""

from __future__ import annotations

import itertools
from typing import Any

import cv2
import numpy as np
import pytest
from sensor_msgs.msg import CameraInfo, Image
from stereo_msgs.msg import DisparityImage

from binocular_recon.camera import Camera, StereoRig
from binocular_recon.io.messages.disparities import read_disparity
from binocular_recon.io.messages.images import stamp_ns
from binocular_recon.stereo.diagnosis import EXAMINE_EVERY
from binocular_recon.stereo.orientation import turn
from binocular_recon.stereo.rectification import Rectifier
from test.system.conftest import StartNode
from test.system.graph import Graph, NodeProcess, wait_until
from test.system.rig import (
    HEIGHT,
    WIDTH,
    CameraPair,
    header,
    image_message,
    image_pair,
    info_message,
    raw_rig,
)

pytestmark = pytest.mark.long

MATCH = '/rig/match_node'
RIG = Rectifier(raw_rig()).rig
IMAGES = Rectifier(raw_rig())(*image_pair(6))
DISPARITY: tuple[str, type[DisparityImage]] = ('/rig/disparity', DisparityImage)
_index = itertools.count()


@pytest.fixture(scope='module')
def match_node(start_node: StartNode) -> Any:
    return start_node('match_node', disparity_range=32)


@pytest.fixture
def cameras(graph: Graph, match_node: NodeProcess) -> CameraPair:
    del match_node  # it runs
    return CameraPair(graph, RIG, image='image_rect')


def one_disparity(
    graph: Graph, cameras: CameraPair, images: Any, rig: StereoRig, **changes: Any
) -> np.ndarray:
    """Send a frame and return its raw disparities."""
    with graph.listening(DISPARITY) as (inbox,):
        graph.wait_for_subscriber(*cameras.topics)
        cameras.send(next(_index), images, **changes)
        return read_disparity(inbox.wait()[0], rig).disparity_px


def test_a_baseline_in_millimetres_is_said(graph: Graph, cameras: CameraPair) -> None:
    P = RIG.right.P.copy()
    P[0, 3] *= 1000
    with graph.listening(DISPARITY) as (inbox,):
        graph.wait_for_subscriber(*cameras.topics)
        index = next(_index)
        info = info_message(RIG.right, header(index, 'right'))
        info.p = P.ravel()
        cameras.send(index, IMAGES, right_info=info)
        status = graph.wait_for_status(MATCH, 'the baseline is 250 m, outside 0.01 to 20 m')
        inbox.wait()
    assert status.level == status.WARN
    assert 'if it is in millimetres, divide P[0, 3] by 1000 (0.25 m)' in status.message


def test_infos_of_raw_images_beside_those_of_rectified_ones_are_said(
    graph: Graph, cameras: CameraPair
) -> None:
    """Nodes started one by one, without the parameter: P of the raw infos may have another f."""
    rectified = graph.publisher('/rig/left/camera_info_rect', CameraInfo)
    with graph.listening(DISPARITY) as (inbox,):
        graph.wait_for_subscriber(*cameras.topics)
        raw, index = raw_rig(), next(_index)
        infos = {
            f'{side}_info': info_message(camera, header(index, side))
            for side, camera in (('left', raw.left), ('right', raw.right))
        }
        cameras.send(index, IMAGES, **infos)
        status = graph.wait_for_status(MATCH, 'is that of raw images')
        inbox.wait()
    graph.do(lambda: graph.node.destroy_publisher(rectified))
    assert status.level == status.WARN
    assert '/rig/left/camera_info (f 200.00 px, baseline 0.2500 m)' in status.message
    assert '/rig/left/camera_info_rect is published' in status.message
    assert 'set camera_info to camera_info_rect in match_node and' in status.message


def test_rows_that_are_off_are_said_with_the_number(graph: Graph, cameras: CameraPair) -> None:
    shift = np.array([[1, 0, 0], [0, 1, 1.0]], np.float32)
    lower = cv2.warpAffine(IMAGES[1], shift, IMAGES[1].shape[::-1])
    with graph.listening(DISPARITY) as (inbox,):
        graph.wait_for_subscriber(*cameras.topics)
        for count in range(1, EXAMINE_EVERY + 2):
            cameras.send(next(_index), (IMAGES[0], lower))
            inbox.wait(count)
        status = graph.wait_for_status(MATCH, 'rows of left and right differ by')
    values = {item.key: item.value for item in status.values}
    assert 0.8 < float(values['row offset'].split()[0]) < 1.2
    assert 'the right image is lower' in status.message


def test_thermal_counts_match_like_8_bit(graph: Graph, cameras: CameraPair) -> None:
    plain = one_disparity(graph, cameras, IMAGES, RIG)
    counts = [np.where(image > 0, 21000 + 11 * image.astype(np.uint16), 0) for image in IMAGES]
    index = next(_index)
    messages = {
        f'{side}_image': image_message(image.astype(np.uint16), header(index, side), 'mono16')
        for side, image in zip(('left', 'right'), counts, strict=True)
    }
    with graph.listening(DISPARITY) as (inbox,):
        graph.wait_for_subscriber(*cameras.topics)
        cameras.send(index, IMAGES, **messages)
        thermal = read_disparity(inbox.wait()[0], RIG).disparity_px
    both = np.isfinite(plain) & np.isfinite(thermal)
    assert both.mean() > 0.9 * np.isfinite(plain).mean()
    assert np.mean(np.abs(plain - thermal)[both] < 0.25) > 0.98


def test_cameras_one_above_the_other(graph: Graph, cameras: CameraPair) -> None:
    """The images of the rig on its side; turned counter-clockwise they are those of the rig."""
    lying = one_disparity(graph, cameras, IMAGES, RIG)

    def standing(camera: Camera) -> Camera:
        (fx, _, cx, tx), (_, fy, cy, _) = camera.P[:2]
        P = np.array([[fy, 0, HEIGHT - 1 - cy, 0], [0, fx, cx, tx], [0, 0, 1, 0]])
        return Camera(HEIGHT, WIDTH, P[:, :3], np.zeros(5), np.eye(3), P)

    rig = StereoRig(standing(RIG.left), standing(RIG.right))
    upright = CameraPair(graph, rig, image='image_rect')
    images = turn(IMAGES[0], -1), turn(IMAGES[1], -1)
    found = one_disparity(graph, upright, images, rig)
    np.testing.assert_allclose(turn(found, 1), lying, atol=1e-3)


def test_other_names_and_another_clock(graph: Graph, start_node: StartNode) -> None:
    """One line in the log; frames are paired by stamps of the left clock."""
    node = start_node('rectify_node', stamp_offset=-0.04)
    rig = raw_rig()
    cameras = CameraPair(graph, rig)

    def late(message: Any) -> Any:
        message.header.stamp.nanosec += 40_000_000
        return message

    def renamed(camera: Camera, head: Any) -> CameraInfo:
        message = info_message(camera, head)
        message.distortion_model = 'radtan'
        message.d = [*camera.D, 0.0, 0.0, 0.0]
        return message

    output: tuple[str, type[Image]] = ('/rig/right/image_rect', Image)
    pair = image_pair(6)
    with graph.listening(output) as (inbox,):
        graph.wait_for_subscriber(*cameras.topics)
        for count in (1, 2):
            index = next(_index)
            cameras.send(
                index,
                pair,
                left_info=renamed(rig.left, header(index)),
                right_info=late(renamed(rig.right, header(index, 'right'))),
                right_image=late(image_message(pair[1], header(index, 'right'))),
            )
            inbox.wait(count)
    assert [stamp_ns(message.header) for message in inbox.messages][-1] == stamp_ns(header(index))
    notice = "left camera: distortion model 'radtan' is read as plumb_bob"
    assert node.text().count(notice) == 1
    assert 'left camera: 8 coefficients of plumb_bob are read as 4: the rest is 0' in node.text()


def test_the_constant_between_the_clocks_is_measured(graph: Graph, start_node: StartNode) -> None:
    start_node('rectify_node', namespace='/other')
    names = ('left/image_raw', 'left/camera_info', 'right/image_raw', 'right/camera_info')
    kinds = (Image, CameraInfo) * 2
    publishers = {
        name: graph.publisher(f'/other/{name}', kind)
        for name, kind in zip(names, kinds, strict=True)
    }
    rig, pair = raw_rig(), image_pair(6)
    output: tuple[str, type[Image]] = ('/other/right/image_rect', Image)

    def send() -> bool:
        index = next(_index)
        for side, camera, image in zip(
            ('left', 'right'), (rig.left, rig.right), pair, strict=True
        ):
            head = header(index, side)
            head.stamp.sec += 3600 * (side == 'right')
            publishers[f'{side}/camera_info'].publish(info_message(camera, head))
            publishers[f'{side}/image_raw'].publish(image_message(image, head))
        status = graph.status('/other/rectify_node')
        return status is not None and 'set stamp_offset to -3600.0' in status.message

    with graph.listening(output) as (inbox,):
        graph.wait_for_subscriber(*(f'/other/{name}' for name in names))
        wait_until(send, 'the constant in the status', every_s=0.1)
    status: Any = graph.status('/other/rectify_node')
    assert 'its clock is 3600000.000 ms ahead, a constant' in status.message
    assert inbox.messages == []
    assert 'or pairing to arrival' in status.message
