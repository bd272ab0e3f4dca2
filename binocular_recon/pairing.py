# SPDX-License-Identifier: Apache-2.0
"""Synchronise the messages of several topics by their stamps."""

from __future__ import annotations

import threading
from bisect import bisect_right
from collections import Counter, deque
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice
from operator import attrgetter
from typing import Any

# Stamps kept for each input, independently of the queue: they distinguish a message that arrives
# after its partner was dropped from one that never had a partner.
_STAMP_HISTORY = 1000
# How many last messages of an input `too_late` looks at.
_LATENESS_HISTORY = 10


@dataclass(frozen=True, eq=False)
class _Entry:
    stamp_ns: int
    message: Any


class _Queue:
    """The messages that have arrived on one input."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.waiting: deque[_Entry] = deque()  # by stamp
        self.recent_ns: deque[int] = deque(maxlen=_STAMP_HISTORY)  # never decreases
        # for each message, how many messages of another input arrived after its partner there
        self.lateness: deque[int] = deque(maxlen=_LATENESS_HISTORY)
        self.period_ns: int | None = None  # smallest step between consecutive stamps
        # another input has jumped back and this one has not: messages after which that is ignored
        self.behind = 0
        self.ended = False
        self.expected = True

    def nearest(self, stamp_ns: int) -> _Entry | None:
        """Return the waiting message nearest to a stamp; of equal stamps, the last arrival."""
        stamp_of = attrgetter('stamp_ns')
        after = bisect_right(self.waiting, stamp_ns, key=stamp_of)
        before = self.waiting[after - 1] if after else None
        if after == len(self.waiting):
            return before
        later_ns = self.waiting[after].stamp_ns
        if before is not None and stamp_ns - before.stamp_ns < later_ns - stamp_ns:
            return before
        return self.waiting[bisect_right(self.waiting, later_ns, key=stamp_of) - 1]

    def count_after_partner(self, stamp_ns: int, tolerance_ns: int) -> int:
        """Count the messages that arrived after the partner of a stamp; 0 without a partner."""
        after = bisect_right(self.recent_ns, stamp_ns + tolerance_ns)
        if not after or self.recent_ns[after - 1] < stamp_ns - tolerance_ns:
            return 0
        return len(self.recent_ns) - after

    def is_settled(self, stamp_ns: int, gap_ns: int) -> bool:
        """Return whether no message nearer to a stamp than ``gap_ns`` can still arrive."""
        if self.ended or gap_ns == 0 or (self.recent_ns and self.recent_ns[-1] >= stamp_ns):
            return True
        return self.period_ns is not None and 2 * gap_ns <= self.period_ns


class Synchronizer:
    """Find sets of messages, one per input, whose stamps agree.

    The first input leads: each of its messages is paired with the nearest one of every other
    input, as soon as no nearer one can arrive; messages older than a set are dropped with it. At
    most ``queue_size`` messages per input wait. When the stamps of an input jump back (a bag that
    loops, a simulation that restarts), its waiting messages are dropped, and an input that has not
    jumped yet pairs with nothing until it does or ``queue_size`` of its messages have passed.

    Sets are returned, not passed to a callback, so that no code of the caller runs under the lock.

    Parameters
    ----------
    names : sequence of str
        Names of the inputs; the first leads.
    queue_size : int
        Largest number of messages per input that wait for their partners.
    tolerance_ns : int or None
        Largest difference of stamps within a set, nanoseconds; 0 = equal stamps, None = any.

    Attributes
    ----------
    dropped : Counter
        Number of messages dropped, by reason: without a partner (by input), or clock went back.

    """

    def __init__(
        self, names: Sequence[str], *, queue_size: int, tolerance_ns: int | None = 0
    ) -> None:
        self.dropped: Counter[str] = Counter()
        self._queue_size = queue_size
        self._tolerance_ns = tolerance_ns
        self._queues = {name: _Queue(name) for name in names}
        self._leader = self._queues[names[0]]
        self._lock = threading.Lock()

    def expect(self, name: str, expected: bool) -> None:
        """Set whether sets wait for input ``name``; if not, they may hold None in its place."""
        with self._lock:
            self._queues[name].expected = expected

    def add(self, name: str, stamp_ns: int, message: Any) -> list[tuple[Any, ...]]:
        """Add a message and return the sets that it completes, each in the order of ``names``."""
        with self._lock:
            self._enqueue(self._queues[name], _Entry(stamp_ns, message))
            return self._take_sets()

    def finish(self) -> list[tuple[Any, ...]]:
        """End all inputs and return the sets that still waited for a nearer message."""
        with self._lock:
            for queue in self._queues.values():
                queue.ended = True
            return self._take_sets()

    def clear(self) -> None:
        """Forget all messages and stamps; keep the counts of dropped messages."""
        with self._lock:
            for queue in self._queues.values():
                queue.waiting.clear()
                queue.recent_ns.clear()
                queue.lateness.clear()
                queue.behind = 0

    def too_late(self) -> dict[str, int]:
        """Return the inputs whose messages arrive after their partners have been dropped.

        Returns
        -------
        needed : dict of str to int
            By input, the smallest ``queue_size`` with which its last messages would have found
            their partners; at most 1000.

        """
        with self._lock:
            needed = {
                queue.name: 1 + max(queue.lateness, default=0)
                for queue in self._queues.values()
                if queue.expected
            }
        return {name: count for name, count in needed.items() if count > self._queue_size}

    def explain(self) -> tuple[str, float] | None:
        """Describe by how much the stamps miss each other.

        Returns
        -------
        text : str
            The smallest difference of each input's recent stamps from the leader's.
        needed_s : float
            The tolerance with which they would match, s, rounded up to whole microseconds.
            Instead of both, None if the stamps agree or there are none.

        """
        with self._lock:
            limit_ns = float('inf') if self._tolerance_ns is None else self._tolerance_ns
            misses_ns = {
                queue.name: miss_ns
                for queue in self._queues.values()
                if (miss_ns := self._miss_ns(queue)) is not None and abs(miss_ns) > limit_ns
            }
        if not misses_ns:
            return None
        misses = ', '.join(
            f'{name} is {abs(miss_ns) / 1e6:.3f} ms {"later" if miss_ns > 0 else "earlier"}'
            for name, miss_ns in misses_ns.items()
        )
        text = f'stamps never match those of {self._leader.name}: {misses} (nearest recent ones)'
        needed_us = -(-max(map(abs, misses_ns.values())) // 1000)
        return text, needed_us / 1e6

    def _take_sets(self) -> list[tuple[Any, ...]]:
        """Remove the complete sets and all older messages, whose partners can no longer arrive."""
        sets: list[tuple[Any, ...]] = []
        if any(queue.expected and not queue.waiting for queue in self._queues.values()):
            return sets
        for leading in list(self._leader.waiting):
            found = self._partners(leading)
            if found is not None:
                sets.append(tuple(entry and entry.message for entry in found))
                for queue, entry in zip(self._queues.values(), found, strict=True):
                    if entry is not None:
                        self._take(queue, entry)
        return sets

    def _take(self, queue: _Queue, entry: _Entry) -> None:
        while queue.waiting.popleft() is not entry:
            self.dropped[f'{queue.name} without partner'] += 1

    def _miss_ns(self, queue: _Queue) -> int | None:
        """Return the smallest difference of an expected input's stamps from the leader's."""
        leading_ns = self._leader.recent_ns
        if not leading_ns or not queue.recent_ns or not queue.expected:
            return None
        gaps_ns = []
        for stamp_ns in islice(reversed(queue.recent_ns), 2 * self._queue_size):
            after = bisect_right(leading_ns, stamp_ns)
            near_ns = [leading_ns[k] for k in (after - 1, after) if 0 <= k < len(leading_ns)]
            gaps_ns += [stamp_ns - leading for leading in near_ns]
        return min(gaps_ns, key=abs)

    def _note_lateness(self, queue: _Queue, stamp_ns: int) -> None:
        """Note how many messages arrived between a message and its earlier partner."""
        others = self._queues.values() if queue is self._leader else [self._leader]
        tolerance_ns = self._tolerance_ns or 0
        if not queue.behind:
            counts = [
                other.count_after_partner(stamp_ns, tolerance_ns)
                for other in others
                if other is not queue and not other.behind
            ]
            queue.lateness.append(max(counts, default=0))

    def _enqueue(self, queue: _Queue, entry: _Entry) -> None:
        step_ns = entry.stamp_ns - queue.recent_ns[-1] if queue.recent_ns else 0
        if step_ns < 0:
            self._jump_back(queue)
        else:
            queue.behind = max(0, queue.behind - 1)
        if step_ns > 0:
            queue.period_ns = min(queue.period_ns or step_ns, step_ns)
        queue.recent_ns.append(entry.stamp_ns)
        self._note_lateness(queue, entry.stamp_ns)
        queue.waiting.append(entry)
        if len(queue.waiting) > self._queue_size:
            queue.waiting.popleft()
            self.dropped[f'{queue.name} without partner'] += 1

    def _jump_back(self, jumped: _Queue) -> None:
        self.dropped['clock went back'] += len(jumped.waiting)
        jumped.waiting.clear()
        jumped.recent_ns.clear()
        jumped.lateness.clear()
        if jumped.behind:
            jumped.behind = 0  # it follows another input's jump
            return
        for queue in self._queues.values():
            if queue is not jumped and queue.recent_ns:
                queue.behind = self._queue_size

    def _partners(self, leading: _Entry) -> list[_Entry | None] | None:
        """Return the set of a message of the leader, or None while it is incomplete."""
        found: list[_Entry | None] = []
        for queue in self._queues.values():
            entry = None if queue.behind else self._partner(queue, leading)
            if entry is None and queue.expected:
                return None
            found.append(entry)
        stamps = [entry.stamp_ns for entry in found if entry is not None]
        if self._tolerance_ns is not None and max(stamps) - min(stamps) > self._tolerance_ns:
            return None
        return found

    def _partner(self, queue: _Queue, leading: _Entry) -> _Entry | None:
        """Return the message of an input for which it and ``leading`` are mutually nearest."""
        if queue is self._leader:
            return leading
        entry = queue.nearest(leading.stamp_ns)
        if entry is None or self._leader.nearest(entry.stamp_ns) is not leading:
            return None
        gap_ns = abs(entry.stamp_ns - leading.stamp_ns)
        if self._tolerance_ns is not None and gap_ns > self._tolerance_ns:
            return None
        settled = queue.is_settled(leading.stamp_ns, gap_ns) and self._leader.is_settled(
            entry.stamp_ns, gap_ns
        )
        return entry if settled else None
