# SPDX-License-Identifier: Apache-2.0
"""Synchronise the messages of several topics by their stamps."""

from __future__ import annotations

import threading
from bisect import bisect_right
from collections import Counter
from collections.abc import Mapping, Sequence
from itertools import islice
from typing import Any

from binocular_recon.inputs.clocks import Mismatch, clock_offset, stamp_offset, standing_still
from binocular_recon.inputs.queues import Entry, MessageQueue

# So many equal stamps in a row are no repetition: the clock stands still.
STANDING_STILL = 5


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
    by_arrival : bool
        Take the time of arrival for the stamp, and the nearest whatever its difference.
    offsets_ns : mapping of str to int
        Added to the stamps of these inputs.

    Attributes
    ----------
    dropped : Counter
        Number of messages dropped, by reason: without a partner (by input), or clock went back.

    """

    def __init__(
        self,
        names: Sequence[str],
        *,
        queue_size: int,
        tolerance_ns: int | None = 0,
        by_arrival: bool = False,
        offsets_ns: Mapping[str, int] | None = None,
    ) -> None:
        self.dropped: Counter[str] = Counter()
        self._queue_size = queue_size
        self._tolerance_ns = None if by_arrival else tolerance_ns
        self._by_arrival, self._offsets_ns = by_arrival, offsets_ns or {}
        self._queues = {name: MessageQueue(name) for name in names}
        self._went_back = ''
        self._leader = self._queues[names[0]]
        self._lock = threading.Lock()

    def expect(self, name: str, expected: bool) -> None:
        """Set whether sets wait for input ``name``; if not, they may hold None in its place."""
        with self._lock:
            self._queues[name].expected = expected

    def add(
        self, name: str, stamp_ns: int, message: Any, arrived_ns: int | None = None
    ) -> list[tuple[Any, ...]]:
        """Add a message and return the sets that it completes, each in the order of ``names``.

        ``arrived_ns`` is the time of any clock that is the same for all inputs.
        """
        stamp_ns += self._offsets_ns.get(name, 0)
        with self._lock:
            queue = self._queues[name]
            if arrived_ns is not None:
                queue.arrivals.append((stamp_ns, arrived_ns))
                stamp_ns = arrived_ns if self._by_arrival else stamp_ns
            self._enqueue(queue, Entry(stamp_ns, message))
            return self._take_sets()

    def standing_still(self, least: int = STANDING_STILL) -> str:
        """Say that the last ``least`` stamps of an input are the same, '' if they are not."""
        with self._lock:
            return next(
                (
                    standing_still(queue.name, queue.recent_ns[-1])
                    for queue in self._queues.values()
                    if queue.expected and queue.equal >= least and not self._by_arrival
                ),
                '',
            )

    def went_back(self) -> str:
        """Say that stamps of an input have jumped back since the last call, '' if none have."""
        with self._lock:
            text, self._went_back = self._went_back, ''
            return text

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
                queue.arrivals.clear()
                queue.behind = queue.equal = 0

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

    def explain(self) -> Mismatch | None:
        """Describe by how much the stamps miss each other; None if they agree or are missing."""
        with self._lock:
            limit_ns = float('inf') if self._tolerance_ns is None else self._tolerance_ns
            misses_ns = {
                queue.name: miss_ns
                for queue in self._queues.values()
                if (miss_ns := self._miss_ns(queue)) is not None and abs(miss_ns) > limit_ns
            }
            if not misses_ns:
                return None
            return self._mismatch(misses_ns)

    def _mismatch(self, misses_ns: dict[str, int]) -> Mismatch:
        period_ns = self._leader.period_ns
        largest_ns = max(map(abs, misses_ns.values()))
        tolerance_s: float | None = -(-largest_ns // 1000) / 1e6
        misses = ', '.join(
            f'{name} is {abs(miss_ns) / 1e6:.3f} ms {"later" if miss_ns > 0 else "earlier"}'
            for name, miss_ns in misses_ns.items()
        )
        text = f'stamps never match those of {self._leader.name}: {misses} (nearest recent ones)'
        if period_ns is not None and 2 * largest_ns >= period_ns:
            tolerance_s = None
        for name, miss_ns in misses_ns.items():
            found = clock_offset(self._leader.arrivals, self._queues[name].arrivals)
            if name not in self._offsets_ns or found is None:
                continue
            far = period_ns is not None and 2 * abs(found.offset_ns - miss_ns) >= period_ns
            text += (
                f'; its clock is {abs(found.offset_ns) / 1e6:.3f} ms'
                f' {"ahead" if found.offset_ns > 0 else "behind"}, a constant (spread'
                f' {found.spread_ns / 1e6:.3f} ms)'
            )
            offset_s = stamp_offset(found, self._offsets_ns[name], period_ns)
            return Mismatch(text, None if far else tolerance_s, *offset_s)
        return Mismatch(text, tolerance_s)

    def _take_sets(self) -> list[tuple[Any, ...]]:
        """Remove the complete sets and all older messages, whose partners can no longer arrive."""
        sets: list[tuple[Any, ...]] = []
        if any(queue.expected and not queue.waiting for queue in self._queues.values()):
            return sets
        if self._leader.equal >= STANDING_STILL and not self._by_arrival:
            return sets
        for leading in list(self._leader.waiting):
            found = self._partners(leading)
            if found is not None:
                sets.append(tuple(entry and entry.message for entry in found))
                for queue, entry in zip(self._queues.values(), found, strict=True):
                    if entry is not None:
                        self._take(queue, entry)
        return sets

    def _take(self, queue: MessageQueue, entry: Entry) -> None:
        while queue.waiting.popleft() is not entry:
            self.dropped[f'{queue.name} without partner'] += 1

    def _miss_ns(self, queue: MessageQueue) -> int | None:
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

    def _note_lateness(self, queue: MessageQueue, stamp_ns: int) -> None:
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

    def _enqueue(self, queue: MessageQueue, entry: Entry) -> None:
        step_ns = entry.stamp_ns - queue.recent_ns[-1] if queue.recent_ns else 0
        queue.equal = queue.equal + 1 if step_ns == 0 else 1
        if step_ns < 0:
            self._went_back = (
                f'stamps of {queue.name} went back by {-step_ns / 1e9:.3f} s: a recording that'
                ' loops, or a clock that was set; messages that waited were dropped'
            )
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

    def _jump_back(self, jumped: MessageQueue) -> None:
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

    def _partners(self, leading: Entry) -> list[Entry | None] | None:
        """Return the set of a message of the leader, or None while it is incomplete."""
        found: list[Entry | None] = []
        for queue in self._queues.values():
            entry = None if queue.behind else self._partner(queue, leading)
            if entry is None and queue.expected:
                return None
            found.append(entry)
        stamps = [entry.stamp_ns for entry in found if entry is not None]
        if self._tolerance_ns is not None and max(stamps) - min(stamps) > self._tolerance_ns:
            return None
        return found

    def _partner(self, queue: MessageQueue, leading: Entry) -> Entry | None:
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
