# SPDX-License-Identifier: Apache-2.0
"""Where frames are computed: what all such places have in common, and this process."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path
from typing import Protocol

from binocular_recon.apps.batch.frame_task import (
    FrameFailedError,
    FrameOutcome,
    FrameTask,
    compute_frame,
)
from binocular_recon.errors import BinocularReconError
from binocular_recon.io.files import naming_errors

# How often a frame is computed before it is given up.
_TRIES = 2


class Place(Protocol):
    """Where frames are computed."""

    @property
    def capacity(self) -> int:
        """How many frames to hand out at once."""

    @property
    def compiles(self) -> bool:
        """Whether the kernels' cache of this machine is used."""

    def submit(self, task: FrameTask, folder: Path) -> Future[FrameOutcome]:
        """Compute a frame, twice if the first try fails; its files go to ``folder``.

        The result raises a FrameFailedError if both tries fail, and any other BinocularReconError
        if it makes no sense to go on.
        """

    def opening(self) -> str:
        """Return what to say at the beginning; it may be empty."""

    def remark(self, outcome: FrameOutcome) -> str:
        """Return what to say after the first frame; it may be empty."""

    def close(self) -> None:
        """End what computes; it does not wait for frames."""


class ThisProcess:
    """Compute each frame when it is submitted."""

    capacity, compiles = 1, True

    def submit(self, task: FrameTask, folder: Path) -> Future[FrameOutcome]:
        """As of every `Place`."""
        future: Future[FrameOutcome] = Future()
        try:
            future.set_result(repeated(compute_frame, task, folder))
        except BinocularReconError as error:
            future.set_exception(error)
        return future

    def opening(self) -> str:
        """Return nothing."""
        return ''

    def remark(self, outcome: FrameOutcome) -> str:
        """Return nothing."""
        del outcome
        return ''

    def close(self) -> None:
        """Do nothing."""


def repeated(
    compute: Callable[[FrameTask, Path], FrameOutcome], task: FrameTask, folder: Path
) -> FrameOutcome:
    """Compute a frame, once more if that fails; raises a FrameFailedError if both tries fail."""
    reason = ''
    for _ in range(_TRIES):
        try:
            return compute(task, folder)
        except FrameFailedError as error:  # noqa: PERF203 - frames take longer
            reason = str(error)
            with naming_errors(folder):
                for part in folder.iterdir():
                    part.unlink()
    raise FrameFailedError(f'computed {_TRIES} times without a result: {reason}')
