# SPDX-License-Identifier: Apache-2.0
"""A bag played over DDS: its bytes, order, timing and QoS."""

from __future__ import annotations

import functools
import signal
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import pytest
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosbags.rosbag2 import StoragePlugin, Writer
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CameraInfo, Image

from binocular_recon.io.bags.reader import Bag, TopicQos
from binocular_recon.io.bags.writer import BagWriter
from binocular_recon.nodes.play_bag import Player
from test.bag_tools import PERIOD_NS, START_NS, info_message, rig, stereo_records, write_bag
from test.system.graph import Graph, executable, wait_until

QOS = QoSProfile(depth=500, reliability=ReliabilityPolicy.RELIABLE)
TYPES = {'image_raw': Image, 'camera_info': CameraInfo}
TOPICS = [f'/{side}/{name}' for side in ('left', 'right') for name in TYPES]

# when it came, topic, bytes
Arrival = tuple[float, str, bytes]


@contextmanager
def listening(graph: Graph, *topics: str) -> Iterator[list[Arrival]]:
    """Take the serialised messages of topics."""
    arrivals: list[Arrival] = []
    subscriptions = [
        graph.node.create_subscription(
            TYPES[topic.split('/')[-1]],
            topic,
            lambda data, topic=topic: arrivals.append((time.monotonic(), topic, bytes(data))),
            QOS,
            raw=True,
        )
        for topic in topics
    ]
    yield arrivals
    for subscription in subscriptions:
        graph.node.destroy_subscription(subscription)


class Play(Protocol):
    def __call__(self, bag: Path, *options: str) -> subprocess.Popen[str]: ...


@pytest.fixture
def play() -> Iterator[Play]:
    """Start players that do not outlive the test: others of the run would hear them."""
    started = []

    def start(bag: Path, *options: str) -> subprocess.Popen[str]:
        command = [executable('play_bag'), str(bag), *options]
        started.append(
            subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        )
        return started[-1]

    yield start
    for process in started:
        process.kill()
        process.communicate()


def finish(process: subprocess.Popen[str], status: int = 0) -> str:
    """Wait for the end and return the log."""
    log, _ = process.communicate(timeout=30)
    assert process.returncode == status, log
    assert 'Traceback' not in log, log
    return log


def recorded(bag: Path, topic: str) -> list[bytes]:
    """Return a topic's messages as DDS delivers them, padded to a multiple of four bytes."""
    with Bag(bag) as opened:
        messages = [m.cdr for m in opened.messages() if m.topic.name == topic]
    return [data + bytes(-len(data) % 4) for data in messages]


def _published(graph: Graph, said: str) -> dict[str, str]:
    """Return the player's diagnostics once they say what was published."""
    status = graph.status('play_bag', 'messages')
    if status is None or not status.message.startswith(said):
        return {}
    values = {item.key: item.value for item in status.values}
    return values if int(values.get('published /left/image_raw', 0)) > 1 else {}


# Where messages must not be missed the player loops, for on a busy machine the test may know it
# only when the first of them are gone, or waits longer than it would.


@pytest.mark.parametrize('fmt', ['mcap, chunks compressed', 'sqlite3', 'ros1, lz4'])
def test_a_loop_repeats_bytes_order_and_timing_until_interrupted(
    graph: Graph, play: Play, tmp_path: Path, fmt: str
) -> None:
    bag = write_bag(tmp_path / 'bag', stereo_records(5), fmt)
    with listening(graph, *TOPICS) as arrivals:
        process = play(bag, '--loop', '--rate', '2')
        wait_until(lambda: len(arrivals) >= 4 * 20, 'four rounds')
        said = f'playing {bag} at 2 x its speed'
        values = wait_until(lambda: _published(graph, said), 'what was published')
        process.send_signal(signal.SIGINT)
        log = finish(process, 130)
    assert said in log
    assert float(values['behind the recording'].removesuffix(' s')) < 1
    assert log.rstrip().endswith('interrupted')
    for topic in TOPICS:
        sent = recorded(bag, topic)
        came = [(at, data) for at, name, data in arrivals if name == topic]
        first = [data for _, data in came].index(sent[0])
        assert [data for _, data in came[first : first + 10]] == sent * 2
        # between the rounds as within them
        gaps_s = np.diff([at for at, _ in came[first : first + 10]])
        assert np.median(gaps_s) == pytest.approx(PERIOD_NS / 1e9 / 2, abs=0.01)


