# SPDX-License-Identifier: Apache-2.0
"""The player of `play_bag`: publishers of a bag's topics and the schedule of its messages."""

from __future__ import annotations

import importlib
import re
import sys
import time
from collections.abc import Callable
from importlib.machinery import PathFinder
from pathlib import Path
from typing import Any, Protocol

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock

from binocular_recon.apps.progress import ProgressBar
from binocular_recon.errors import BagError, plain_text
from binocular_recon.io.bags.reader import Bag, Topic
from binocular_recon.nodes.runtime.diagnostics import PERIOD_S, DiagnosticsPublisher
from binocular_recon.nodes.runtime.health import Health

# How long the start waits for subscribers, the end for the last messages to be acknowledged.
START_WITHIN_S, _END_WITHIN_S = 2.0, 5.0
# A publisher knows its subscribers a little earlier than they know it.
SETTLING_S = 0.5
CLOCK_PERIOD_S = 0.01
# Between rounds of a recording that is too short to have a period of its own.
ROUND_PAUSE_S = 1.0
_TYPE_NAME = re.compile(r'[a-z]\w*/msg/[A-Z]\w*', re.ASCII)


class Timer(Protocol):
    """Tells the time and sleeps, as the module `time` does."""

    def monotonic(self) -> float:
        """Return seconds that never go back."""

    def sleep(self, seconds: float, /) -> None:
        """Return after a time, s."""


