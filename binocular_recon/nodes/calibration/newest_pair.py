# SPDX-License-Identifier: Apache-2.0
"""The newest image pair, handed from the thread that receives it to those that use it."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field

from binocular_recon.errors import CalibrationError
from binocular_recon.images import Image
from binocular_recon.inputs.common_size import CommonSize


@dataclass(frozen=True, eq=False)
class ImagePair:
    """Two images (H, W) or (H, W, C) taken at the same time."""

    left: Image
    right: Image
    arrived_s: float = field(default_factory=time.monotonic)

    @property
    def sizes(self) -> CommonSize:
        """Sizes of both images."""
        left, right = ((image.shape[1], image.shape[0]) for image in (self.left, self.right))
        return CommonSize(left, right)


class NewestPair:
    """Holds the newest pair; any thread may call."""

    def __init__(self) -> None:
        self._pair: ImagePair | None = None
        self._captured: ImagePair | None = None
        self._problem = ''
        self._changed = threading.Condition()

    def put(self, pair: ImagePair) -> None:
        """Replace the pair by a newer one."""
        self._replace(pair, '')

    def invalidate(self, problem: str) -> None:
        """Drop the pair because a newer one cannot be used, and say why it cannot."""
        self._replace(None, problem)

    def mark_captured(self, pair: ImagePair | None) -> None:
        """Let `take` refuse this pair from now on; None: refuse none."""
        self._captured = pair

    def take(self, explain_silence: Callable[[], str]) -> ImagePair:
        """Return the newest pair.

        Parameters
        ----------
        explain_silence : callable
            Returns why no pairs arrive, '' while they do.

        Raises
        ------
        CalibrationError
            If it cannot be used, was captured before, or no newer ones arrive.

        """
        with self._changed:
            pair, problem = self._pair, self._problem
        if problem:
            raise CalibrationError(f'not captured: the newest image pair is unusable: {problem}')
        silence = explain_silence()
        if pair is None:
            raise CalibrationError(
                'not captured: no synchronised image pair has arrived yet;'
                f' {silence or "wait for the cameras"}'
            )
        if pair is self._captured:
            raise CalibrationError(
                'not captured: no synchronised image pair has arrived since the last capture;'
                f' {silence or "wait for the next one or check the cameras"}'
            )
        if silence:
            age_s = time.monotonic() - pair.arrived_s
            raise CalibrationError(
                f'not captured: the last synchronised image pair arrived {age_s:.1f} s ago;'
                f' {silence}'
            )
        return pair

    def wait_for_next(self, pair: ImagePair, timeout_s: float) -> ImagePair | None:
        """Return the first pair that replaces ``pair``, None if none arrives in time."""
        with self._changed:
            self._changed.wait_for(lambda: self._pair not in (pair, None), timeout_s)
            return self._pair if self._pair is not pair else None

    def _replace(self, pair: ImagePair | None, problem: str) -> None:
        with self._changed:
            self._pair, self._problem = pair, problem
            self._changed.notify_all()