def test_timing_is_that_of_the_recording(graph: Graph, play: Play, tmp_path: Path) -> None:
    rate = 2.5
    stamps_ns = START_NS + np.cumsum([0, 50, 300, 20, 20, 400, 110, 250]) * 1_000_000
    records = [('/left/camera_info', info_message(rig().left, int(s)), int(s)) for s in stamps_ns]
    bag = write_bag(tmp_path / 'bag', records)
    with listening(graph, '/left/camera_info') as arrivals:
        finish(play(bag, '--rate', str(rate), '--delay', '4'))
        wait_until(lambda: len(arrivals) == len(records), 'all messages')
    late_s = np.array([came for came, _, _ in arrivals]) - (stamps_ns - START_NS) / 1e9 / rate
    late_s -= late_s.min()
    # the machine may be busy now and then
    assert np.median(late_s) < 0.03
    assert late_s.max() < 0.3


def test_clock_is_the_time_of_recording(graph: Graph, play: Play, tmp_path: Path) -> None:
    bag = write_bag(tmp_path / 'bag', stereo_records(6))
    inbox = graph.inbox('/clock', Clock, QOS)
    finish(play(bag, '--clock', '--rate', '0.5', '--delay', '4'))
    clock_ns = [time_ns(message) for message in inbox.messages]
    assert clock_ns == sorted(clock_ns)
    stamps_ns = [stamp_ns for _, _, stamp_ns in stereo_records(6)]
    assert set(stamps_ns) <= set(clock_ns)
    assert (clock_ns[0], clock_ns[-1]) == (min(stamps_ns), max(stamps_ns))
    # 100 Hz of real time, over 1 s and, standing, before
    assert 50 <= sum(now_ns > min(stamps_ns) for now_ns in clock_ns) <= 130
    assert clock_ns.count(min(stamps_ns)) >= 10  # from when the subscriber was discovered


def test_quality_of_service_is_that_of_the_recording(
    graph: Graph, play: Play, tmp_path: Path
) -> None:
    info = info_message(rig().left, START_NS)
    with BagWriter(tmp_path / 'bag') as writer:
        writer.write('/latched/camera_info', info, START_NS, TopicQos(transient_local=True))
        writer.write('/lossy/camera_info', info, START_NS, TopicQos(reliable=False))
    process = play(tmp_path / 'bag', '--loop')
    offers = []
    for topic in ('/latched/camera_info', '/lossy/camera_info'):
        offered = functools.partial(graph.node.get_publishers_info_by_topic, topic)
        (offer,) = wait_until(offered, f'{topic} offered')
        offers.append(offer.qos_profile)
    process.send_signal(signal.SIGTERM)
    finish(process, 130)
    latched, lossy = offers
    assert latched.durability == DurabilityPolicy.TRANSIENT_LOCAL
    assert latched.reliability == ReliabilityPolicy.RELIABLE
    assert lossy.durability == DurabilityPolicy.VOLATILE
    assert lossy.reliability == ReliabilityPolicy.BEST_EFFORT


def write_with_unknown_type(path: Path, *, known: bool) -> Path:
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        odd = writer.add_connection(
            '/odd', 'odd_msgs/msg/Odd', msgdef='uint8 x\n', rihs01='RIHS01_' + '0' * 64
        )
        for stamp_ns in range(3):
            writer.write(odd, stamp_ns, b'\0\1\0\0\x07')
    if known:
        part = write_bag(path.with_name('part'), stereo_records(1))
        (part / 'part.mcap').rename(path / 'part.mcap')
        (path / 'metadata.yaml').unlink()
    return path


def test_types_that_are_not_installed_are_named_once(
    graph: Graph, play: Play, tmp_path: Path
) -> None:
    bag = write_with_unknown_type(tmp_path / 'bag', known=True)
    remaps = ['--ros-args', '-r', '/left/image_raw:=/cam/image_raw']
    with listening(graph, '/cam/image_raw', '/right/image_raw') as arrivals:
        process = play(bag, '--loop', '--rate', '1e6', *remaps)
        wait_until(lambda: len({topic for _, topic, _ in arrivals}) == 2, 'the other topics')
        process.send_signal(signal.SIGINT)
        log = finish(process, 130)
    assert log.count('/odd is left out: its type odd_msgs/msg/Odd is not installed') == 1


