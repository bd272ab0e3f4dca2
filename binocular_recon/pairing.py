# SPDX-License-Identifier: Apache-2.0
"""Messages of several topics that belong to the same moment."""

from __future__ import annotations

import threading
from bisect import bisect_right
from collections import Counter, deque
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice
from operator import attrgetter
from typing import Any

# Stamps of an input that are remembered, however few messages wait: they tell a message that
# comes too late from one without a partner.
_REMEMBERED = 1000
# Messages of an input of which the latest tells how long its partners had to wait.
_LATENESS_OF = 10


@dataclass(frozen=True, eq=False)
class _Entry:
    stamp_ns: int
    message: Any


class _Input:
    """What has arrived on one topic."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.waiting: deque[_Entry] = deque()  # by stamp
        self.recent_ns: deque[int] = deque(maxlen=_REMEMBERED)  # never falls
        # messages of another input that came between a partner and this input's message
        self.lateness: deque[int] = deque(maxlen=_LATENESS_OF)
        self.step_ns: int | None = None  # smallest distance of consecutive stamps
        self.behind = 0  # messages for which it may still be in the time before a jump back
        self.ended = False
        self.expected = True

    def nearest(self, stamp_ns: int) -> _Entry | None:
        """Return the waiting message nearest to a stamp, the latest arrival among equals."""
        stamp_of = attrgetter('stamp_ns')
        after = bisect_right(self.waiting, stamp_ns, key=stamp_of)
        before = self.waiting[after - 1] if after else None
        if after == len(self.waiting):
            return before
        later_ns = self.waiting[after].stamp_ns
        if before is not None and stamp_ns - before.stamp_ns < later_ns - stamp_ns:
            return before
        return self.waiting[bisect_right(self.waiting, later_ns, key=stamp_of) - 1]

    def newer(self, stamp_ns: int, tolerance_ns: int) -> int:
        """Count the messages that came after the partner of a stamp, 0 if it had none."""
        after = bisect_right(self.recent_ns, stamp_ns + tolerance_ns)
        if not after or self.recent_ns[after - 1] < stamp_ns - tolerance_ns:
            return 0
        return len(self.recent_ns) - after

    def is_settled(self, stamp_ns: int, gap_ns: int) -> bool:
        """Tell whether no message nearer to a stamp than ``gap_ns`` can still arrive."""
        if self.ended or gap_ns == 0 or (self.recent_ns and self.recent_ns[-1] >= stamp_ns):
            return True
        return self.step_ns is not None and 2 * gap_ns <= self.step_ns


class Synchronizer:
    """Find sets of messages, one per input, whose stamps agree.

    The first input leads: each of its messages is paired with the nearest of every other input,
    as soon as no nearer one can come; what is older than its set is dropped. At most
    ``queue_size`` messages per input wait. When stamps of an input go back (a bag that loops, a
    simulation that starts again), what waits there is dropped, and an input that has not gone
    back yet pairs with nothing until it does or ``queue_size`` of its messages have passed.

    Sets are returned, not passed to a callback: nothing of the caller's runs under the lock.

    Parameters
    ----------
    names : sequence of str
        Inputs; the first leads.
    queue_size : int
        Most messages of an input that wait for their partners.
    tolerance_ns : int or None
        Largest difference of stamps within a set, nanoseconds; 0 = equal stamps, None = any.

    Attributes
    ----------
    dropped : Counter
        Messages dropped by reason: without a partner (by input), or when the clock went back.

    """

    def __init__(
        self, names: Sequence[str], *, queue_size: int, tolerance_ns: int | None = 0
    ) -> None:
        self.dropped: Counter[str] = Counter()
        self._queue_size = queue_size
        self._tolerance_ns = tolerance_ns
        self._inputs = {name: _Input(name) for name in names}
        self._leader = self._inputs[names[0]]
        self._lock = threading.Lock()

    def expect(self, name: str, expected: bool) -> None:
        """Say whether sets wait for input ``name``; without it they hold None in its place."""
        with self._lock:
            self._inputs[name].expected = expected

    def add(self, name: str, stamp_ns: int, message: Any) -> list[tuple[Any, ...]]:
        """Take a message and return the sets that it completes, in the order of ``names``."""
        with self._lock:
            self._arrive(self._inputs[name], _Entry(stamp_ns, message))
            return self._take_sets()

    def finish(self) -> list[tuple[Any, ...]]:
        """Return the sets that waited for a nearer message: none arrives any more."""
        with self._lock:
            for one in self._inputs.values():
                one.ended = True
            return self._take_sets()

    def clear(self) -> None:
        """Forget what waits and what was seen, but not what was dropped."""
        with self._lock:
            for one in self._inputs.values():
                one.waiting.clear()
                one.recent_ns.clear()
                one.lateness.clear()
                one.behind = 0

    def too_late(self) -> dict[str, int]:
        """Return the inputs whose messages came after their partners had to be dropped.

        Returns
        -------
        needed : dict of str to int
            The least ``queue_size`` with which the last few messages of each such input would
            have found their partners; at most 1000 can be told.

        """
        with self._lock:
            needed = {
                one.name: 1 + max(one.lateness, default=0)
                for one in self._inputs.values()
                if one.expected
            }
        return {name: count for name, count in needed.items() if count > self._queue_size}

    def explain(self) -> tuple[str, float] | None:
        """Say by how much stamps miss each other.

        Returns
        -------
        text : str
            The smallest difference of each input's recent stamps from the leader's.
        needed_s : float
            The tolerance that would let them match, s, rounded up to whole microseconds. None
            instead of both if stamps agree or there are none.

        """
        with self._lock:
            limit_ns = float('inf') if self._tolerance_ns is None else self._tolerance_ns
            misses_ns = {
                one.name: miss_ns
                for one in self._inputs.values()
                if (miss_ns := self._miss_ns(one)) is not None and abs(miss_ns) > limit_ns
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
        """Remove complete sets, and what is older: its partners would have come before theirs."""
        sets: list[tuple[Any, ...]] = []
        if any(one.expected and not one.waiting for one in self._inputs.values()):
            return sets
        for leading in list(self._leader.waiting):
            found = self._partners(leading)
            if found is not None:
                sets.append(tuple(entry and entry.message for entry in found))
                for one, entry in zip(self._inputs.values(), found, strict=True):
                    if entry is not None:
                        self._remove(one, entry)
        return sets

    def _remove(self, one: _Input, entry: _Entry) -> None:
        while one.waiting.popleft() is not entry:
            self.dropped[f'{one.name} without partner'] += 1

    def _miss_ns(self, one: _Input) -> int | None:
        """Return the smallest difference of an expected input's stamps from the leader's."""
        leading_ns = self._leader.recent_ns
        if not leading_ns or not one.recent_ns or not one.expected:
            return None
        gaps_ns = []
        for stamp_ns in islice(reversed(one.recent_ns), 2 * self._queue_size):
            after = bisect_right(leading_ns, stamp_ns)
            near_ns = [leading_ns[k] for k in (after - 1, after) if 0 <= k < len(leading_ns)]
            gaps_ns += [stamp_ns - leading for leading in near_ns]
        return min(gaps_ns, key=abs)

    def _note_lateness(self, one: _Input, stamp_ns: int) -> None:
        """Note how many messages came between the partner of a message and it."""
        others = self._inputs.values() if one is self._leader else [self._leader]
        tolerance_ns = self._tolerance_ns or 0
        if not one.behind:
            newer = [
                other.newer(stamp_ns, tolerance_ns)
                for other in others
                if other is not one and not other.behind
            ]
            one.lateness.append(max(newer, default=0))

    def _arrive(self, one: _Input, entry: _Entry) -> None:
        step_ns = entry.stamp_ns - one.recent_ns[-1] if one.recent_ns else 0
        if step_ns < 0:
            self._jump_back(one)
        else:
            one.behind = max(0, one.behind - 1)
        if step_ns > 0:
            one.step_ns = min(one.step_ns or step_ns, step_ns)
        one.recent_ns.append(entry.stamp_ns)
        self._note_lateness(one, entry.stamp_ns)
        one.waiting.append(entry)
        if len(one.waiting) > self._queue_size:
            one.waiting.popleft()
            self.dropped[f'{one.name} without partner'] += 1

    def _jump_back(self, jumped: _Input) -> None:
        self.dropped['clock went back'] += len(jumped.waiting)
        jumped.waiting.clear()
        jumped.recent_ns.clear()
        jumped.lateness.clear()
        if jumped.behind:
            jumped.behind = 0  # it follows a jump of another input
            return
        for one in self._inputs.values():
            if one is not jumped and one.recent_ns:
                one.behind = self._queue_size

    def _partners(self, leading: _Entry) -> list[_Entry | None] | None:
        """Return the set that ``leading`` begins, or None while it is incomplete."""
        found: list[_Entry | None] = []
        for one in self._inputs.values():
            entry = None if one.behind else self._partner(one, leading)
            if entry is None and one.expected:
                return None
            found.append(entry)
        stamps = [entry.stamp_ns for entry in found if entry is not None]
        if self._tolerance_ns is not None and max(stamps) - min(stamps) > self._tolerance_ns:
            return None
        return found

    def _partner(self, one: _Input, leading: _Entry) -> _Entry | None:
        """Return the message of an input that is nearest, and to which ``leading`` is nearest."""
        if one is self._leader:
            return leading
        entry = one.nearest(leading.stamp_ns)
        if entry is None or self._leader.nearest(entry.stamp_ns) is not leading:
            return None
        gap_ns = abs(entry.stamp_ns - leading.stamp_ns)
        if self._tolerance_ns is not None and gap_ns > self._tolerance_ns:
            return None
        settled = one.is_settled(leading.stamp_ns, gap_ns) and self._leader.is_settled(
            entry.stamp_ns, gap_ns
        )
        return entry if settled else None
