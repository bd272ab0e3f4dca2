# SPDX-License-Identifier: Apache-2.0
"""Frames computed by the workers of a Dask cluster, on this machine or others.

The images are sent and the files of the frames come back, so that workers need no folder that
others see.
"""

from __future__ import annotations

import logging
import tempfile
import threading
import time
import warnings
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import cv2

from binocular_recon._jit import thread_count
from binocular_recon.apps.batch.frame_task import (
    FrameFailedError,
    FrameOutcome,
    FrameTask,
    compute_frame,
)
from binocular_recon.apps.batch.places import repeated
from binocular_recon.errors import ClusterError, FileError, shortened
from binocular_recon.io.files import naming_errors
from binocular_recon.machine import optional_package
from binocular_recon.number_text import counted

# A scheduler answers within this time, or is not there.
_ANSWER_S = 10.0
# Frames that are sent: for each thread of the workers, at least and at most. Workers come and go,
# so their number is asked for again after a while.
_PER_THREAD, _LEAST, _MOST = 2, 2, 256
_ASK_AGAIN_S = 5.0
# Packages that decide about the bits of the results; a worker needs the same versions.
_PACKAGES = ('binocular_recon', 'numpy', 'scipy', 'numba', 'cv2')


class DaskCluster:
    """The workers of a Dask scheduler.

    Frames of a worker that is lost are given to another one by the scheduler; those that cost
    more workers than it allows (``distributed.scheduler.allowed-failures``) have failed.

    Parameters
    ----------
    address : str
        Of the scheduler, such as ``tcp://host:8786``.

    Raises
    ------
    DependencyError
        If distributed is not installed.
    ClusterError
        If no scheduler answers, or a worker has other versions.

    """

    compiles = False

    def __init__(self, address: str) -> None:
        self._distributed: Any = optional_package('distributed', 'clusters')
        self._address = address
        # what matters of it comes as an error; it would be a traceback of many lines
        logging.getLogger('distributed').setLevel(logging.CRITICAL)
        # images go with their task: what is stored on a worker would be lost with it
        warnings.filterwarnings('ignore', 'Sending large graph')
        try:
            self._distributed.comm.resolve_address(address)  # a client of a wrong one lingers
            self._client = self._distributed.Client(
                address, timeout=_ANSWER_S, set_as_default=False
            )
        except (OSError, ValueError, TypeError) as error:
            raise ClusterError(
                f'no Dask scheduler answers at {address!r} within {_ANSWER_S:.0f} s'
                f' ({shortened(error)}); start one (`dask scheduler`) and give the address that it'
                ' prints, such as tcp://host:8786'
            ) from error
        self._lock = threading.Lock()
        self._checked: set[str] = set()
        self._threads, self._asked_s = 0, -_ASK_AGAIN_S
        self._check_workers()
        self._callers = ThreadPoolExecutor(_MOST, thread_name_prefix='frame')

    @property
    def capacity(self) -> int:
        """As many frames as keep the workers busy."""
        if time.monotonic() - self._asked_s > _ASK_AGAIN_S:
            self._check_workers()
        return max(_LEAST, min(_PER_THREAD * self._threads, _MOST))

    def submit(self, task: FrameTask, folder: Path) -> Future[FrameOutcome]:
        """As of every `Place`."""
        return self._callers.submit(repeated, self._compute, task, folder)

    def opening(self) -> str:
        """Say how many workers there are."""
        if not self._checked:
            return f'{self._address} has no workers yet; frames wait for them'
        workers = counted(len(self._checked), 'worker')
        return f'{workers} with {counted(self._threads, "thread")} at {self._address}'

    def remark(self, outcome: FrameOutcome) -> str:
        """Return nothing: each worker has its own memory."""
        del outcome
        return ''

    def close(self) -> None:
        """Leave the cluster; what workers compute at the moment is dropped."""
        self._client.close(timeout=1)
        self._callers.shutdown(wait=False, cancel_futures=True)

    def _compute(self, task: FrameTask, folder: Path) -> FrameOutcome:
        try:
            future = self._client.submit(compute_remotely, task, pure=False)
            outcome, files = future.result()
        except self._distributed.KilledWorker as error:
            raise FrameFailedError(
                'the workers that computed it were lost, perhaps for lack of memory'
                f' ({shortened(error)})'
            ) from error
        except (CancelledError, self._distributed.comm.CommClosedError) as error:
            raise ClusterError(
                f'the Dask scheduler at {self._address} is gone; start it and its workers, and run'
                ' the same command again to continue'
            ) from error
        self._check_workers()
        with naming_errors(folder):
            for name, content in files.items():
                (folder / name).write_bytes(content)
        found: FrameOutcome = outcome
        return found

    def _check_workers(self) -> None:
        """Count the workers; raises a ClusterError if a new one has other versions."""
        with self._lock:
            try:
                threads = self._client.nthreads()
                if not threads.keys() <= self._checked:
                    check_versions(self._client.get_versions(packages=list(_PACKAGES)))
            except (OSError, self._distributed.comm.CommClosedError) as error:
                raise ClusterError(
                    f'the Dask scheduler at {self._address} does not answer any more'
                    f' ({shortened(error)}); start it and its workers, and run the same command'
                    ' again to continue'
                ) from error
            self._checked = set(threads)
            self._threads, self._asked_s = sum(threads.values()), time.monotonic()


def check_versions(versions: dict[str, Any]) -> None:
    """Raise a ClusterError if a worker has other versions, by what ``get_versions`` returned."""
    ours = versions['client']['packages']
    for address, worker in versions['workers'].items():
        for name in _PACKAGES:
            theirs = worker['packages'].get(name)
            if theirs != ours[name]:
                has = f'has {name} {theirs}' if theirs else f'does not have {name}'
                raise ClusterError(
                    f'the worker {address} {has}, this machine has {ours[name]}; install the same'
                    ' version there and start the worker again'
                )


def compute_remotely(task: FrameTask) -> tuple[FrameOutcome, dict[str, bytes]]:
    """Compute a frame and return its files by name; runs on a worker."""
    cv2.setNumThreads(thread_count())
    with tempfile.TemporaryDirectory(prefix='binocular_recon_') as folder:
        try:
            outcome = compute_frame(task, Path(folder))
            return outcome, {path.name: path.read_bytes() for path in Path(folder).iterdir()}
        except FileError as error:  # the next try may be on another machine
            raise FrameFailedError(f'on a worker {error}') from error
