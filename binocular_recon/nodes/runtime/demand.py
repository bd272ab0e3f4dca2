# SPDX-License-Identifier: Apache-2.0
"""Frames on demand: a node makes one when those that take its outputs are free for it.

A consumer asks for each frame on a topic of its own, so that nothing is computed and sent that it
would drop. Where anybody else listens, an image viewer or a recorder, all frames are sent.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence

from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from std_msgs.msg import Empty

from binocular_recon.nodes.runtime.endpoints import Output

# Where consumers ask, hidden from lists of topics.
PAIRS_WANTED, DISPARITIES_WANTED = '_wanted/pairs', '_wanted/disparities'
# A frame or a request may be lost: after this time one is sent unasked.
_PATIENCE_S = 1.0
_QOS = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE)


class Demand:
    """What the consumers of a node's outputs ask for.

    Parameters
    ----------
    node : Node
        Node that makes the outputs.
    topic : str
        Where consumers ask; those that publish on it get frames only when one of them asks.
    outputs : sequence of Output
        The outputs.
    on_ask : callable
        Called when a consumer asks.

    """

    def __init__(
        self, node: Node, topic: str, outputs: Sequence[Output], on_ask: Callable[[], None]
    ) -> None:
        self._node, self._on_ask = node, on_ask
        self._topic = node.resolve_topic_name(topic)
        self._outputs = [node.resolve_topic_name(output.topic) for output in outputs]
        self._lock = threading.Lock()
        self._asked, self._sent_s = True, time.monotonic()
        self._on_demand = False
        self._subscription = node.create_subscription(Empty, topic, self._ask, _QOS)

    def update(self) -> None:
        """Find out whether everybody who takes the outputs asks for them."""
        asking = {
            (one.node_namespace, one.node_name)
            for one in self._node.get_publishers_info_by_topic(self._topic)
        }
        self._on_demand = bool(asking) and all(
            (one.node_namespace, one.node_name) in asking
            for output in self._outputs
            for one in self._node.get_subscriptions_info_by_topic(output)
        )

    @property
    def waiting(self) -> bool:
        """Whether a frame would be taken now."""
        with self._lock:
            late = time.monotonic() - self._sent_s > _PATIENCE_S
            return self._asked or late or not self._on_demand

    def sent(self) -> None:
        """Take note that a frame is on its way."""
        with self._lock:
            self._asked, self._sent_s = False, time.monotonic()

    def _ask(self, _message: Empty) -> None:
        with self._lock:
            self._asked = True
        self._on_ask()


class Requests:
    """Requests of a consumer.

    Parameters
    ----------
    node : Node
        The consumer.
    topics : sequence of str
        Where it says that it takes frames on demand; it asks on the first.

    """

    def __init__(self, node: Node, topics: Sequence[str]) -> None:
        self._publishers = [node.create_publisher(Empty, topic, _QOS) for topic in topics]

    def ask(self) -> None:
        """Ask for one frame."""
        if self._publishers:
            self._publishers[0].publish(Empty())
