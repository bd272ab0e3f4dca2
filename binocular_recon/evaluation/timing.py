# SPDX-License-Identifier: Apache-2.0
"""Fair timing: contestants take turns, so that a busy moment of the machine hits all of them."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping

import numpy as np

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
