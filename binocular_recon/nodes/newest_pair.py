# SPDX-License-Identifier: Apache-2.0
"""The newest pair of pictures, handed from the thread that receives to those that serve."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field

from binocular_recon.errors import CalibrationError
from binocular_recon.images import Image


@dataclass(frozen=True, eq=False)
class ImagePair:
    """Two pictures (H, W) or (H, W, C) of one size, taken together."""

    left: Image
    right: Image
    arrived_s: float = field(default_factory=time.monotonic)

    @property
    def size(self) -> tuple[int, int]:
        """Width and height, px."""
        return self.left.shape[1], self.left.shape[0]


class NewestPair:
    """Holds the newest pair; any thread may call."""

    def __init__(self) -> None:
        self._pair: ImagePair | None = None
        self._captured: ImagePair | None = None
        self._problem = ''
        self._changed = threading.Condition()

    def put(self, pair: ImagePair) -> None:
        """Take a pair in place of the one before."""
        self._replace(pair, '')

    def spoil(self, problem: str) -> None:
        """Say why the newest pair cannot be used, which makes the one before outdated."""
        self._replace(None, problem)

    def captured(self, pair: ImagePair | None) -> None:
        """Let `fresh` refuse this pair from now on; None: none."""
        self._captured = pair

    def fresh(self, silence: Callable[[], str]) -> ImagePair:
        """Return the newest pair.

        Parameters
        ----------
        silence : callable
            Says why no pair comes; empty while they do.

        Raises
        ------
        CalibrationError
            If it cannot be used, no board is in it that was not captured, or no newer one comes.

        """
        with self._changed:
            pair, problem = self._pair, self._problem
        if problem:
            raise CalibrationError(f'not captured: the newest pair cannot be used: {problem}')
        why = silence()
        if pair is None:
            raise CalibrationError(
                f'not captured: no synchronised pair yet; {why or "wait for the cameras"}'
            )
        if pair is self._captured:
            raise CalibrationError(
                'not captured: no synchronised pair has come since the last capture;'
                f' {why or "wait for the next one or check the cameras"}'
            )
        if why:
            age_s = time.monotonic() - pair.arrived_s
            raise CalibrationError(
                f'not captured: the last synchronised pair came {age_s:.1f} s ago; {why}'
            )
        return pair

    def after(self, pair: ImagePair, timeout_s: float) -> ImagePair | None:
        """Return the newest pair once it is another one than ``pair``; None if none comes."""
        with self._changed:
            self._changed.wait_for(lambda: self._pair not in (pair, None), timeout_s)
            return self._pair if self._pair is not pair else None

    def _replace(self, pair: ImagePair | None, problem: str) -> None:
        with self._changed:
            self._pair, self._problem = pair, problem
            self._changed.notify_all()
