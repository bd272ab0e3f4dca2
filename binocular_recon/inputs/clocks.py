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
# Stamps are this many times their median deviation apart at most.
_SPREADS = 6


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
    offset_tolerance_s : float
        The tolerance that single stamps need beside it, s; 0 if they are then equal.

    """

    text: str
    tolerance_s: float | None
    offset_s: float | None = None
    offset_tolerance_s: float = 0.0

    @property
    def offset_text(self) -> str:
        """The offset with as many decimals as it needs."""
        return _offset_text(self.offset_s or 0.0)


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


def stamp_offset(
    found: ClockOffset, present_ns: int, period_ns: int | None
) -> tuple[float, float]:
    """Return the offset (s) to set instead of the present one, and the tolerance (s) beside it.

    A tolerance is needed where stamps scatter, or where the offset as it is written leaves a rest.
    """
    offset_ns = present_ns - found.offset_ns
    written_ns = round(float(_offset_text(offset_ns / 1e9)) * 1e9)
    needed_ns = abs(written_ns - offset_ns) + _SPREADS * found.spread_ns
    tolerance_us = -(-needed_ns // 1000)
    if period_ns is not None:  # from half a period on, different moments match
        tolerance_us = min(tolerance_us, (period_ns // 2 - 1) // 1000)
    return offset_ns / 1e9, tolerance_us / 1e6


def _offset_text(offset_s: float) -> str:
    short = f'{offset_s:.6f}'
    return short if round(float(short) * 1e9) == round(offset_s * 1e9) else f'{offset_s:.9f}'


def standing_still(name: str, stamp_ns: int) -> str:
    """Say that the stamps of an input do not advance."""
    return (
        f'stamps of {name} do not advance: all are {stamp_ns / 1e9:.9f} s, so nothing tells which'
        ' images belong together; let the driver stamp them'
    )
