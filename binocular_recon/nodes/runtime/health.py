# SPDX-License-Identifier: Apache-2.0
"""Count what a node does and remember its problems, for the log and for /diagnostics."""

from __future__ import annotations

import re
import statistics
import threading
import time
from collections import Counter, deque
from collections.abc import Callable
from typing import Any, NamedTuple

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue

from binocular_recon.errors import plain_text

# How often a problem is repeated in the log, and for how long it stays in the status.
_LOG_EVERY_S = 5.0
_REMEMBERED_S = 3.0
# How long a loss of messages explains what is missing.
_LOSS_EXPLAINS_S = 10.0
# With Fast DDS's defaults an image goes through UDP in fragments, and one lost fragment loses it.
# What counts is the shared memory of the process that sends.
SHARED_MEMORY = (
    'start the process that publishes them with the Fast DDS profile'
    ' config/fastdds_shared_memory.xml (environment variable FASTDDS_DEFAULT_PROFILES_FILE, on'
    ' Jazzy FASTRTPS_DEFAULT_PROFILES_FILE); from another machine take compressed images'
)
# Problems whose texts differ only in numbers are of one kind; at most so many are remembered.
_NUMBER = re.compile(r'\d+(\.\d+)?')
_KINDS = 100


class _Arrivals(NamedTuple):
    """When the last message of a topic arrived, and how long it and the one before it took."""

    last_s: float
    gaps_s: tuple[float, ...] = ()
    seen: bool = False

    @property
    def interval_s(self) -> float:
        """Shorter of the last two gaps, so that one pause does not excuse the next; 0 = none."""
        return min(self.gaps_s, default=0.0)

    def next(self, now_s: float) -> _Arrivals:
        gaps_s = (*self.gaps_s[-1:], now_s - self.last_s) if self.seen else ()
        return _Arrivals(now_s, gaps_s, seen=True)


