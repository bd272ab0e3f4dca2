# SPDX-License-Identifier: Apache-2.0
"""The filter takes what other matchers publish."""

from __future__ import annotations

import numpy as np
import pytest
from sensor_msgs.msg import CameraInfo, Image
from stereo_msgs.msg import DisparityImage

from binocular_recon.config import FilterConfig, MatchConfig
from binocular_recon.images import to_grey
from binocular_recon.io.disparity_messages import fill_disparity, read_disparity
from binocular_recon.stereo.filtering import filter_disparity
from binocular_recon.stereo.matching import match
from binocular_recon.stereo.rectification import Rectifier
from test import stereo_image_proc
from test.system.conftest import StartNode
from test.system.graph import Graph
from test.system.rig import SIDES, header, image_message, info_message, pictures, raw_rig

CONFIG = MatchConfig(min_disparity=-32, disparity_range=88)
INPUTS = ('left/image_rect', 'left/camera_info', 'right/camera_info', 'disparity')


class Matcher:
    """A rectifier and a matcher that publish no confidence."""

    def __init__(self, graph: Graph) -> None:
        kinds = (Image, CameraInfo, CameraInfo, DisparityImage)
        self.publishers = [
            graph.publisher(f'/rig/{topic}', kind)
            for topic, kind in zip(INPUTS, kinds, strict=True)
        ]

    def send(
        self, index: int, left: np.ndarray, rig: Rectifier, disparity: DisparityImage
    ) -> None:
        cameras = rig.rig.left, rig.rig.right
        infos = [info_message(c, header(index, s)) for c, s in zip(cameras, SIDES, strict=True)]
        disparity.header = header(index)
        messages = [image_message(left, header(index)), *infos, disparity]
        for publisher, message in zip(self.publishers, messages, strict=True):
            publisher.publish(message)


@pytest.fixture(scope='module')
def matcher(graph: Graph, start_node: StartNode) -> Matcher:
    start_node('wls_filter_node')
    return Matcher(graph)


@pytest.mark.parametrize('sender', ['stereo_image_proc', 'ours'])
@pytest.mark.parametrize('offset_px', [-32.8, 0.0, 32.8])
def test_disparity_of_either_convention(
    graph: Graph, matcher: Matcher, offset_px: float, sender: str
) -> None:
    rectify = Rectifier(raw_rig(offset_px))
    left, right = rectify(*pictures(5))
    raw = stereo_image_proc.in_sixteenths(
        match(to_grey(left), to_grey(right), CONFIG).disparity_px
    )
    valid = np.isfinite(raw)
    assert 0.4 < valid.mean() < 0.95
    message = DisparityImage()
    if sender == 'ours':
        fill_disparity(message, raw, rectify.rig, CONFIG.limits_px, header(0), step_px=1 / 64)
    else:
        low, high = CONFIG.limits_px
        stereo_image_proc.fill(message, raw, rectify.rig, (int(low), int(high)))
    with graph.listening(('/rig/disparity_wls', DisparityImage)) as (inbox,):
        graph.wait_for_subscriber(*(f'/rig/{topic}' for topic in INPUTS))
        matcher.send(0, left, rectify, message)
        answer = inbox.wait()[0]
    expected = filter_disparity(
        raw.astype(np.float32),
        valid.astype(np.float32),
        to_grey(left),
        FilterConfig(),
        limits_px=CONFIG.limits_px,
    )
    read = read_disparity(answer, rectify.rig)
    np.testing.assert_allclose(read.disparity_px, expected.disparity_px, atol=1e-3)
    assert answer.delta_d == pytest.approx(message.delta_d)
    window = answer.valid_window
    assert (window.width, window.height) == (left.shape[1], left.shape[0])
