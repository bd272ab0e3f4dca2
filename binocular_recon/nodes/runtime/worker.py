# SPDX-License-Identifier: Apache-2.0
"""Run jobs in a worker thread, the newest first, without a backlog."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Generic, TypeVar

Job = TypeVar('Job')


class LatestWorker(Generic[Job]):
    """A thread that does one job at a time; while it is busy only the newest job waits.

    Parameters
    ----------
    work : callable
        Does a job, in the worker thread.
    on_error : callable
        Called in the worker thread with what ``work`` raised; the thread then takes the next job.

    """

    def __init__(self, work: Callable[[Job], None], on_error: Callable[[Exception], None]) -> None:
        self._work, self._on_error = work, on_error
        self._waiting: list[Job] = []  # at most one
        self._closed = False
        self._changed = threading.Condition()
        self._thread = threading.Thread(target=self._run, name='worker', daemon=True)
        self._thread.start()

    def submit(self, job: Job) -> bool:
        """Hand in a job; return True if it replaced one that was still waiting."""
        with self._changed:
            replaced = bool(self._waiting)
            self._waiting = [job]
            self._changed.notify()
            return replaced

    def close(self, timeout_s: float | None = None) -> None:
        """Let the current job finish and start no other."""
        with self._changed:
            self._closed = True
            self._changed.notify()
        self._thread.join(timeout_s)

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._waiting or self._closed)
                if self._closed:
                    return
                job = self._waiting.pop()
            try:
                self._work(job)
            except Exception as error:  # noqa: BLE001 - a fault in one job must not end the thread
                self._on_error(error)
            del job  # else its images stay in memory until the next job
