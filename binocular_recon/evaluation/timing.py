# SPDX-License-Identifier: Apache-2.0
"""Fair timing: contestants take turns, so that a busy moment of the machine hits all of them."""

from __future__ import annotations

import math
import platform
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import cv2
import numba
import numpy as np
import scipy

from binocular_recon import __version__
from binocular_recon._jit import thread_count

# Rounds that are timed however long they take.
LEAST_ROUNDS = 3


def interleaved(
    contestants: Mapping[str, Callable[[], object]],
    repeat: int,
    warm_up: int = 1,
    limit_s: float = math.inf,
) -> dict[str, float]:
    """Return the median duration of each contestant, seconds.

    Parameters
    ----------
    contestants : mapping of name to function
        What is timed; every round calls each of them once, in this order.
    repeat : int
        Number of timed rounds.
    warm_up : int
        Number of rounds before them that are not timed.
    limit_s : float
        After this time no round is begun if there were `LEAST_ROUNDS`.

    """
    begin = time.perf_counter()
    seconds: dict[str, list[float]] = {name: [] for name in contestants}
    for turn in range(warm_up + repeat):
        if turn >= warm_up + LEAST_ROUNDS and time.perf_counter() - begin > limit_s:
            break
        for name, function in contestants.items():
            start = time.perf_counter()
            function()
            if turn >= warm_up:
                seconds[name].append(time.perf_counter() - start)
    return {name: float(np.median(values)) for name, values in seconds.items()}


def peak_bytes() -> int | None:
    """Return the largest memory this process had so far, None where the system does not tell.

    Not from getrusage: its ru_maxrss starts at the parent's peak when a child is started by vfork.
    """
    try:
        status = Path('/proc/self/status').read_text(encoding='ascii')
    except OSError:
        return None
    peaks = (line.split()[1] for line in status.splitlines() if line.startswith('VmHWM:'))
    return next((1024 * int(peak) for peak in peaks), None)


def machine_facts() -> dict[str, Any]:
    """Return what a timing depends on: processor, cores, versions."""
    return {
        'processor': _processor(),
        'cores': thread_count(),
        'opencv_threads': cv2.getNumThreads(),
        'ximgproc': hasattr(cv2, 'ximgproc'),
        'versions': {
            'binocular_recon': __version__,
            'python': platform.python_version(),
            'numpy': np.__version__,
            'scipy': scipy.__version__,
            'numba': numba.__version__,
            'opencv': cv2.__version__,
        },
    }


def _processor() -> str:
    try:
        with Path('/proc/cpuinfo').open(encoding='utf-8') as file:
            for line in file:
                if line.startswith('model name'):
                    return line.partition(':')[2].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()
