# SPDX-License-Identifier: Apache-2.0
"""Compile kernels, and run them on all cores."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, wait
from functools import cache
from typing import Any, TypeVar, cast

import cv2
import numba
import numpy.typing as npt

from binocular_recon._kernel_cache import enable_cache

F = TypeVar('F', bound=Callable[..., Any])
Array = npt.NDArray[Any]  # in kernels: numba infers the dtype

# Without nnan and ninf: NaN means "no data", so the compiler must not assume that there is none.
FASTMATH = {'contract', 'arcp', 'nsz', 'reassoc'}


def kernel(function: F) -> F:
    """Compile ``function`` with the GIL released and the result cached on disk."""
    return _compile(function, FASTMATH)


def ordered_kernel(function: F) -> F:
    """Compile like `kernel`, but evaluate sums and products in the order written."""
    return _compile(function, FASTMATH - {'reassoc'})


def exact_kernel(function: F) -> F:
    """Compile like `kernel`, but every operation as written.

    Loops that are compiled twice, for whole vectors and for what remains, then round alike: the
    same input gives the same bits wherever it stands in the image.
    """
    return _compile(function, set())


def inline_kernel(function: F) -> F:
    """Compile like `kernel`, always inlined into the calling kernels: for those that kernels call.

    Without inlining, a kernel that another one calls exists twice in a process: compiled alone,
    and compiled again with its caller, where sums may be ordered otherwise. Which of them the
    caller gets depends on what was loaded before, so the last bits of results would, too.
    """
    return _compile(function, FASTMATH, forceinline=True)


def _compile(function: F, fastmath: set[str], *, forceinline: bool = False) -> F:
    decorate = numba.njit(
        nogil=True,
        fastmath=fastmath or False,
        error_model='numpy',
        boundscheck=False,
        forceinline=forceinline,
    )
    compiled: Any = decorate(function)
    enable_cache(compiled, function)
    return cast('F', compiled)


_limit = 0


def limit_threads(count: int) -> None:
    """Run kernels and OpenCV's functions on at most ``count`` threads; 0 = one per core."""
    global _limit  # noqa: PLW0603 - a property of the process, as OpenCV's is
    if count != _limit:
        _limit = count
        cv2.setNumThreads(count or -1)


def thread_count() -> int:
    """Return the number of threads of kernels.

    It is that of the cores this process may use; ``OMP_NUM_THREADS`` and `limit_threads` lower it.
    """
    available = len(os.sched_getaffinity(0)) if hasattr(os, 'sched_getaffinity') else 1
    available = min(available, _limit or available)
    limit = os.environ.get('OMP_NUM_THREADS', '')
    return max(1, min(available, int(limit))) if limit.isdigit() else available


_lane = threading.local()


def use_lane(name: str) -> None:
    """Run the kernels that this thread calls beside those of other lanes, not behind them.

    Threads of one lane share its pool, where what is called first runs first: a thread with many
    short kernels would wait for the long ones of another.
    """
    _lane.name = name


@cache
def _pool(threads: int, lane: str) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(threads, thread_name_prefix=f'kernel{lane}')


if hasattr(os, 'register_at_fork'):  # a forked process does not inherit the threads
    os.register_at_fork(after_in_child=_pool.cache_clear)


def over_strips(function: Callable[..., None], length: int, *args: Any, strip: int = 64) -> None:
    """Call ``function(*args, start, stop)`` for strips of ``range(length)`` on all cores.

    The strips do not depend on the number of threads, so results that are accumulated per strip
    do not either. Strips must not write to the same memory.
    """
    if 0 < length <= strip:  # most calls of a solver's coarse grids, which are short
        function(*args, 0, length)
        return
    starts = iter(range(0, length, strip))  # each strip goes to the thread that takes it first

    def work() -> None:
        for start in starts:
            function(*args, start, min(start + strip, length))

    threads = thread_count()
    helpers = min(threads, -(-length // strip)) - 1
    if helpers < 1:
        work()
        return
    pool = _pool(threads - 1, getattr(_lane, 'name', ''))
    shares = [pool.submit(work) for _ in range(helpers)]
    try:
        work()
    finally:
        begun = [share for share in shares if not share.cancel()]
        wait(begun)
    for share in begun:
        share.result()
