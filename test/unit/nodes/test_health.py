# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from collections import Counter
from typing import Any

import pytest

pytestmark = pytest.mark.ros


class Log:
    def __init__(self) -> None:
        self.errors: list[str] = []
        self.warnings: list[str] = []
        self.error, self.warning = self.errors.append, self.warnings.append


class Clock:
    now = 100.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def log() -> Log:
    return Log()


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def health(log: Log, clock: Clock) -> Any:
    from binocular_recon.nodes.runtime.health import Health

    return Health(log, clock)


def status(health: Any, level: bytes = b'\x00') -> Any:
    return health.status('node: frames', 'rig', level, 'fine', dropped=Counter({'late': 2}))


def test_counts_and_facts(health: Any) -> None:
    for topic in ('left', 'left', 'right'):
        health.received(topic)
    health.published('disparity')
    health.dropped('bad input')
    health.dropped('bad input', 4)
    for seconds in (0.010, 0.030, 0.020):
        health.processed(seconds)
    health.state('calibration', 'f 994 px')
    made = status(health)
    assert {item.key: item.value for item in made.values} == {
        'received left': '2',
        'received right': '1',
        'published disparity': '1',
        'dropped: bad input': '5',
        'dropped: late': '2',
        'processing time': '20.0 ms',
        'longest processing time': '30.0 ms',
        'calibration': 'f 994 px',
        'last error': '',
    }
    assert (made.level, made.message) == (b'\x00', 'fine')


def test_a_problem_stays_in_the_status_for_a_while(health: Any, clock: Clock) -> None:
    health.warning('dark')
    assert (status(health).level, status(health).message) == (b'\x01', 'dark')
    health.error('broken 1')
    assert (status(health).level, status(health).message) == (b'\x02', 'broken 1')
    assert status(health, b'\x03').message == 'fine'  # stale: older problems do not matter
    clock.now += 3.1
    made = status(health)
    assert (made.level, made.message) == (b'\x00', 'fine')
    assert made.values[-1].value == 'broken 1'


def test_the_same_problem_is_logged_every_five_seconds(
    health: Any, clock: Clock, log: Log
) -> None:
    for size in range(4):
        health.error(f'image holds {size}.5 bytes')
    health.error('another one')
    assert log.errors == ['image holds 0.5 bytes', 'another one']
    clock.now += 5.1
    health.error('image holds 9 bytes')
    assert log.errors[2] == 'image holds 9 bytes (3 more since this was last logged)'
    for kind in range(300):  # no memory without end
        health.warning('x' * kind)
    assert len(log.warnings) == 300 and len(health._logged) <= 100


def test_silence_is_measured_against_the_interval(health: Any, clock: Clock) -> None:
    health.expect(['left', 'right'])
    clock.now += 2.9
    assert health.silent() == {}
    health.received('left')
    clock.now += 0.2
    assert health.silent() == {'right': pytest.approx(3.1)}
    # a camera that takes an image every 4 s is not silent after 3 s
    clock.now += 3.8
    health.received('left')
    clock.now += 11.9
    assert 'left' not in health.silent()
    clock.now += 0.2
    assert 'left' in health.silent()
    health.expect(['left'])
    assert health.silent() == {}


def test_a_loss_in_transport_is_counted_explained_and_forgotten(
    health: Any, log: Log, clock: Clock
) -> None:
    assert health.loss() == ''
    for _ in range(7):
        health.received('left/image_raw')
    health.lost('left/image_raw', 12)
    text = health.loss()
    assert text.startswith('messages are lost in transport: 12 of 19 on left/image_raw; start the')
    assert 'config/fastdds_shared_memory.xml' in text
    assert 'FASTDDS_DEFAULT_PROFILES_FILE' in text and 'compressed' in text
    made = status(health)
    assert made.level == made.WARN and made.message == text
    assert 'dropped: left/image_raw lost in transport' in {item.key for item in made.values}
    health.lost('right/image_raw', 1)
    assert '12 of 19 on left/image_raw, 1 of 1 on right/image_raw;' in health.loss()
    for _ in range(20):
        clock.now += 0.1
        health.lost('left/image_raw', 1)
    assert len(log.warnings) <= 3, 'throttled'
    clock.now += 11
    assert health.loss() == ''


def test_messages_that_stop_are_noticed_before_they_count_as_silent(
    health: Any, clock: Clock
) -> None:
    health.expect(['left', 'right', 'sets'])
    for _ in range(3):
        clock.now += 0.1
        health.received('left')
        health.received('right')
        health.received('sets')
    clock.now += 0.9
    health.received('right')
    assert health.pausing(['left', 'right']) == {}
    clock.now += 0.2
    assert health.pausing(['left', 'right']) == {'left': pytest.approx(1.1)}
    assert health.silent() == {}


def test_control_characters_reach_neither_log_nor_status(health: Any, log: Log) -> None:
    health.error('image /a\x1b[2J is damaged')
    health.state('calibration', 'b\x07')
    assert log.errors == [r'image /a\x1b[2J is damaged']
    made = status(health)
    assert made.message == r'image /a\x1b[2J is damaged'
    assert not any('\x1b' in value.value or '\x07' in value.value for value in made.values)
