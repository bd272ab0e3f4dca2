# SPDX-License-Identifier: Apache-2.0
"""Run jobs in a worker thread, the newest first, when they are wanted, without a backlog."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Generic, TypeVar

from binocular_recon.nodes.runtime.demand import Demand, Requests
from binocular_recon.nodes.runtime.health import Health

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


class Intake(Generic[Job]):
    """Holds the newest frame until the node's consumers, and its rate limit, let it pass.

    Parameters
    ----------
    health : Health
        Counts the frames that are not used.
    submit : callable
        Hands a frame to the worker; returns True if it replaced one that was waiting there.
    max_rate_hz : callable
        Returns the largest number of frames per second; 0 = any.

    Attributes
    ----------
    demand : Demand, optional
        What the consumers ask for.
    requests : Requests, optional
        What the node asks of those before it.

    """

    def __init__(
        self, health: Health, submit: Callable[[Job], bool], max_rate_hz: Callable[[], float]
    ) -> None:
        self.demand: Demand | None = None
        self.requests: Requests | None = None
        self._health, self._submit, self._max_rate_hz = health, submit, max_rate_hz
        self._lock = threading.Lock()
        self._held: list[Job] = []  # at most one
        self._superseded, self._due_s, self._busy = 0, -float('inf'), False

    def offer(self, frame: Job) -> None:
        """Take a frame; it replaces one that is still held."""
        if not self._within_rate(time.monotonic()):
            self._health.dropped('more than max_rate')
            return
        with self._lock:
            replaced, self._held = bool(self._held), [frame]
        self._count(replaced)
        self.release()

    def release(self) -> None:
        """Hand on the frame that is held, if it is wanted now."""
        if self.demand is not None and not self.demand.waiting:
            return
        with self._lock:
            frames, self._held = self._held, []
        for frame in frames:
            if self.demand is not None:
                self.demand.sent()
            self._count(self._submit(frame))

    def ask(self) -> None:
        """Ask for the next frame, if what is made of it would be taken."""
        if self.requests is not None and (self.demand is None or self.demand.waiting):
            self.requests.ask()

    def update(self) -> None:
        """Look again at who takes the node's outputs."""
        if self.demand is not None:
            self.demand.update()

    def work(self, process: Callable[[Job], None], frame: Job, *, asks_early: bool) -> None:
        """Process a frame in the worker thread and ask for the next, at the begin or the end."""
        self._busy = True
        if asks_early:
            self.ask()
        try:
            process(frame)
        finally:
            self._busy = False
            if not asks_early:
                self.ask()

    def ask_if_idle(self) -> None:
        """Ask for a frame unless one is being processed, whose end will ask."""
        if not self._busy:
            self.ask()

    def superseded(self) -> int:
        """Return how many frames gave way to newer ones since the last call."""
        with self._lock:
            count, self._superseded = self._superseded, 0
            return count

    def _count(self, replaced: bool) -> None:
        if replaced:
            self._health.dropped('a newer set came before it was begun')
            with self._lock:
                self._superseded += 1

    def _within_rate(self, now_s: float) -> bool:
        """Tell whether a frame keeps to the rate; one may be early if earlier ones were late."""
        rate_hz = self._max_rate_hz()
        if rate_hz <= 0:
            return True
        if now_s < self._due_s:
            return False
        self._due_s = max(self._due_s, now_s - 1 / rate_hz) + 1 / rate_hz
        return True
