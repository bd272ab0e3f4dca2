# SPDX-License-Identifier: Apache-2.0
"""Publish a bag as it was recorded: its bytes, its timing, its QoS."""

from __future__ import annotations

import importlib
import itertools
import signal
import time
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from rosgraph_msgs.msg import Clock

from binocular_recon.apps.progress import ProgressBar
from binocular_recon.errors import BagError
from binocular_recon.io.bags.reader import Bag, Topic
from binocular_recon.nodes.runtime.health import Health
from binocular_recon.nodes.runtime.process import init_ros

# How long the start waits for subscribers, the end for the last messages to be acknowledged.
_START_WITHIN_S, _END_WITHIN_S = 2.0, 5.0
# A publisher knows its subscribers a little earlier than they know it.
_SETTLING_S = 0.5
_CLOCK_PERIOD_S = 0.01
_REPORT_PERIOD_S = 1.0
# Between rounds of a recording too short to have a period of its own.
_ROUND_PAUSE_S = 1.0


def play(
    path: Path,
    *,
    rate: float = 1.0,
    loop: bool = False,
    clock: bool = False,
    delay_s: float = 0.0,
    ros_args: Sequence[str] = (),
) -> None:
    """Publish the messages of a bag.

    Parameters
    ----------
    path : Path
        Bag of any format.
    rate : float
        Speed as a multiple of that of the recording.
    loop : bool
        Whether to begin again at the end, until interrupted.
    clock : bool
        Whether to publish the time of recording as ``/clock``.
    delay_s : float
        Least time before the first message: subscribers on a busy machine or a slow network may
        need it.
    ros_args : sequence of str
        What follows ``--ros-args`` on a node's command line.

    Raises
    ------
    BagError
        If the bag cannot be read, no topic of it can be published, or it is damaged (when all
        that precedes the damage was played).
    ConfigError
        If ROS refuses ``ros_args``.
    KeyboardInterrupt
        On SIGINT and SIGTERM, after the publishers were closed.

    """
    with Bag(path) as bag:
        words = ['play_bag', *(['--ros-args', *ros_args] if ros_args else [])]
        init_ros(words, signal_handler_options=SignalHandlerOptions.NO)
        signal.signal(signal.SIGTERM, signal.default_int_handler)
        node = Node('play_bag', start_parameter_services=False)
        try:
            player = Player(node, bag, rate=rate, clock=clock)
            node.get_logger().info(player.describe())
            player.wait_for_subscribers(delay_s)
            for _ in itertools.count() if loop else (0,):
                player.play_once()
                if loop:
                    player.pause()
            player.wait_for_delivery()
        finally:
            node.destroy_node()
            rclpy.try_shutdown()
        if bag.damage:
            raise BagError('; '.join(bag.damage))


