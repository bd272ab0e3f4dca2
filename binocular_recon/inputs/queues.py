# SPDX-License-Identifier: Apache-2.0
"""The messages that wait on one input for their partners, and what is known of its stamps."""

from __future__ import annotations

from bisect import bisect_right
from collections import deque
from dataclasses import dataclass
from operator import attrgetter
from typing import Any

from binocular_recon.inputs.clocks import Arrival

# Stamps kept for each input, independently of the queue: they distinguish a message that arrives
# after its partner was dropped from one that never had a partner.
_STAMP_HISTORY = 1000
# How many last messages of an input `too_late` looks at.
_LATENESS_HISTORY = 10
# Arrivals kept for each input: they show how the clocks differ.
_ARRIVALS = 50


@dataclass(frozen=True, eq=False)
class Entry:
    """A message and its stamp."""

    stamp_ns: int
    message: Any


class MessageQueue:
    """The messages that have arrived on one input."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.waiting: deque[Entry] = deque()  # by stamp
        self.recent_ns: deque[int] = deque(maxlen=_STAMP_HISTORY)  # never decreases
        # for each message, how many messages of another input arrived after its partner there
        self.lateness: deque[int] = deque(maxlen=_LATENESS_HISTORY)
        self.arrivals: deque[Arrival] = deque(maxlen=_ARRIVALS)
        self.equal = 0  # how many stamps in a row, up to the last one, are the same
        self.period_ns: int | None = None  # smallest step between consecutive stamps
        # another input has jumped back and this one has not: messages after which that is ignored
        self.behind = 0
        self.ended = False
        self.expected = True

    def nearest(self, stamp_ns: int) -> Entry | None:
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
