# SPDX-License-Identifier: Apache-2.0
"""Where the middleware does not report matches, a node polls for subscribers."""

from __future__ import annotations

import threading
from functools import partial
from typing import Any

import pytest
import rclpy
from rclpy.event_handler import UnsupportedEventTypeError
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import CameraInfo, Image

from binocular_recon.nodes.rectify_node import RectifyNode
from test.system.graph import Graph, wait_until


def test_a_node_finds_subscribers_without_events(
    graph: Graph, monkeypatch: pytest.MonkeyPatch
) -> None:
    create: Any = Node.create_publisher

    def without_matches(*positional: Any, **named: Any) -> Any:
        events = named.get('event_callbacks')
        if events is not None and events.matched is not None:
            raise UnsupportedEventTypeError('matched')
        return create(*positional, **named)

    monkeypatch.setattr(Node, 'create_publisher', without_matches)
    rclpy.init(
        args=['--ros-args', '-r', '__ns:=/rig'], signal_handler_options=SignalHandlerOptions.NO
    )
    node = RectifyNode()
    thread = threading.Thread(target=partial(_spin, node))
    thread.start()
    try:
        publisher = graph.publisher('/rig/left/camera_info', CameraInfo)
        _wait_for_count(publisher, 0)
        with graph.listening(('/rig/left/image_rect', Image)):
            _wait_for_count(publisher, 1)
        _wait_for_count(publisher, 0)
    finally:
        rclpy.shutdown()
        thread.join()
        node.destroy_node()


def _spin(node: Node) -> None:
    try:
        rclpy.spin(node)
    except ExternalShutdownException:
        return


def _wait_for_count(publisher: Any, count: int) -> None:
    wait_until(lambda: publisher.get_subscription_count() == count, f'{count} subscriptions')
