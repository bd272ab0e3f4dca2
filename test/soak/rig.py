# SPDX-License-Identifier: Apache-2.0
"""A rig for soaking: cameras that can fail in many ways, its nodes, and what comes of it."""

from __future__ import annotations

import dataclasses
import random
import threading
import time
from collections import deque
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from builtin_interfaces.msg import Time
from rclpy.serialization import serialize_message
from sensor_msgs.msg import CameraInfo, Image, PointCloud2
from std_msgs.msg import Header

from binocular_recon.camera import StereoRig
from binocular_recon.io.messages.images import stamp_ns
from test.launch_tools import launched_nodes
from test.system.graph import RELIABLE, Graph, NodeProcess
from test.system.rig import SIDES, image_message, image_pair, info_message, raw_rig

RATE_HZ = 8.0
SIZES = ((160, 120), (192, 144))
Spoil = Callable[[Any, random.Random], Any]


class Cameras:
    """A pair of cameras that publish in a thread of their own.

    Attributes
    ----------
    rate_hz : float
        Pairs a second.
    sides : tuple of str
        Cameras that send.
    offset_ns : int
        Added to the clock of the stamps.
    size : (int, int)
        Width and height of the images.
    frozen_ns : int
        What the clock shows if it stands still, else 0.
    late_s : float
        How much later the right camera's messages are sent.
    colour : bool
        Whether images are bgr8, or mono8.
    spoil : callable, optional
        Damages a message.
    sent_s : dict
        When each pair was sent, by its stamp.

    """

    def __init__(self, graph: Graph, namespace: str) -> None:
        self.rate_hz, self.sides = RATE_HZ, SIDES
        self.offset_ns = self.frozen_ns = 0
        self.late_s, self.colour = 0.0, True
        self.spoil: Spoil | None = None
        self.sent_s: dict[int, float] = {}
        self._random = random.Random(0)
        self._waiting: deque[tuple[float, Any, Any]] = deque()
        self._publishers = {
            (side, kind): graph.publisher(f'/{namespace}/{side}/{topic}', kind)
            for side in SIDES
            for topic, kind in (('camera_info', CameraInfo), ('image_raw', Image))
        }
        self.resize(SIZES[0])
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def resize(self, size: tuple[int, int], *, baseline: float = 1.0) -> None:
        """Change the images' size and the calibration; ``baseline`` is a factor."""
        self.size = size
        rig = raw_rig(0.0, *size)
        P = rig.right.P.copy()
        P[0, 3] *= baseline
        rig = StereoRig(rig.left, dataclasses.replace(rig.right, P=P))
        pair = image_pair(3, *size, colour=True)
        grey = pair[0][..., 1].copy(), pair[1][..., 1].copy()
        self._content = rig, {True: pair, False: grey}

    def close(self) -> None:
        """Stop."""
        self._ended.set()
        self._thread.join()

    def _run(self) -> None:
        due_s = time.monotonic()
        while not self._ended.wait(max(0.0, due_s - time.monotonic())):
            self._send()
            due_s = max(due_s + 1 / self.rate_hz, time.monotonic() - 0.1)

    def _send(self) -> None:
        now_ns = self.frozen_ns or time.time_ns() + self.offset_ns
        now_s = time.monotonic()
        stamp = Time(sec=now_ns // 1_000_000_000, nanosec=now_ns % 1_000_000_000)
        rig, images = self._content
        for side, camera, image in zip(
            SIDES, (rig.left, rig.right), images[self.colour], strict=True
        ):
            if side not in self.sides:
                continue
            head = Header(stamp=stamp, frame_id=side)
            for message in (info_message(camera, head), image_message(image, head)):
                due_s = now_s + (self.late_s if side == 'right' else 0.0)
                spoilt = self.spoil(message, self._random) if self.spoil else message
                self._waiting.append((due_s, self._publishers[side, type(message)], spoilt))
        if self.sides == SIDES:
            self.sent_s[now_ns] = now_s
            while len(self.sent_s) > 2000:
                del self.sent_s[next(iter(self.sent_s))]
        still = deque[tuple[float, Any, Any]]()
        while self._waiting:
            due_s, publisher, message = self._waiting.popleft()
            if due_s <= time.monotonic():
                publisher.publish(message)
            else:
                still.append((due_s, publisher, message))
        self._waiting = still


def spoil_some(message: Any, generator: random.Random) -> Any:
    """Return one message in ten damaged, each time in another way."""
    if generator.random() > 0.1:
        return message
    if generator.random() < 0.3:  # what no reader of DDS takes
        data = serialize_message(message)
        return data[: generator.randrange(4, len(data))]
    if isinstance(message, CameraInfo):
        member, value = generator.choice(
            [('p', [0.0] * 12), ('k', [float('nan')] * 9), ('width', 3), ('distortion_model', 'x')]
        )
    else:
        member, value = generator.choice(
            [('encoding', 'jpeg2000'), ('step', 1), ('height', 0), ('width', 1 << 30)]
        )
    setattr(message, member, value)
    return message


class Rig:
    """Cameras, the nodes that the launch file starts for them, and a subscriber of the clouds."""

    def __init__(self, graph: Graph, namespace: str, folder: Path, *, composed: bool) -> None:
        self.graph, self.namespace, self._folder = graph, namespace, folder
        self.cameras = Cameras(graph, namespace)
        self.arrived: deque[tuple[float, float]] = deque(maxlen=5000)  # sent, arrived
        self.clouds = 0
        self._subscription: Any = None
        self._commands = {
            node.executable: node
            for node in launched_nodes(
                namespace=namespace,
                composed=str(composed).lower(),
                preset='fast',
                disparity_range='32',
            )
        }
        self.nodes: dict[str, NodeProcess] = {}
        self._started = 0
        self.burden: list[Any] = []  # processes that take the processor from it
        for name in self._commands:
            self.start(name)
        self.listen()

    @property
    def names(self) -> list[str]:
        """Names of the nodes with the namespace, as in the diagnostics."""
        return [f'{self.namespace}/{name}' for name in self._commands]

    def start(self, name: str) -> None:
        """Start one of its nodes, again if it was killed."""
        node = self._commands[name]
        self._started += 1
        topics = [f'{side}/{topic}' for side in SIDES for topic in ('image_raw', 'camera_info')]
        qos = {
            f'qos_overrides./{self.namespace}/{topic}.subscription.reliability': 'reliable'
            for topic in topics
        }
        self.nodes[name] = NodeProcess(
            name,
            self._folder / f'{self.namespace}_{name}_{self._started}.log',
            namespace=f'/{self.namespace}',
            remaps=dict(node.remappings),
            **{**qos, **node.parameters[-1]},
        )

    def has_started(self, name: str) -> bool:
        """Tell whether the newest process of a node has imported and compiled what it needs."""
        return 'kernels ready' in self.nodes[name].text()

    def listen(self) -> None:
        """Subscribe to the clouds."""
        self._subscription = self.graph.do(
            partial(
                self.graph.node.create_subscription,
                PointCloud2,
                f'/{self.namespace}/points2',
                self._receive,
                RELIABLE,
            )
        )

    def leave(self) -> None:
        """Leave the clouds."""
        self.graph.do(partial(self.graph.node.destroy_subscription, self._subscription))

    def first_since(self, time_s: float) -> float | None:
        """Return when the first cloud arrived of a pair sent since then."""
        return next((at for sent, at in list(self.arrived) if sent >= time_s), None)

    def close(self) -> list[str]:
        """End everything; return what is wrong with how the nodes ended."""
        self.cameras.close()
        found = []
        for name, node in self.nodes.items():
            status = node.stop()
            if status:
                found.append(f'{name} ended with status {status}')
            if 'Traceback' in node.text():
                found.append(f'{name} logged a traceback: {node.log}')
        return found

    def _receive(self, message: PointCloud2) -> None:
        self.clouds += 1
        sent_s = self.cameras.sent_s.get(stamp_ns(message.header))
        if sent_s is not None:
            self.arrived.append((sent_s, time.monotonic()))
