# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import random
import threading
from typing import Any

import pytest

from binocular_recon.pairing import Synchronizer
from test.unit.pairing_tools import MS, NAMES, Message, feed, interleaved, stamps


@pytest.mark.parametrize('count', [2, 3, 4])
@pytest.mark.parametrize('seed', range(5))
def test_exact_sets_are_complete_in_order_and_once(seed: int, count: int) -> None:
    names = NAMES[:count]
    streams = [[Message(name, 33 * MS * k) for k in range(40)] for name in names]
    messages = interleaved(streams, random.Random(seed))
    sets = feed(Synchronizer(names, queue_size=40), messages)
    assert stamps(sets) == [(33 * MS * k,) * count for k in range(40)]
    assert all([m.name for m in found] == list(names) for found in sets)


@pytest.mark.parametrize('seed', range(5))
def test_exact_sets_despite_losses(seed: int) -> None:
    generator = random.Random(seed)
    kept = [{k for k in range(60) if generator.random() > 0.3} for _ in NAMES]
    messages = [
        Message(name, 33 * MS * k)
        for k in range(60)
        for name, own in zip(NAMES, kept, strict=True)
        if k in own
    ]
    synchronizer = Synchronizer(NAMES, queue_size=5)
    sets = feed(synchronizer, messages)
    complete = sorted(set.intersection(*kept))
    assert stamps(sets) == [(33 * MS * k,) * 4 for k in complete]
    lost = len(messages) - 4 * len(complete)
    assert lost - 4 * 5 <= sum(synchronizer.dropped.values()) <= lost


def test_waiting_messages_are_bounded() -> None:
    synchronizer = Synchronizer(('left', 'right'), queue_size=3)
    assert feed(synchronizer, [Message('left', k * MS) for k in range(10)]) == []
    assert synchronizer.dropped == {'left without partner': 7}
    sets = feed(synchronizer, [Message('right', k * MS) for k in range(10)])
    assert stamps(sets) == [(k * MS, k * MS) for k in (7, 8, 9)]


def test_looping_bag_whose_end_is_incomplete() -> None:
    """30 pairs a loop, the last 5 right ones missing: Python's message_filters gets 25, 0, 0."""
    synchronizer = Synchronizer(('left', 'right'), queue_size=5)
    found = []
    for run in range(3):
        messages = [
            Message(name, k * 33 * MS, run)
            for k in range(30)
            for name in ('left', 'right')
            if name == 'left' or k < 25
        ]
        found.append(feed(synchronizer, messages))
    assert [len(sets) for sets in found] == [25, 25, 25]
    assert all(left.run == right.run for sets in found for left, right in sets)


@pytest.mark.parametrize('tolerance_ns', [0, 5 * MS])
@pytest.mark.parametrize('seed', range(8))
def test_a_clock_that_goes_back_never_mixes_runs(seed: int, tolerance_ns: int) -> None:
    generator = random.Random(seed)
    arrivals: list[tuple[float, Message]] = []
    for name in NAMES[:3]:
        arrival = 0.0
        for run in range(4):
            for k in range(20):
                # up to 80 ms late, in the order of the topic
                arrival = max(arrival, 33 * (20 * run + k) + generator.uniform(0, 80))
                if generator.random() > 0.1:
                    arrivals.append((arrival, Message(name, k * 33 * MS, run)))
    arrivals.sort(key=lambda item: item[0])
    synchronizer = Synchronizer(NAMES[:3], queue_size=6, tolerance_ns=tolerance_ns)
    sets = feed(synchronizer, [message for _, message in arrivals])
    assert all(len({m.run for m in found}) == 1 for found in sets)
    assert all(len({m.stamp_ns for m in found}) == 1 for found in sets)
    for run in range(4):  # most of every run is found
        assert sum(found[0].run == run for found in sets) >= 8


def test_stale_message_of_a_silent_camera_is_not_used_after_a_jump() -> None:
    synchronizer = Synchronizer(('left', 'right'), queue_size=5)
    feed(synchronizer, [Message('right', 5 * MS), Message('left', 9 * MS)])
    assert feed(synchronizer, [Message('left', k * MS, run=1) for k in range(8)]) == []


def test_an_input_that_never_shows_the_jump_pairs_again() -> None:
    synchronizer = Synchronizer(('left', 'right'), queue_size=4)
    feed(synchronizer, [Message('right', 1 * MS), Message('left', 90 * MS)])
    messages = [Message(name, k * MS) for k in range(2, 20) for name in ('left', 'right')]
    sets = feed(synchronizer, messages)
    assert stamps(sets)[-1] == (19 * MS, 19 * MS) and len(sets) >= 13
    assert synchronizer.dropped['clock went back'] == 1
    assert 'went back by' in synchronizer.went_back()
    assert synchronizer.went_back() == '', 'it is said once'


def test_approximate_set_is_found_without_waiting_for_the_next_frame() -> None:
    synchronizer = Synchronizer(('left', 'right'), queue_size=5, tolerance_ns=5 * MS)
    for k in range(10):
        early = feed(synchronizer, [Message('right', (33 * k - 2) * MS)])
        sets = feed(synchronizer, [Message('left', 33 * k * MS)])
        if k > 1:  # the first two frames show the period
            assert early == [] and stamps(sets) == [(33 * k * MS, (33 * k - 2) * MS)]


