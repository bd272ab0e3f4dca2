# SPDX-License-Identifier: Apache-2.0
"""The search range of a stream of frames from live cameras."""

from __future__ import annotations

import functools
import math
import threading
from typing import NamedTuple

from binocular_recon.config import MatchConfig
from binocular_recon.images import FloatImage
from binocular_recon.stereo.search_range import SearchRange, choose_range

# The range is examined on each of the first frames, then at this interval. It shrinks when this
# many examinations in a row have found a range smaller than this share of it.
FIRST_FRAMES, EXAMINE_EVERY_S = 3, 2.0
SHRINK_AFTER, SHRINK_SHARE = 5, 0.7


class Tracked(NamedTuple):
    """The range to search in a frame, whether it has changed, and a warning if it is too small."""

    search: SearchRange
    changed: bool
    warning: str


class RangeTracker:
    """The search range of a stream: found in the first frames, examined again at intervals.

    It grows at once when a surface is outside, and shrinks only when several examinations in a row
    have found a much smaller range, so that a passing car does not change it back and forth.
    It may be used from several threads.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._key: object = None
        self._search: SearchRange | None = None
        self._warning = ''
        self._examined = 0
        self._next_s = -math.inf
        self._smaller: list[SearchRange] = []

    def update(
        self,
        left: FloatImage,
        right: FloatImage,
        config: MatchConfig,
        infinity_px: float,
        now_s: float,
    ) -> Tracked:
        """Return the range for a frame.

        Parameters
        ----------
        left, right, config, infinity_px
            As for `choose_range`.
        now_s : float
            Time of a monotonic clock, s.

        """
        with self._lock:
            key = config, infinity_px, left.shape
            if key != self._key:
                self._key, self._search, self._examined = key, None, 0
                self._next_s, self._warning, self._smaller = -math.inf, '', []
            before = self._search
            if self._search is None or now_s >= self._next_s:
                found = choose_range(left, right, config, infinity_px)
                self._warning = found.warning
                self._search = self._merged(found.search)
                self._examined += 1
                if self._examined >= FIRST_FRAMES:
                    self._next_s = now_s + EXAMINE_EVERY_S
            return Tracked(self._search, self._search != before, self._warning)

    def _merged(self, found: SearchRange) -> SearchRange:
        now = self._search
        if now is None:
            return found
        wider = _union(now, found)
        if wider != now:
            self._smaller = []
            return wider
        if found.disparity_range > SHRINK_SHARE * now.disparity_range:
            self._smaller = []
            return now
        self._smaller.append(found)
        if len(self._smaller) < SHRINK_AFTER:
            return now
        smaller, self._smaller = self._smaller, []
        return functools.reduce(_union, smaller)


def _union(one: SearchRange, other: SearchRange) -> SearchRange:
    low, last = min(one.min_disparity, other.min_disparity), max(one.last, other.last)
    return SearchRange(low, last - low + 1)