class Player:
    """Publishes the messages of a bag when they are due.

    Reports on ``/diagnostics`` once a second what was published and how late.

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
    timer : Timer
        Source of the time; a test may replace it.

    Raises
    ------
    BagError
        If no topic can be published.

    """

    def __init__(
        self, node: Node, bag: Bag, *, rate: float = 1.0, clock: bool = False, timer: Timer = time
    ) -> None:
        self._node, self._bag, self._rate, self._timer = node, bag, rate, timer
        self._length_s, self._last_ns = 0.0, 0
        self._health = Health(node.get_logger(), timer.monotonic)
        self._diagnostics = DiagnosticsPublisher(node, self._health, 'messages')
        self._next_report_s = timer.monotonic()
        self._clock = node.create_publisher(Clock, '/clock', 1) if clock else None
        self._publishers: dict[Topic, Publisher[Any]] = {}
        for topic in bag.topics:
            if clock and topic.name == '/clock':
                continue
            message_type = _message_type(topic.msgtype)
            if message_type is None:
                node.get_logger().warning(
                    plain_text(
                        f'{topic.name} is skipped: its type {topic.msgtype} is not installed'
                    )
                )
                continue
            qos = _qos_profile(topic)
            self._publishers[topic] = node.create_publisher(message_type, topic.name, qos)
        if not self._publishers:
            types = sorted({topic.msgtype for topic in bag.topics})
            raise BagError(
                f'{bag.path}: none of its message types is installed: {", ".join(types)}; install'
                ' their packages'
            )

    def describe(self) -> str:
        """Return what is played, for the log."""
        names = ', '.join(f'{x.name} ({x.message_count})' for x in self._publishers)
        return plain_text(
            f'playing {self._bag.path} at {self._rate:g} x the recorded speed: {names}'
        )

    def wait_for_subscribers(self, least_s: float = 0.0) -> None:
        """Return when all topics have matched all known subscribers, or after a while.

        Until then, and for at least ``least_s``, the clock stands at the first message.
        """
        begun_s = self._timer.monotonic()
        first = next(self._bag.messages(list(self._publishers)), None)
        first_ns = first.stamp_ns if first else 0
        self._hold_clock(begun_s + START_WITHIN_S - SETTLING_S, first_ns, self._are_matched)
        settled_s = self._timer.monotonic() + SETTLING_S
        self._hold_clock(max(begun_s + least_s, settled_s), first_ns)

    def play_once(self) -> None:
        """Publish every message when it is due, or at once if that has passed."""
        first_ns = None
        count = sum(topic.message_count for topic in self._publishers)
        with ProgressBar(count, 'messages') as progress:
            for done, message in enumerate(self._bag.messages(list(self._publishers))):
                if first_ns is None:
                    start_s, first_ns = self._timer.monotonic(), message.stamp_ns
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
        pause_s = self._length_s / steps if steps and self._length_s else ROUND_PAUSE_S
        end_ns = self._last_ns + int(pause_s * self._rate * 1e9)
        self._sleep_until(self._timer.monotonic() + pause_s, end_ns)

    def wait_for_delivery(self) -> None:
        """Return when subscribers have acknowledged what was published, or after a while."""
        deadline_s = self._timer.monotonic() + _END_WITHIN_S
        clock = [self._clock] if self._clock else []
        for publisher in [*self._publishers.values(), *clock]:
            left_s = max(0.0, deadline_s - self._timer.monotonic())
            publisher.wait_for_all_acked(Duration(seconds=left_s))

    def _are_matched(self) -> bool:
        return all(
            publisher.get_subscription_count() >= max(1, self._node.count_subscribers(topic.name))
            for topic, publisher in self._publishers.items()
        )

    def _hold_clock(
        self, end_s: float, stamp_ns: int, is_over: Callable[[], bool] = lambda: False
    ) -> None:
        """Wait while the time of recording stands still."""
        while (left_s := end_s - self._timer.monotonic()) > 0 and not is_over():
            self._publish_clock(stamp_ns)
            self._report(end_s)
            self._timer.sleep(min(left_s, CLOCK_PERIOD_S))

    def _sleep_until(self, due_s: float, stamp_ns: int) -> None:
        """Sleep until a moment of the recording, publishing the time meanwhile."""
        while True:
            left_s = due_s - self._timer.monotonic()
            self._publish_clock(stamp_ns - int(max(0.0, left_s) * self._rate * 1e9))
            if left_s <= 0:
                return
            self._report(due_s)
            period_s = PERIOD_S if self._clock is None else CLOCK_PERIOD_S
            self._timer.sleep(min(left_s, period_s))

    def _publish_clock(self, now_ns: int) -> None:
        if self._clock is not None:
            message = Clock()
            message.clock.sec, message.clock.nanosec = divmod(now_ns, 1_000_000_000)
            self._clock.publish(message)

    def _report(self, due_s: float) -> None:
        """Publish the diagnostics if a second has passed since the last time."""
        now_s = self._timer.monotonic()
        if now_s < self._next_report_s:
            return
        self._next_report_s = now_s + PERIOD_S
        self._health.state('behind the recording', f'{max(0.0, now_s - due_s):.3f} s')
        self._diagnostics.publish(DiagnosticStatus.OK, self.describe())


def _message_type(msgtype: str) -> type[Any] | None:
    """Return the class of a type such as ``sensor_msgs/msg/Image``, None if not installed.

    A bag may name any package: none is imported from the current folder.
    """
    if not _TYPE_NAME.fullmatch(msgtype):
        return None
    package, _, name = msgtype.split('/')
    if package not in sys.modules:
        elsewhere = [one for one in sys.path if one and Path(one).resolve() != Path.cwd()]
        installed = PathFinder.find_spec(package, elsewhere)
        found = PathFinder.find_spec(package)
        if installed is None or found is None or installed.origin != found.origin:
            return None
    try:
        kind: type[Any] = getattr(importlib.import_module(f'{package}.msg'), name)
    except (ImportError, AttributeError):
        return None
    return kind if hasattr(kind, 'get_fields_and_field_types') else None


def _qos_profile(topic: Topic) -> QoSProfile:
    qos = topic.qos
    return QoSProfile(
        depth=qos.depth,
        reliability=ReliabilityPolicy.RELIABLE if qos.reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=(
            DurabilityPolicy.TRANSIENT_LOCAL if qos.transient_local else DurabilityPolicy.VOLATILE
        ),
    )
