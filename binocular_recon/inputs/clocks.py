# SPDX-License-Identifier: Apache-2.0
"""How the clocks of two cameras differ, from the stamps and the arrival of their messages."""

from __future__ import annotations

import itertools
import statistics
from bisect import bisect_left
from collections.abc import Sequence
from typing import NamedTuple

# A message's stamp, and when it arrived by one clock for all inputs; both ns.
Arrival = tuple[int, int]
# Fewer messages say nothing about a clock.
_LEAST_ARRIVALS = 4
# Differences of stamps are constant if most lie this close to their median, as a share of the
# frame period.
_CONSTANT_SHARE = 0.1


class Mismatch(NamedTuple):
    """By how much the stamps of inputs miss each other.

    Attributes
    ----------
    text : str
        One sentence.
    tolerance_s : float or None
        The tolerance with which they would match, s, rounded up to whole microseconds; None if
        that is half a frame period or more, because it would combine different moments.
    offset_s : float or None
        What to add to the stamps of the right camera, s, if the clocks differ by a constant.

    """

    text: str
    tolerance_s: float | None
    offset_s: float | None = None


class ClockOffset(NamedTuple):
    """A constant by which one clock is ahead of another, and the spread of single stamps, ns."""

    offset_ns: int
    spread_ns: int


def clock_offset(leading: Sequence[Arrival], other: Sequence[Arrival]) -> ClockOffset | None:
    """Return by how much the stamps of ``other`` are ahead, None if that is not constant.

    Each message is compared with the one of ``leading`` that arrived at nearly the same time.
    """
    if min(len(leading), len(other)) < _LEAST_ARRIVALS:
        return None
    by_arrival = sorted(leading, key=lambda arrival: arrival[1])
    times = [arrived for _, arrived in by_arrival]
    differences = []
    for stamp, arrived in other:
        after = bisect_left(times, arrived)
        near = by_arrival[max(0, after - 1) : after + 1]
        nearest = min(near, key=lambda one: abs(one[1] - arrived))
        differences.append(stamp - nearest[0])
    offset = int(statistics.median(differences))
    spread = int(statistics.median(abs(one - offset) for one in differences))
    stamps = sorted({stamp for stamp, _ in leading})
    steps = [after - before for before, after in itertools.pairwise(stamps)]
    if not steps or spread > _CONSTANT_SHARE * statistics.median(steps):
        return None
    return ClockOffset(offset, spread)


def standing_still(name: str, stamp_ns: int) -> str:
    """Say that the stamps of an input do not advance."""
    return (
        f'stamps of {name} do not advance: all are {stamp_ns / 1e9:.9f} s, so nothing tells which'
        ' images belong together; let the driver stamp them'
    )
