# SPDX-License-Identifier: Apache-2.0
"""Frames computed by several processes of this machine."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from queue import SimpleQueue
from typing import Any

from binocular_recon._jit import thread_count
from binocular_recon.apps.batch.frame_task import FrameFailedError, FrameOutcome, FrameTask
from binocular_recon.apps.batch.places import repeated
from binocular_recon.apps.batch.worker import serve
from binocular_recon.errors import BinocularReconError, ConfigError
from binocular_recon.number_text import counted

# Not forked: the threads of kernels would be missing.
_SPAWN = multiprocessing.get_context('spawn')
_MIB = 1 << 20
_SAFE_PATH = 'PYTHONSAFEPATH'
# So many processes in a row that die before they work: none will.
_MOST_UNSTARTED = 4
# How long the status of a dead process may be unknown, s.
_STATUS_S = 1.0


class LocalProcesses:
    """Processes that share the cores of this machine, each with as many threads as fit.

    One that dies is replaced. All end with this process, however that ends.

    Parameters
    ----------
    jobs : int
        Number of processes.

    Raises
    ------
    ConfigError
        If there are fewer cores.

    """

    compiles = True

    def __init__(self, jobs: int) -> None:
        cores = len(os.sched_getaffinity(0))
        if not 1 <= jobs <= cores:
            raise ConfigError(
                f'jobs must be 1 to {cores}, the number of cores that this process may use, got'
                f' {jobs}'
            )
        self._jobs, self._threads = jobs, min(thread_count(), cores // jobs)
        self._lock, self._closed, self._unstarted = threading.Lock(), False, 0
        self._idle: SimpleQueue[_Process] = SimpleQueue()
        self._all = [_Process(self._threads) for _ in range(jobs)]
        for process in self._all:
            self._idle.put(process)
        self._callers = ThreadPoolExecutor(jobs, thread_name_prefix='frame')

    @property
    def capacity(self) -> int:
        """One frame that is computed and one that waits, for each process."""
        return 2 * self._jobs

    def submit(self, task: FrameTask, folder: Path) -> Future[FrameOutcome]:
        """As of every `Place`."""
        return self._callers.submit(repeated, self._compute, task, folder)

    def opening(self) -> str:
        """Say how the cores are divided."""
        processes = counted(self._jobs, 'process', 'processes')
        return f'{processes} with {counted(self._threads, "thread")} each'

    def remark(self, outcome: FrameOutcome) -> str:
        """Say how much memory the processes take."""
        if outcome.peak_bytes is None:
            return ''
        each = outcome.peak_bytes / _MIB
        total = os.sysconf('SC_PAGE_SIZE') * os.sysconf('SC_PHYS_PAGES') / _MIB
        return (
            f'memory: {each:.0f} MiB for a process, {self._jobs * each:.0f} for all, of the'
            f' {total:.0f} MiB of this machine'
        )

    def close(self) -> None:
        """End the processes at once."""
        with self._lock:
            self._closed = True
            for process in self._all:
                process.kill()
        self._callers.shutdown(cancel_futures=True)
        for process in self._all:
            process.join()

    def _compute(self, task: FrameTask, folder: Path) -> FrameOutcome:
        process = self._idle.get()
        try:
            return process.compute(task, folder)
        except _DiedError as death:
            self._unstarted = 0 if process.ready else self._unstarted + 1
            if self._unstarted == _MOST_UNSTARTED:
                raise BinocularReconError(
                    f'processes for frames cannot be started: {death}; see above, or go on with'
                    ' one process (--jobs 1)'
                ) from None
            process = self._started() or process
            raise
        finally:
            self._idle.put(process)

    def _started(self) -> _Process | None:
        """Start a process, unless all are about to end."""
        with self._lock:
            if self._closed:
                return None
            self._all = [one for one in self._all if one.runs]
            self._all.append(_Process(self._threads))
            return self._all[-1]


@contextlib.contextmanager
def _only_installed_modules() -> Iterator[None]:
    """Let processes that start, from Python 3.11, not look for modules in the current folder."""
    before = os.environ.get(_SAFE_PATH)
    os.environ[_SAFE_PATH] = '1'
    try:
        yield
    finally:
        if before is None:
            del os.environ[_SAFE_PATH]
        else:
            os.environ[_SAFE_PATH] = before


class _DiedError(FrameFailedError):
    """The process that computed a frame has died."""


class _Process:
    """A process that computes one frame after the other."""

    def __init__(self, threads: int) -> None:
        self._connection, end = _SPAWN.Pipe()
        self._process = _SPAWN.Process(target=serve, args=(end, threads), daemon=True)
        self.ready = False
        with _only_installed_modules():
            self._process.start()
        end.close()

    @property
    def runs(self) -> bool:
        return self._process.is_alive()

    def compute(self, task: FrameTask, folder: Path) -> FrameOutcome:
        """Return what came of a frame; raises a _DiedError if the process dies."""
        try:
            if not self.ready:
                self.ready = bool(self._connection.recv())
            self._connection.send((task, folder))
            outcome: Any = self._connection.recv()
        except (EOFError, OSError):
            raise self._death() from None
        if isinstance(outcome, BaseException):
            raise outcome
        found: FrameOutcome = outcome
        return found

    def _death(self) -> _DiedError:
        self.join()
        end_s = time.monotonic() + _STATUS_S
        while self._process.exitcode is None and time.monotonic() < end_s:
            time.sleep(0.01)  # another thread has taken the status and is about to note it
        status = self._process.exitcode or 0
        if status >= 0:
            how = f'ended with status {status}'
        else:
            how = f'was ended by {signal.Signals(-status).name}'
            if -status == signal.SIGKILL:
                how += ', as the system does when memory is short; use fewer --jobs if it was'
        if not self.ready:
            how += '; it had not started to work yet'
        return _DiedError(f'the process that computed it {how}')

    def kill(self) -> None:
        self._process.kill()

    def join(self) -> None:
        self._process.join(1.0)
