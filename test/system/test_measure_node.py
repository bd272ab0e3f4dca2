# SPDX-License-Identifier: Apache-2.0
"""Points that are clicked in RViz are measured in the newest cloud."""

from __future__ import annotations

import json
from functools import partial
from typing import Any

import numpy as np
from geometry_msgs.msg import PointStamped
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import PointCloud2, PointField
from std_msgs.msg import Header, String
from std_srvs.srv import Trigger
from visualization_msgs.msg import Marker, MarkerArray

from binocular_recon.io.messages.clouds import fill_cloud
from binocular_recon.stereo.triangulation import Cloud
from test.system.conftest import StartNode
from test.system.graph import Graph, wait_until

FOCAL_PX, DEPTH_M = 400.0, 10.0
LATCHED = QoSProfile(
    depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL
)


def wall(header: Header) -> PointCloud2:
    """Return the cloud of a wall that faces the camera, known to 2 cm."""
    rows, columns = np.mgrid[:120, :160].astype(np.float64)
    rays = np.stack([(columns - 80) / FOCAL_PX, (rows - 60) / FOCAL_PX, np.ones_like(rows)], -1)
    points = (DEPTH_M * rays).astype(np.float32)
    message = PointCloud2()
    fill_cloud(
        message, Cloud(points, np.full((120, 160, 1), 0.02, np.float32)), header, PointField
    )
    return message


def click(place: tuple[float, float, float], frame: str = 'left') -> PointStamped:
    message = PointStamped(header=Header(frame_id=frame))
    message.point.x, message.point.y, message.point.z = place
    return message


def _said(node: Any, text: str) -> bool:
    return text in node.text()


def test_two_clicks_give_a_length_that_stays(graph: Graph, start_node: StartNode) -> None:
    node = start_node('measure_node')
    clouds = graph.publisher('/rig/points2', PointCloud2)
    clicks = graph.publisher('/rig/clicked_point', PointStamped)
    graph.wait_for_subscriber('/rig/points2', '/rig/clicked_point')
    cloud = wall(Header(frame_id='left'))

    def received() -> bool:
        clouds.publish(cloud)
        status = graph.status('/rig/measure_node', of='measuring')
        return status is not None and status.message == '0 points clicked'

    wait_until(received, 'a cloud', every_s=0.2)
    for message, answer in (
        (click((0.0, 0.0, DEPTH_M), 'map'), "clicked in the frame 'map'"),
        (click((0.01, -0.01, DEPTH_M + 0.02)), '1 of 2 points of distance clicked'),
        (click((1.0, 0.0, DEPTH_M)), ' +- '),
    ):
        clicks.publish(message)
        wait_until(partial(_said, node, answer), answer)
    # who comes later gets the result too
    (result,) = graph.inbox('/rig/measurements', String, LATCHED).wait()
    content = json.loads(result.data)
    assert content['kind'] == 'distance' and content['frame_id'] == 'left'
    length = content['length']
    assert abs(length['value'] - 1.0) < 0.03 and 0.02 < length['sigma'] < 0.1
    assert content['text'] == f'{length["value"]:.3f} +- {length["sigma"]:.3f} m'
    assert content['sigma'].startswith('matching only')
    (marked,) = graph.inbox('/rig/measurement_markers', MarkerArray, LATCHED).wait()
    line, label = marked.markers
    assert (line.type, label.type) == (Marker.LINE_STRIP, Marker.TEXT_VIEW_FACING)
    assert label.text == content['text'] and label.header.frame_id == 'left'
    assert abs(line.points[1].x - line.points[0].x - length['value']) < 0.01
    assert min(line.color.a, label.color.a, line.scale.x, label.scale.z) > 0
    cleared = graph.call('/rig/measure_node/clear', Trigger, Trigger.Request())
    assert cleared.success and cleared.message == '2 points forgotten'
    markers = graph.inbox('/rig/measurement_markers', MarkerArray, LATCHED).wait()
    assert [one.action for one in markers[-1].markers] == [Marker.DELETEALL]