@pytest.mark.parametrize('tolerance_ns', [12 * MS, None])
@pytest.mark.parametrize('seed', range(8))
def test_approximate_sets_are_the_nearest(seed: int, tolerance_ns: int | None) -> None:
    generator = random.Random(seed)
    times = {
        name: [round((33 * k + generator.uniform(-5, 5)) * MS) for k in range(60)]
        for name in ('left', 'right')
    }
    times['right'] = [t for t in times['right'] if generator.random() > 0.2]
    messages = [Message(name, t) for name in times for t in times[name]]
    # arrive in the order of their stamps, up to 15 ms later
    messages.sort(key=lambda m: m.stamp_ns + generator.uniform(0, 15) * MS)
    sets = feed(
        Synchronizer(('left', 'right'), queue_size=10, tolerance_ns=tolerance_ns), messages
    )
    expected = []
    for left in times['left']:
        right = min(times['right'], key=lambda t: abs(t - left))
        back = min(times['left'], key=lambda t: abs(t - right))
        if back == left and abs(right - left) <= (tolerance_ns or 33 * MS):
            expected.append((left, right))
    found = stamps(sets)
    assert set(found) <= set(expected)
    assert len(found) >= len(expected) - 2  # the last may still wait, the first show the period
    assert len({right for _, right in found}) == len(found)


def test_approximate_sets_of_different_rates() -> None:
    messages = [Message('left', k * 16 * MS) for k in range(60)]
    messages += [Message('right', (k * 32 + 3) * MS) for k in range(30)]
    messages.sort(key=lambda m: m.stamp_ns)
    synchronizer = Synchronizer(('left', 'right'), queue_size=5, tolerance_ns=None)
    sets = stamps(feed(synchronizer, messages))
    assert len(sets) >= 28
    assert all(right is not None and left == right - 3 * MS for left, right in sets)


def test_spread_of_a_set_is_within_the_tolerance() -> None:
    synchronizer = Synchronizer(NAMES[:3], queue_size=5, tolerance_ns=5 * MS)
    messages = [
        Message(name, (33 * k + shift) * MS)
        for k in range(5)
        for name, shift in zip(NAMES, (0, -4, 4), strict=False)
    ]
    assert feed(synchronizer, messages) == []


def test_by_how_much_stamps_miss() -> None:
    synchronizer = Synchronizer(('left', 'right', 'confidence'), queue_size=5)
    synchronizer.expect('confidence', expected=False)
    for k in range(20):
        late = 3_200_000 + 7 * k
        messages = [Message('left', 33 * k * MS), Message('right', 33 * k * MS + late)]
        assert feed(synchronizer, messages) == []
    text = 'stamps never match those of left: right is 3.200 ms later (nearest recent ones)'
    assert synchronizer.explain() == (text, 0.003201, None, 0.0)


def test_by_how_much_stamps_miss_a_tolerance() -> None:
    synchronizer = Synchronizer(('left', 'right'), queue_size=5, tolerance_ns=MS)
    for k in range(9):
        messages = [Message('right', (33 * k - 4) * MS), Message('left', 33 * k * MS)]
        assert feed(synchronizer, messages) == []
    found = synchronizer.explain()
    assert found is not None and 'right is 4.000 ms earlier' in found.text
    assert found.tolerance_s == 0.004


def test_nothing_misses_in_incomplete_sets_whose_stamps_agree() -> None:
    synchronizer = Synchronizer(NAMES[:3], queue_size=5)
    for k in range(9):
        feed(synchronizer, [Message(NAMES[i], k * MS) for i in range(3) if i != 1 + k % 2])
    assert synchronizer.explain() is None


def test_the_last_approximate_sets_come_at_the_end() -> None:
    synchronizer = Synchronizer(('left', 'right'), queue_size=5, tolerance_ns=5 * MS)
    assert feed(synchronizer, [Message('left', 9 * MS), Message('right', 7 * MS)]) == []
    assert stamps(synchronizer.finish()) == [(9 * MS, 7 * MS)]
    assert synchronizer.finish() == []


def test_optional_input() -> None:
    synchronizer = Synchronizer(('left', 'confidence'), queue_size=5)
    synchronizer.expect('confidence', expected=False)
    assert stamps(feed(synchronizer, [Message('left', 1)])) == [(1, None)]
    assert stamps(feed(synchronizer, [Message('confidence', 2), Message('left', 2)])) == [(2, 2)]
    synchronizer.expect('confidence', expected=True)
    assert stamps(feed(synchronizer, [Message('left', 3)])) == []
    assert stamps(feed(synchronizer, [Message('confidence', 3)])) == [(3, 3)]


def test_clear_forgets_what_waits() -> None:
    synchronizer = Synchronizer(('left', 'right'), queue_size=5)
    feed(synchronizer, [Message('left', 8 * MS)])
    synchronizer.clear()
    assert feed(synchronizer, [Message('right', 8 * MS), Message('right', 9 * MS)]) == []
    assert stamps(feed(synchronizer, [Message('left', 9 * MS)])) == [(9 * MS, 9 * MS)]


def test_threads_share_a_synchronizer() -> None:
    synchronizer = Synchronizer(NAMES, queue_size=100)
    found: list[tuple[Any, ...]] = []
    lock = threading.Lock()

    def send(name: str) -> None:
        for k in range(100):
            sets = synchronizer.add(name, k * MS, Message(name, k * MS))
            with lock:
                found.extend(sets)

    threads = [threading.Thread(target=send, args=(name,)) for name in NAMES]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(stamps(found)) == [(k * MS,) * 4 for k in range(100)]