class Player:
    """Publishers of a bag's topics and the time at which their messages are due.

    Says on ``/diagnostics`` once a second what was published and how late.

    Parameters
    ----------
    node : Node
        Node that publishes.
    bag : Bag
        Open bag.
    rate : float
        Speed as a multiple of that of the recording.
    clock : bool
        Whether to publish ``/clock``.

    Raises
    ------
    BagError
        If no topic can be published.

    """

    def __init__(self, node: Node, bag: Bag, *, rate: float = 1.0, clock: bool = False) -> None:
        self._node, self._bag, self._rate = node, bag, rate
        self._length_s, self._last_ns = 0.0, 0
        self._health = Health(node.get_logger())
        self._diagnostics = node.create_publisher(DiagnosticArray, '/diagnostics', 10)
        self._next_report_s = 0.0
        self._clock = node.create_publisher(Clock, '/clock', 1) if clock else None
        self._publishers: dict[Topic, Publisher[Any]] = {}
        for topic in bag.topics:
            if clock and topic.name == '/clock':
                continue
            message_type = _message_type(topic.msgtype)
            if message_type is None:
                node.get_logger().warning(
                    f'{topic.name} is left out: its type {topic.msgtype} is not installed'
                )
                continue
            qos = _qos_profile(topic)
            self._publishers[topic] = node.create_publisher(message_type, topic.name, qos)
        if not self._publishers:
            types = sorted({topic.msgtype for topic in bag.topics})
            raise BagError(f'{bag.path}: none of its types is installed: {", ".join(types)}')

    def describe(self) -> str:
        """Return what is played, for the log."""
        names = ', '.join(f'{x.name} ({x.message_count})' for x in self._publishers)
        return f'playing {self._bag.path} at {self._rate:g} x its speed: {names}'

    def wait_for_subscribers(self, least_s: float = 0.0) -> None:
        """Return when all topics have matched all subscribers there are, or after a while.

        Until then, at least ``least_s``, the clock stands at the first message.
        """
        begun_s = time.monotonic()
        first = next(self._bag.messages(list(self._publishers)), None)
        first_ns = first.stamp_ns if first else 0
        self._stand_until(begun_s + _START_WITHIN_S - _SETTLING_S, first_ns, self._are_matched)
        self._stand_until(max(begun_s + least_s, time.monotonic() + _SETTLING_S), first_ns)

    def play_once(self) -> None:
        """Publish every message when it is due; late ones follow at once."""
        first_ns = None
        count = sum(topic.message_count for topic in self._publishers)
        with ProgressBar(count, 'messages') as progress:
            for done, message in enumerate(self._bag.messages(list(self._publishers))):
                if first_ns is None:
                    start_s, first_ns = time.monotonic(), message.stamp_ns
                self._last_ns = message.stamp_ns
                self._length_s = (message.stamp_ns - first_ns) / 1e9 / self._rate
                due_s = start_s + self._length_s
                self._sleep_until(due_s, message.stamp_ns)
                self._publishers[message.topic].publish(message.cdr)
                self._health.published(message.topic.name)
                self._report(due_s)
                progress.show(done + 1)

    def pause(self) -> None:
        """Wait between two rounds as long as between two messages of the most frequent topic."""
        steps = max(topic.message_count for topic in self._publishers) - 1
        pause_s = self._length_s / steps if steps and self._length_s else _ROUND_PAUSE_S
        end_ns = self._last_ns + int(pause_s * self._rate * 1e9)
        self._sleep_until(time.monotonic() + pause_s, end_ns)

    def wait_for_delivery(self) -> None:
        """Return when subscribers have acknowledged what was published, or after a while."""
        deadline = time.monotonic() + _END_WITHIN_S
        for publisher in self._publishers.values():
            left_s = max(0.0, deadline - time.monotonic())
            publisher.wait_for_all_acked(Duration(seconds=left_s))

    def _are_matched(self) -> bool:
        return all(
            publisher.get_subscription_count() >= max(1, self._node.count_subscribers(topic.name))
            for topic, publisher in self._publishers.items()
        )

    def _stand_until(
        self, end_s: float, stamp_ns: int, is_over: Callable[[], bool] = lambda: False
    ) -> None:
        """Wait while the time of recording stands still."""
        while (left_s := end_s - time.monotonic()) > 0 and not is_over():
            if self._clock is not None:
                self._clock.publish(_clock(stamp_ns))
            self._report(end_s)
            time.sleep(min(left_s, _CLOCK_PERIOD_S))

    def _sleep_until(self, due_s: float, stamp_ns: int) -> None:
        """Sleep until a moment of the recording, publishing the time meanwhile."""
        while True:
            left_s = due_s - time.monotonic()
            if self._clock is not None:
                now_ns = stamp_ns - int(max(0.0, left_s) * self._rate * 1e9)
                self._clock.publish(_clock(now_ns))
            if left_s <= 0:
                return
            self._report(due_s)
            period_s = _REPORT_PERIOD_S if self._clock is None else _CLOCK_PERIOD_S
            time.sleep(min(left_s, period_s))

    def _report(self, due_s: float) -> None:
        """Publish the diagnostics if a second has passed since the last time."""
        now_s = time.monotonic()
        if now_s < self._next_report_s:
            return
        self._next_report_s = now_s + _REPORT_PERIOD_S
        self._health.state('behind the recording', f'{max(0.0, now_s - due_s):.3f} s')
        name = self._node.get_fully_qualified_name().lstrip('/')
        status = self._health.status(
            f'{name}: messages', name, DiagnosticStatus.OK, self.describe(), dropped=Counter()
        )
        message = DiagnosticArray(status=[status])
        message.header.stamp = self._node.get_clock().now().to_msg()
        self._diagnostics.publish(message)


def _clock(now_ns: int) -> Clock:
    message = Clock()
    message.clock.sec, message.clock.nanosec = divmod(now_ns, 1_000_000_000)
    return message


def _message_type(msgtype: str) -> type[Any] | None:
    """Return the class of a type such as ``sensor_msgs/msg/Image``, None if not installed."""
    package, _, name = msgtype.partition('/msg/')
    try:
        found: type[Any] = getattr(importlib.import_module(f'{package}.msg'), name)
    except (ImportError, AttributeError):
        return None
    return found


def _qos_profile(topic: Topic) -> QoSProfile:
    qos = topic.qos
    return QoSProfile(
        depth=qos.depth,
        reliability=ReliabilityPolicy.RELIABLE if qos.reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=(
            DurabilityPolicy.TRANSIENT_LOCAL if qos.transient_local else DurabilityPolicy.VOLATILE
        ),
    )
