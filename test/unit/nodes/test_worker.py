# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import threading

from binocular_recon.nodes.runtime.worker import LatestWorker, NextWorker


def unexpected(error: Exception) -> None:
    raise AssertionError from error


def test_the_newest_job_is_done_next_and_no_other_waits() -> None:
    begun, go, last = threading.Event(), threading.Event(), threading.Event()
    done = []

    def work(job: int) -> None:
        begun.set()
        assert go.wait(5)
        done.append(job)
        if job == 3:
            last.set()

    worker = LatestWorker(work, unexpected)
    assert worker.submit(0) is False
    assert begun.wait(5)  # 0 is being done
    assert [worker.submit(job) for job in (1, 2, 3)] == [False, True, True]
    go.set()
    assert last.wait(5)
    worker.close(5)
    assert done == [0, 3]


def test_close_lets_the_current_job_finish_and_starts_no_other() -> None:
    begun, go, done = threading.Event(), threading.Event(), []

    def work(job: int) -> None:
        begun.set()
        assert go.wait(5)
        done.append(job)

    worker = LatestWorker(work, unexpected)
    worker.submit(0)
    assert begun.wait(5)
    worker.submit(1)
    closing = threading.Thread(target=worker.close, args=[5])
    closing.start()
    with worker._changed:
        assert worker._changed.wait_for(lambda: worker._closed, 5)
    go.set()
    closing.join()
    assert done == [0]


def test_jobs_are_done_one_at_a_time_and_in_order() -> None:
    active, done, finished = [0], [], threading.Event()

    def work(job: int) -> None:
        active[0] += 1
        assert active[0] == 1
        done.append(job)
        active[0] -= 1
        if job == 199:
            finished.set()

    worker = LatestWorker(work, unexpected)
    replaced = sum(worker.submit(job) for job in range(200))
    assert finished.wait(5)
    worker.close(5)
    assert done == sorted(done) and len(done) == 200 - replaced


def test_the_next_job_is_done_after_one_that_failed() -> None:
    failures: list[Exception] = []
    failed, done = threading.Event(), threading.Event()

    def work(job: int) -> None:
        1 / job
        done.set()

    def note(error: Exception) -> None:
        failures.append(error)
        failed.set()

    worker = LatestWorker(work, note)
    worker.submit(0)
    assert failed.wait(5)
    worker.submit(1)
    assert done.wait(5)
    worker.close(5)
    assert [type(error) for error in failures] == [ZeroDivisionError]


def test_who_hands_in_the_next_job_waits_until_it_is_begun_and_none_is_lost() -> None:
    begun, go, done = threading.Event(), threading.Event(), []

    def work(job: int) -> None:
        begun.set()
        assert go.wait(5)
        done.append(job)

    worker = NextWorker(work, unexpected)
    assert worker.submit(0) is False  # it is begun
    assert begun.wait(5)
    handing_in = threading.Thread(target=worker.submit, args=[1])
    handing_in.start()
    with worker._changed:
        assert worker._waiting in ([], [1])
    handing_in.join(0.05)
    assert handing_in.is_alive() and not done
    go.set()
    handing_in.join(5)
    worker.submit(2)
    worker.close(5)
    assert done == [0, 1, 2]


def test_nobody_waits_for_a_thread_that_has_ended() -> None:
    worker: NextWorker[int] = NextWorker(lambda _job: None, unexpected)
    worker.close(5)
    assert worker.submit(0) is False
