# SPDX-License-Identifier: Apache-2.0
"""Cameras: publish recorded pairs at a rate, from ``python -m ... NAMESPACE FILE.npz``.

Commands on stdin: ``rate R`` publishes R pairs a second from now on, 0 none. After each change
the number of pairs sent so far is written.
"""

from __future__ import annotations

import json
import struct
import sys
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import serialize_message
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import Header

from binocular_recon.camera import Camera
from binocular_recon.io.messages.camera_infos import fill_camera_info
from binocular_recon.io.messages.images import fill_image

_SIDES = ('left', 'right')
# Where the stamp is in the serialised bytes of a message that begins with its header.
_STAMP_OFFSET, _STAMP = 4, '<iI'


class Producer:
    """Publishers of a pair of cameras; messages are serialised once, only stamps change.

    Parameters
    ----------
    node : Node
        Node that publishes.
    path : Path
        ``left`` and ``right``, (N, H, W, 3) uint8 BGR, and K, D, R and P of each.

    """

    def __init__(self, node: Node, path: Path) -> None:
        self._messages: list[list[tuple[Any, bytearray]]] = []
        qos = QoSProfile(depth=2, reliability=ReliabilityPolicy.RELIABLE)
        with np.load(path) as arrays:
            frames = {side: arrays[side] for side in _SIDES}
            height, width = frames['left'].shape[1:3]
            cameras = {
                side: Camera(width, height, *(arrays[f'{side}_{name}'] for name in 'KDRP'))
                for side in _SIDES
            }
        publishers = {
            side: (
                node.create_publisher(CameraInfo, f'{side}/camera_info', qos),
                node.create_publisher(Image, f'{side}/image_raw', qos),
            )
            for side in _SIDES
        }
        for index in range(len(frames['left'])):
            parts = []
            for side in _SIDES:
                header = Header(frame_id=side)
                info, image = CameraInfo(), Image()
                fill_camera_info(info, cameras[side], header)
                fill_image(image, frames[side][index], 'bgr8', header)
                for publisher, message in zip(publishers[side], (info, image), strict=True):
                    parts.append((publisher, bytearray(serialize_message(message))))
            self._messages.append(parts)
        self.sent = 0

    def send(self) -> None:
        """Publish the next pair, stamped now."""
        stamp = divmod(time.time_ns(), 1_000_000_000)
        for publisher, data in self._messages[self.sent % len(self._messages)]:
            struct.pack_into(_STAMP, data, _STAMP_OFFSET, *stamp)
            publisher.publish(bytes(data))
        self.sent += 1


def main(arguments: Sequence[str]) -> None:
    """Publish until stdin ends."""
    namespace, path = arguments
    rclpy.init(args=[])
    node = Node('producer', namespace=namespace)
    producer = Producer(node, Path(path))
    rate_hz, changed, ended = 0.0, threading.Event(), threading.Event()

    def obey() -> None:
        nonlocal rate_hz
        for line in sys.stdin:
            rate_hz = float(line.split()[1])
            changed.set()
        ended.set()
        changed.set()

    threading.Thread(target=obey, daemon=True).start()
    due_s = time.monotonic()
    while not ended.is_set():
        if changed.is_set():
            changed.clear()
            sys.stdout.write(json.dumps({'sent': producer.sent}) + '\n')
            sys.stdout.flush()
            due_s = time.monotonic()
        if rate_hz <= 0:
            changed.wait()
            continue
        period_s = 1 / (rate_hz or 1.0)  # another thread sets the rate
        producer.send()
        # a pair that is late is sent at once, but pairs that are missed are not made up for
        due_s = max(due_s + period_s, time.monotonic() - period_s)
        changed.wait(max(0.0, due_s - time.monotonic()))
    node.destroy_node()
    rclpy.shutdown()


if __name__ == '__main__':
    main(sys.argv[1:])