def test_a_bag_of_such_types_only_is_refused(play: Play, tmp_path: Path) -> None:
    log = finish(play(write_with_unknown_type(tmp_path / 'bag', known=False)), 1)
    assert 'none of its types is installed: odd_msgs/msg/Odd' in log


def test_what_precedes_the_damage_is_played(graph: Graph, play: Play, tmp_path: Path) -> None:
    bag = write_bag(tmp_path / 'bag', stereo_records(80))
    file = bag / 'bag.mcap'
    file.write_bytes(file.read_bytes()[:2_500_000])
    with listening(graph, '/left/image_raw') as arrivals:
        log = finish(play(bag, '--rate', '10', '--delay', '4'), 1)
        wait_until(lambda: len(arrivals) > 30, 'the messages before the damage')
    assert 'is damaged (it ends at byte 2500000, inside a record)' in log.splitlines()[-1]


def time_ns(message: Clock) -> int:
    return int(message.clock.sec) * 1_000_000_000 + int(message.clock.nanosec)


class FakePublisher:
    """Keeps what is published, and has its subscriber from a moment on."""

    def __init__(self, matched_at_s: float = 0.0) -> None:
        self.matched_at_s = matched_at_s
        self.messages: list[Any] = []

    def get_subscription_count(self) -> int:
        return int(time.monotonic() >= self.matched_at_s)

    def publish(self, message: Any) -> None:
        self.messages.append(message)


@contextmanager
def player(graph: Graph, folder: Path, **options: Any) -> Iterator[Any]:
    """Return a player of two camera infos whose messages are kept."""
    records = [record for record in stereo_records(1) if 'info' in record[0]]
    with Bag(write_bag(folder / 'bag', records)) as bag:
        made: Any = Player(graph.node, bag, **options)
        made._clock, made._diagnostics = FakePublisher(), FakePublisher()
        made._publishers = {topic: FakePublisher() for topic in bag.topics}
        yield made


@pytest.mark.parametrize(
    ('matched_after_s', 'starts_after_s'),
    [((0.0, 0.0), 0.5), ((0.1, 0.4), 0.9), ((0.0, 9.0), 2.0)],
)
def test_playing_starts_when_subscribers_have_matched_or_after_two_seconds(
    graph: Graph, tmp_path: Path, matched_after_s: tuple[float, float], starts_after_s: float
) -> None:
    with player(graph, tmp_path, clock=True) as waiting:
        start_s = time.monotonic()
        for publisher, after_s in zip(waiting._publishers.values(), matched_after_s, strict=True):
            publisher.matched_at_s = start_s + after_s
        waiting.wait_for_subscribers()
        assert time.monotonic() - start_s == pytest.approx(starts_after_s, abs=0.15)
    clock_ns = [time_ns(message) for message in waiting._clock.messages]
    assert set(clock_ns) == {START_NS} and len(clock_ns) >= 40 * starts_after_s
    assert len(waiting._diagnostics.messages) >= max(1, int(starts_after_s))


def test_time_and_diagnostics_go_on_between_two_rounds(graph: Graph, tmp_path: Path) -> None:
    """A recording without a length pauses for one second."""
    with player(graph, tmp_path, clock=True, rate=2.0) as playing:
        playing.play_once()
        for publisher in (playing._clock, playing._diagnostics):
            publisher.messages.clear()
        playing._next_report_s = 0.0
        playing.pause()
    clock_ns = [time_ns(message) for message in playing._clock.messages]
    assert clock_ns == sorted(clock_ns) and len(clock_ns) >= 40
    assert clock_ns[0] == pytest.approx(START_NS, abs=100_000_000)
    assert clock_ns[-1] == START_NS + 2_000_000_000
    (status,) = playing._diagnostics.messages[0].status
    values = {item.key: item.value for item in status.values}
    assert values['behind the recording'] == '0.000 s'
