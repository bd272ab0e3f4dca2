# SPDX-License-Identifier: Apache-2.0
"""A network in place of our matcher, in the node that goes from images to the cloud."""

from __future__ import annotations

import itertools
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from sensor_msgs.msg import CameraInfo, Image, PointCloud2
from stereo_msgs.msg import DisparityImage

from binocular_recon.io.messages.disparities import read_disparity
from binocular_recon.stereo.rectification import Rectifier
from test.system.chain import reliable
from test.system.conftest import StartNode
from test.system.graph import Graph, NodeProcess, wait_until
from test.system.rig import SIDES, header, image_message, image_pair, info_message, raw_rig
from test.tiny_networks import block_matcher, onnx

RECTIFY = Rectifier(raw_rig(0.0))
PAIR = RECTIFY(*image_pair(5, colour=True))
INPUTS: dict[str, type[Any]] = {
    'left/image_rect': Image,
    'right/image_rect': Image,
    'left/camera_info': CameraInfo,
    'right/camera_info': CameraInfo,
}


def test_a_network_makes_the_cloud_and_a_damaged_one_drops_frames(
    graph: Graph, start_node: StartNode, tmp_path: Path
) -> None:
    path = tmp_path / 'network.onnx'
    onnx.save(block_matcher(['n', 3, 'h', 'w'], disparities=30), str(path))
    network = path.read_bytes()
    parameters = {'matcher': 'onnx', 'onnx_model': str(path), 'disparity_range': '32'}
    node: NodeProcess = start_node(
        'stereo_node', rectify='false', **parameters, **reliable(list(INPUTS))
    )
    indices = itertools.count()

    def send() -> None:
        index = next(indices)
        cameras = RECTIFY.rig.left, RECTIFY.rig.right
        infos = (info_message(c, header(index, s)) for c, s in zip(cameras, SIDES, strict=True))
        images = (image_message(i, header(index, s)) for i, s in zip(PAIR, SIDES, strict=True))
        for topic, message in zip(INPUTS, (*images, *infos), strict=True):
            graph.publisher(f'/rig/{topic}', INPUTS[topic]).publish(message)

    outputs = (('/rig/disparity_wls', DisparityImage), ('/rig/points2', PointCloud2))
    with graph.listening(*outputs) as (disparities, clouds):
        for topic, kind in INPUTS.items():
            graph.publisher(f'/rig/{topic}', kind)
        graph.wait_for_subscriber(*(f'/rig/{topic}' for topic in INPUTS))
        send()
        found = read_disparity(disparities.wait()[0], RECTIFY.rig).disparity_px
        cloud = clouds.wait()[0]
        path.write_bytes(network[:100])
        send()
        wait_until(partial(_holds, node, 'is damaged, or no network'), 'the damage in the log')
        path.write_bytes(network)
        send()
        disparities.wait(2)
    row = np.arange(found.shape[0])[:, None]
    wall = 8 + 6 * row / found.shape[0]  # whole disparities, smoothed by the filter
    inner = np.s_[10:110, 20:150]
    error = np.minimum(np.abs(found - wall), np.abs(found - wall - 8))[inner]  # or the box
    assert np.median(error) < 0.5 and np.mean(error < 1.5) > 0.9
    assert cloud.width * cloud.height == found.size and not cloud.is_dense
    status = graph.wait_for_status('/rig/stereo_node', 'is damaged')
    values = {item.key: item.value for item in status.values}
    assert sum(int(v) for k, v in values.items() if k.startswith('dropped: ')) == 1
    assert 'Traceback' not in node.text()


def _holds(node: NodeProcess, text: str) -> bool:
    return text in node.text()
