# SPDX-License-Identifier: Apache-2.0
"""Messages that come too late for the others, and what is said of them."""

from __future__ import annotations

import pytest

from binocular_recon.pairing import Synchronizer
from test.unit.pairing_tools import MS, Message, feed, stamps


def lagging(lag: int, count: int = 40, every: int = 1) -> list[Message]:
    """Return images, and a disparity of each ``every``-th one, ``lag`` images later."""
    messages = []
    for k in range(count):
        messages.append(Message('left', 33 * k * MS))
        if k >= lag and k % every == 0:
            messages.append(Message('disparity', 33 * (k - lag) * MS))
    return messages


@pytest.mark.parametrize('every', [1, 8])
def test_images_wait_for_their_disparities(every: int) -> None:
    synchronizer = Synchronizer(('left', 'disparity'), queue_size=10)
    messages = lagging(9, every=every)
    sets = feed(synchronizer, messages)
    assert len(sets) == sum(m.name == 'disparity' for m in messages) >= 3
    assert synchronizer.too_late() == {}


@pytest.mark.parametrize('every', [1, 8])
def test_late_messages_are_distinguished_from_stamps_that_miss(every: int) -> None:
    synchronizer = Synchronizer(('left', 'disparity'), queue_size=10)
    assert feed(synchronizer, lagging(16, every=every)) == []
    assert synchronizer.too_late() == {'disparity': 17}
    assert synchronizer.explain() is None
    sufficient = Synchronizer(('left', 'disparity'), queue_size=17)
    assert len(feed(sufficient, lagging(16, every=every))) >= 3


def test_a_leader_that_comes_too_late() -> None:
    synchronizer = Synchronizer(('disparity', 'left'), queue_size=5)
    assert feed(synchronizer, lagging(7)) == []
    assert synchronizer.too_late() == {'disparity': 8}


def test_lateness_is_forgotten_when_it_has_passed() -> None:
    synchronizer = Synchronizer(('left', 'disparity'), queue_size=5)
    feed(synchronizer, lagging(9))
    for k in range(50, 60):
        assert synchronizer.too_late() == {'disparity': 10}
        feed(synchronizer, [Message(name, 33 * k * MS) for name in ('left', 'disparity')])
    assert synchronizer.too_late() == {}


def test_nothing_comes_too_late_in_a_bag_that_loops() -> None:
    """The clock of one input goes back before that of the other."""
    synchronizer = Synchronizer(('left', 'disparity'), queue_size=5)
    for _ in range(4):
        feed(synchronizer, lagging(3, count=30))
        assert synchronizer.too_late() == {}


def test_an_input_that_is_not_expected_does_not_come_too_late() -> None:
    synchronizer = Synchronizer(('left', 'disparity'), queue_size=5)
    feed(synchronizer, lagging(9))
    synchronizer.expect('disparity', expected=False)
    assert synchronizer.too_late() == {}


def test_what_is_older_than_a_set_is_dropped() -> None:
    synchronizer = Synchronizer(('left', 'right'), queue_size=50)
    for k in range(20):
        feed(synchronizer, [Message('left', k * MS)])
    assert stamps(feed(synchronizer, [Message('right', 18 * MS)])) == [(18 * MS, 18 * MS)]
    assert synchronizer.dropped == {'left without partner': 18}
    assert feed(synchronizer, [Message('right', k * MS) for k in (19,)]) != []
