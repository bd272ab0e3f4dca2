# SPDX-License-Identifier: Apache-2.0
"""The filter node states the uncertainty of matching and calibration together."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from sensor_msgs.msg import PointCloud2
from stereo_msgs.msg import DisparityImage

from binocular_recon.cloud_config import CloudConfig
from binocular_recon.config import FilterConfig, MatchConfig
from binocular_recon.images import mark_empty, to_grey
from binocular_recon.io.calibration_yaml import read_rig, write_rig
from binocular_recon.io.messages.disparities import fill_disparity
from binocular_recon.stereo.filtering.wls_filter import filter_disparity
from binocular_recon.stereo.matching import disparity_step_px, match
from binocular_recon.stereo.rectification import Rectifier
from binocular_recon.stereo.triangulation import triangulate
from test.calibration_tools import write_covariance
from test.system.conftest import StartNode
from test.system.graph import Graph, wait_until
from test.system.rig import SIDES, header, image_message, image_pair, info_message, raw_rig

CONFIG = MatchConfig(min_disparity=-32, disparity_range=88)
TOPICS = (
    '/rig/left/image_rect',
    '/rig/left/camera_info',
    '/rig/right/camera_info',
    '/rig/disparity',
)


def test_a_calibration_folder_adds_the_share_of_the_calibration(
    graph: Graph, start_node: StartNode, tmp_path: Path
) -> None:
    """Points carry sigma_x, sigma_y and sigma_z of matching and calibration together."""
    calibrated = raw_rig()
    write_rig(tmp_path, calibrated)
    write_covariance(tmp_path, calibrated)
    start_node('wls_filter_node', calibration=tmp_path)
    rectify = Rectifier(read_rig(tmp_path))
    left, right = rectify(*image_pair(3))
    grey_left, grey_right = to_grey(left), to_grey(right)
    mark_empty(grey_left)
    mark_empty(grey_right)
    matched = match(grey_left, grey_right, CONFIG)
    disparity = DisparityImage()
    fill_disparity(
        disparity,
        matched.disparity_px,
        rectify.rig,
        CONFIG.limits_px,
        header(3),
        step_px=disparity_step_px(CONFIG),
    )
    cameras = [
        info_message(camera, header(3, side))
        for side, camera in zip(SIDES, (rectify.rig.left, rectify.rig.right), strict=True)
    ]
    frame = dict(zip(TOPICS, (image_message(left, header(3)), *cameras, disparity), strict=True))
    publishers = [
        (graph.publisher(topic, type(message)), message) for topic, message in frame.items()
    ]
    with graph.listening(('/rig/points2', PointCloud2)) as (points,):

        def came() -> bool:
            for publisher, message in publishers:
                publisher.publish(message)
            return bool(points.messages)

        wait_until(came, 'a cloud', every_s=0.2)
    message = points.messages[0]
    filtered = filter_disparity(
        matched.disparity_px,
        np.isfinite(matched.disparity_px).astype(np.float32),
        grey_left,
        FilterConfig(),
        limits_px=CONFIG.limits_px,
    )
    expected = triangulate(
        filtered.disparity_px, filtered.sigma_px, filtered.validity, rectify.rig, CloudConfig()
    )
    assert expected.calibrated
    places = {field.name: field.offset for field in message.fields}
    for name, sigma in expected.sigmas_m.items():
        layout = np.dtype(
            {'names': ['s'], 'formats': ['<f4'], 'offsets': [places[name]],
             'itemsize': message.point_step}
        )  # fmt: skip
        read = np.frombuffer(message.data, layout)['s'].reshape(sigma.shape)
        np.testing.assert_allclose(read, sigma, rtol=2e-2)
    facts = {
        item.key: item.value for item in graph.wait_for_status('/rig/wls_filter_node', '').values
    }
    assert facts['sigma'] == 'matching and calibration'
