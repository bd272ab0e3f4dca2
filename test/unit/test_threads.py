# SPDX-License-Identifier: Apache-2.0
"""Strips that the threads of kernels share, which survive a fork."""

from __future__ import annotations

import multiprocessing
import os
import threading
from collections import Counter

import numpy as np
import pytest

from binocular_recon import _jit

TIMEOUT_S = 60.0


@pytest.fixture(autouse=True, params=[1, 2, 5])
def threads(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> int:
    count: int = request.param
    monkeypatch.setattr(_jit, 'thread_count', lambda: count)
    return count


@pytest.mark.parametrize('length', [0, 1, 64, 65, 1000])
def test_every_strip_is_done_once(length: int) -> None:
    done: Counter[tuple[int, int]] = Counter()
    _jit.over_strips(lambda start, stop: done.update([(start, stop)]), length)
    bounds = [(start, min(start + 64, length)) for start in range(0, length, 64)]
    assert done == Counter(bounds)


@pytest.mark.parametrize('bad', [0, 3, 9])
def test_an_error_is_raised_when_no_strip_runs_any_more(bad: int) -> None:
    running: set[int] = set()

    def work(start: int, _stop: int) -> None:
        running.add(start)
        try:
            if start == bad:
                raise ValueError(f'strip {start}')
        finally:
            running.remove(start)

    with pytest.raises(ValueError, match=f'strip {bad}'):
        _jit.over_strips(work, 10, strip=1)
    assert not running


def test_a_call_does_not_wait_for_the_strips_of_another() -> None:
    begun, end = threading.Event(), threading.Event()
    found: list[int] = []

    def hold(_start: int, _stop: int) -> None:
        begun.set()
        assert end.wait(TIMEOUT_S)

    other = threading.Thread(target=_jit.over_strips, args=(hold, 10), kwargs={'strip': 1})
    other.start()
    assert begun.wait(TIMEOUT_S)
    _jit.over_strips(lambda start, _stop: found.append(start), 10, strip=1)
    assert sorted(found) == list(range(10))
    assert other.is_alive() and not end.is_set()
    end.set()
    other.join(TIMEOUT_S)
    assert not other.is_alive()


def double(values: np.ndarray, start: int, stop: int) -> None:
    """Double a part of an array."""
    values[start:stop] *= 2


def run(answers: multiprocessing.SimpleQueue[float]) -> None:
    """Use the pool of threads and tell the sum."""
    values = np.ones(8)
    _jit.over_strips(double, 8, values, strip=2)
    answers.put(float(values.sum()))


@pytest.mark.skipif(not hasattr(os, 'fork'), reason='this system has no fork')
def test_a_forked_process_has_its_own_threads() -> None:
    fork = multiprocessing.get_context('fork')
    answers = fork.SimpleQueue()
    run(answers)
    process = fork.Process(target=run, args=(answers,))
    process.start()
    process.join(10)
    alive = process.is_alive()
    process.kill()
    assert not alive
    assert [answers.get(), answers.get()] == [16, 16]
