# SPDX-License-Identifier: Apache-2.0
"""Messages of several topics that belong to the same moment."""

from __future__ import annotations

import threading
from collections import Counter, deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, eq=False)
class _Entry:
    stamp_ns: int
    message: Any


class _Input:
    """What has arrived on one topic."""

    def __init__(self, name: str, queue_size: int) -> None:
        self.name = name
        self.waiting: deque[_Entry] = deque()
        self.recent_ns: deque[int] = deque(maxlen=2 * queue_size)
        self.step_ns: int | None = None  # smallest distance of consecutive stamps
        self.behind = 0  # messages for which it may still be in the time before a jump back
        self.ended = False
        self.expected = True

    def nearest(self, stamp_ns: int) -> _Entry | None:
        """Return the waiting message nearest to a stamp, the latest arrival among equals."""
        newest_first = reversed(self.waiting)
        return min(newest_first, key=lambda entry: abs(entry.stamp_ns - stamp_ns), default=None)

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
        self._inputs = {name: _Input(name, queue_size) for name in names}
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
                one.behind = 0

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
        sets = []
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
        gaps_ns = [b - a for a in self._leader.recent_ns for b in one.recent_ns]
        return min(gaps_ns, key=abs) if gaps_ns and one.expected else None

    def _arrive(self, one: _Input, entry: _Entry) -> None:
        step_ns = entry.stamp_ns - one.recent_ns[-1] if one.recent_ns else 0
        if step_ns < 0:
            self._jump_back(one)
        else:
            one.behind = max(0, one.behind - 1)
        if step_ns > 0:
            one.step_ns = min(one.step_ns or step_ns, step_ns)
        one.recent_ns.append(entry.stamp_ns)
        one.waiting.append(entry)
        if len(one.waiting) > self._queue_size:
            one.waiting.popleft()
            self.dropped[f'{one.name} without partner'] += 1

    def _jump_back(self, jumped: _Input) -> None:
        self.dropped['clock went back'] += len(jumped.waiting)
        jumped.waiting.clear()
        jumped.recent_ns.clear()
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
