# SPDX-License-Identifier: Apache-2.0
"""A bag played over DDS: its bytes, order and QoS; `unit/nodes/test_player.py` has its timing."""

from __future__ import annotations

import functools
import signal
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Protocol

import pytest
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosbags.rosbag2 import StoragePlugin, Writer
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CameraInfo, Image

from binocular_recon.io.bags.reader import Bag, TopicQos
from binocular_recon.io.bags.writer import BagWriter
from test.bag_tools import START_NS, info_message, rig, stereo_records, write_bag
from test.system.graph import Graph, executable, wait_until

pytestmark = pytest.mark.long

QOS = QoSProfile(depth=500, reliability=ReliabilityPolicy.RELIABLE)
TYPES = {'image_raw': Image, 'camera_info': CameraInfo}
TOPICS = [f'/{side}/{name}' for side in ('left', 'right') for name in TYPES]

# topic, bytes
Arrival = tuple[str, bytes]


@contextmanager
def listening(graph: Graph, *topics: str) -> Iterator[list[Arrival]]:
    """Take the serialised messages of topics."""
    arrivals: list[Arrival] = []
    subscriptions = [
        graph.node.create_subscription(
            TYPES[topic.split('/')[-1]],
            topic,
            lambda data, topic=topic: arrivals.append((topic, bytes(data))),
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


def _is_reported(graph: Graph, summary: str) -> bool:
    """Tell whether the player's diagnostics have come and say what was published."""
    status = graph.status('play_bag', 'messages')
    if status is None or not status.message.startswith(summary):
        return False
    values = {item.key: item.value for item in status.values}
    return int(values.get('published /left/image_raw', 0)) > 1 and 'behind the recording' in values


# Where no message may be missed, the player loops or waits longer than it would by itself: on a
# busy machine the test may discover it only after the first messages.


@pytest.mark.parametrize('fmt', ['mcap, chunks compressed', 'sqlite3', 'ros1, lz4'])
def test_a_loop_repeats_bytes_and_order_until_interrupted(
    graph: Graph, play: Play, tmp_path: Path, fmt: str
) -> None:
    bag = write_bag(tmp_path / 'bag', stereo_records(5), fmt)
    with listening(graph, *TOPICS) as arrivals:
        process = play(bag, '--loop', '--rate', '2')
        wait_until(lambda: len(arrivals) >= 4 * 20, 'four rounds')
        summary = f'playing {bag} at 2 x the recorded speed'
        wait_until(lambda: _is_reported(graph, summary), 'diagnostics')
        process.send_signal(signal.SIGINT)
        log = finish(process, 130)
    assert summary in log
    assert log.rstrip().endswith('interrupted')
    for topic in TOPICS:
        sent = recorded(bag, topic)
        came = [data for name, data in arrivals if name == topic]
        first = came.index(sent[0])
        assert came[first : first + 10] == sent * 2


def test_clock_is_the_time_of_recording(graph: Graph, play: Play, tmp_path: Path) -> None:
    bag = write_bag(tmp_path / 'bag', stereo_records(6))
    inbox = graph.inbox('/clock', Clock, QOS)
    stamps_ns = [stamp_ns for _, _, stamp_ns in stereo_records(6)]
    finish(play(bag, '--clock', '--rate', '0.5', '--delay', '4'))
    wait_until(lambda: time_ns(inbox.messages[-1]) == max(stamps_ns), 'the end of the recording')
    clock_ns = [time_ns(message) for message in inbox.messages]
    assert clock_ns == sorted(clock_ns)
    assert clock_ns[0] == min(stamps_ns)
    assert clock_ns.count(min(stamps_ns)) > 1  # it stands until the first message
    assert set(clock_ns) - set(stamps_ns)  # it goes on between messages


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
    finish(process, 143)
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
        wait_until(lambda: len({topic for topic, _ in arrivals}) == 2, 'the other topics')
        process.send_signal(signal.SIGINT)
        log = finish(process, 130)
    assert log.count('/odd is skipped: its type odd_msgs/msg/Odd is not installed') == 1


def test_a_bag_of_such_types_only_is_rejected(play: Play, tmp_path: Path) -> None:
    log = finish(play(write_with_unknown_type(tmp_path / 'bag', known=False)), 1)
    assert 'none of its message types is installed: odd_msgs/msg/Odd; install' in log


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
