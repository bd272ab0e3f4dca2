# SPDX-License-Identifier: Apache-2.0
"""A subscriber that writes when messages come, and what the nodes report.

Commands on stdin: ``listen TOPIC TYPE ...`` subscribes to these topics, ``listen`` alone to none.
Each message gives ``{"topic", "stamp_ns", "arrived_ns"}``, each status of a node
``{"node", "values"}``.
"""

from __future__ import annotations

import functools
import json
import queue
import struct
import sys
import threading
import time
from collections.abc import Sequence
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import CameraInfo, Image, PointCloud2
from stereo_msgs.msg import DisparityImage

_TYPES = {kind.__name__: kind for kind in (CameraInfo, Image, PointCloud2, DisparityImage)}
_STAMP_OFFSET, _STAMP = 4, '<iI'


class Listener:
    """Subscriptions of a node; messages are not decoded, only their stamps are read."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._subscriptions: list[Any] = []
        node.create_subscription(DiagnosticArray, '/diagnostics', self._report, 50)

    def listen(self, topics: Sequence[tuple[str, str]]) -> None:
        """Subscribe to these topics, pairs of name and type, and no others."""
        for subscription in self._subscriptions:
            self._node.destroy_subscription(subscription)
        qos = QoSProfile(depth=2, reliability=ReliabilityPolicy.RELIABLE)
        self._subscriptions = [
            self._node.create_subscription(
                _TYPES[kind], topic, functools.partial(self._receive, topic), qos, raw=True
            )
            for topic, kind in topics
        ]

    def _receive(self, topic: str, data: bytes) -> None:
        arrived_ns = time.time_ns()
        sec, nanosec = struct.unpack_from(_STAMP, data, _STAMP_OFFSET)
        stamp_ns = sec * 1_000_000_000 + nanosec
        _write({'topic': topic, 'stamp_ns': stamp_ns, 'arrived_ns': arrived_ns})

    def _report(self, message: DiagnosticArray) -> None:
        for status in message.status:
            values = {pair.key: pair.value for pair in status.values}
            _write({'node': f'/{status.hardware_id}', 'values': values})


def _write(content: dict[str, Any]) -> None:
    sys.stdout.write(json.dumps(content) + '\n')
    sys.stdout.flush()


def main() -> None:
    """Listen until stdin ends."""
    commands: queue.SimpleQueue[str | None] = queue.SimpleQueue()

    def read() -> None:
        for line in sys.stdin:
            commands.put(line)
        commands.put(None)

    threading.Thread(target=read, daemon=True).start()
    rclpy.init(args=[])
    node = Node('listener')
    listener = Listener(node)
    while True:
        rclpy.spin_once(node, timeout_sec=0.05)
        if commands.empty():
            continue
        line = commands.get()
        if line is None:
            break
        words = line.split()[1:]
        listener.listen(list(zip(words[::2], words[1::2], strict=True)))
    node.destroy_node()
    rclpy.shutdown()


if __name__ == '__main__':
    main()
