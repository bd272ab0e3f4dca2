# SPDX-License-Identifier: Apache-2.0
"""Run jobs in worker threads, the newest first, when they are wanted, without a backlog."""

from __future__ import annotations

import functools
import threading
import time
from collections.abc import Callable
from typing import Any, Generic, TypeVar

from binocular_recon._jit import use_lane
from binocular_recon.errors import BinocularReconError, CalibrationError
from binocular_recon.nodes.runtime.demand import Demand, Requests
from binocular_recon.nodes.runtime.health import Health

Job = TypeVar('Job')
# The second half of a frame's work.
Rest = Callable[[], None]


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
                self._changed.notify_all()
            try:
                self._work(job)
            except Exception as error:  # noqa: BLE001 - a fault in one job must not end the thread
                self._on_error(error)
            del job  # else its images stay in memory until the next job


class NextWorker(LatestWorker[Job]):
    """A thread that does every job, in order: who hands one in waits until it is begun.

    So the next frame is begun while this thread finishes one, and at most one more is complete.
    """

    def submit(self, job: Job) -> bool:
        """Hand in a job and wait until it is begun, or the thread has ended; return False."""
        super().submit(job)
        with self._changed:
            self._changed.wait_for(lambda: not self._waiting or self._closed)
        return False


class InTwoThreads:
    """Processes frames in the thread that calls, and their second halves in one of its own.

    A frame that cannot be used is counted and reported.

    Parameters
    ----------
    health : Health
        Counts the frames.
    process : callable
        Processes a frame, given as its messages, or returns the second half of that work.
    start_worker : callable
        Starts a worker of the node.

    """

    def __init__(
        self,
        health: Health,
        process: Callable[..., Rest | None],
        start_worker: Callable[
            [Callable[[Any], None], type[LatestWorker[Any]]], LatestWorker[Any]
        ],
    ) -> None:
        self._health, self._process = health, process
        self._second = start_worker(self._finish, NextWorker)
        self._lock, self._processed = threading.Lock(), 0

    def process(self, messages: tuple[Any, ...]) -> None:
        """Process a frame; its second half may be still to be done."""
        self._do(functools.partial(self._process, *messages), time.monotonic())

    def processed(self) -> int:
        """Return how many frames are done since the last call."""
        with self._lock:
            count, self._processed = self._processed, 0
            return count

    def _finish(self, rest: tuple[Rest, float]) -> None:
        use_lane('-second')
        self._do(*rest)

    def _do(self, work: Callable[[], Rest | None], begun_s: float) -> None:
        try:
            rest = work()
        except BinocularReconError as error:
            kind = 'bad calibration' if isinstance(error, CalibrationError) else 'bad input'
            self._health.dropped(kind)
            self._health.error(str(error))
        except MemoryError as error:
            self._health.dropped('not enough memory')
            self._health.error(f'{error}; reduce disparity_range or the size of the images')
        else:
            if rest is not None:
                self._second.submit((rest, begun_s))
                return
            with self._lock:
                self._processed += 1
            self._health.processed(time.monotonic() - begun_s)


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