class Health:
    """Counts and problems of a node; any thread may report.

    Parameters
    ----------
    logger : rclpy logger
        Logger of the node; a problem is logged at most every five seconds.
    clock : callable
        Returns seconds of a monotonic clock.

    """

    def __init__(self, logger: Any, clock: Callable[[], float] = time.monotonic) -> None:
        self._logger = logger
        self._clock = clock
        self._lock = threading.Lock()
        self._received: Counter[str] = Counter()
        self._published: Counter[str] = Counter()
        self._dropped: Counter[str] = Counter()
        self._lost: dict[str, tuple[int, float]] = {}
        self._arrivals: dict[str, _Arrivals] = {}
        self._durations_s: deque[float] = deque(maxlen=30)
        self._facts: dict[str, str] = {}
        self._logged: dict[str, tuple[float, int]] = {}
        self._problems: dict[bytes, tuple[float, str]] = {}
        self._last_error = ''

    def received(self, topic: str) -> None:
        """Count a message that arrived."""
        with self._lock:
            self._received[topic] += 1
            if topic in self._arrivals:
                self._arrivals[topic] = self._arrivals[topic].next(self._clock())

    def published(self, topic: str) -> None:
        """Count a message that was sent."""
        with self._lock:
            self._published[topic] += 1

    def dropped(self, reason: str, count: int = 1) -> None:
        """Count received messages or frames that are not used."""
        with self._lock:
            self._dropped[reason] += count

    def lost(self, topic: str, count: int) -> None:
        """Count messages of a topic that were lost on their way, and name the remedy."""
        self.dropped(f'{topic} lost in transport', count)
        with self._lock:
            self._lost[topic] = self._lost.get(topic, (0, 0.0))[0] + count, self._clock()
        self.warning(self.loss())

    def loss(self) -> str:
        """Say how many messages were lost on their way and what to do; '' if none was lately."""
        with self._lock:
            now = self._clock()
            lately = {
                topic: count
                for topic, (count, since) in self._lost.items()
                if now - since <= _LOSS_EXPLAINS_S
            }
            shares = ', '.join(
                f'{count} of {count + self._received[topic]} on {topic}'
                for topic, count in lately.items()
            )
        return f'messages are lost in transport: {shares}; {SHARED_MEMORY}' if lately else ''

    def processed(self, seconds: float) -> None:
        """Record how long a frame took."""
        with self._lock:
            self._durations_s.append(seconds)

    def state(self, name: str, value: str) -> None:
        """Set a value of the status, such as the calibration in use."""
        with self._lock:
            self._facts[name] = plain_text(value)

    def error(self, text: str) -> None:
        """Report that a frame could not be used; the status shows it for a while."""
        self._remember(DiagnosticStatus.ERROR, text)

    def warning(self, text: str) -> None:
        """Report what degrades the results; the status shows it for a while."""
        self._remember(DiagnosticStatus.WARN, text)

    def expect(self, topics: list[str]) -> None:
        """Wait for messages on these topics from now on."""
        with self._lock:
            self._arrivals = {topic: _Arrivals(self._clock()) for topic in topics}

    def silent(self) -> dict[str, float]:
        """Return the expected topics without a message, and for how many seconds.

        A topic counts as silent after three of its intervals, at least three seconds.
        """
        return self._without_message(3.0)

    def pausing(self, topics: list[str]) -> dict[str, float]:
        """Return those of the topics whose messages have stopped, before they count as silent.

        After three of their intervals, at least one second.
        """
        with self._lock:
            seen = [topic for topic in topics if self._arrivals[topic].interval_s]
        ages_s = self._without_message(1.0)
        return {topic: ages_s[topic] for topic in seen if topic in ages_s}

    def _without_message(self, least_s: float) -> dict[str, float]:
        with self._lock:
            now = self._clock()
            return {
                topic: now - arrivals.last_s
                for topic, arrivals in self._arrivals.items()
                if now - arrivals.last_s > max(least_s, 3 * arrivals.interval_s)
            }

    def status(
        self, name: str, hardware: str, level: bytes, summary: str, *, dropped: Counter[str]
    ) -> DiagnosticStatus:
        """Return the status; a recent problem of a higher level replaces ``summary``."""
        with self._lock:
            now = self._clock()
            for recent, (since, text) in sorted(self._problems.items()):
                if (
                    now - since <= _REMEMBERED_S and level <= recent
                ):  # stale stays: it is the highest
                    level, summary = recent, text
            values = {f'received {topic}': str(n) for topic, n in self._received.items()}
            values |= {f'published {topic}': str(n) for topic, n in self._published.items()}
            values |= {
                f'dropped: {reason}': str(n) for reason, n in (self._dropped + dropped).items()
            }
            if self._durations_s:
                median_ms = 1000 * statistics.median(self._durations_s)
                values['processing time'] = f'{median_ms:.1f} ms'
                values['longest processing time'] = f'{1000 * max(self._durations_s):.1f} ms'
            values |= self._facts | {'last error': self._last_error}
        return DiagnosticStatus(
            level=level,
            name=name,
            hardware_id=hardware,
            message=summary,
            values=[KeyValue(key=key, value=value) for key, value in values.items()],
        )

    def log(self, level: bytes, text: str) -> None:
        """Log a problem, unless one of the same kind was logged just before."""
        text = plain_text(text)
        kind = _NUMBER.sub('#', text)
        with self._lock:
            now = self._clock()
            if level == DiagnosticStatus.ERROR:
                self._last_error = text
            last, unlogged = self._logged.get(kind, (-float('inf'), 0))
            if now - last < _LOG_EVERY_S:
                self._logged[kind] = (last, unlogged + 1)
                return
            if len(self._logged) >= _KINDS:
                self._logged.clear()
            self._logged[kind] = (now, 0)
        if unlogged:
            text = f'{text} ({unlogged} more since this was last logged)'
        # two calls: rclpy allows one severity per call site
        if level == DiagnosticStatus.ERROR:
            self._logger.error(text)
        else:
            self._logger.warning(text)

    def _remember(self, level: bytes, text: str) -> None:
        text = plain_text(text)
        with self._lock:
            self._problems[level] = (self._clock(), text)
        self.log(level, text)
