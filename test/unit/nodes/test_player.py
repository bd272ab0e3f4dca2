# SPDX-License-Identifier: Apache-2.0
"""When a bag's messages are published, by a timer of the test's own: no second passes."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from binocular_recon.io.bags.reader import Bag
from test.bag_tools import PERIOD_NS, START_NS, info_message, rig, stereo_records, write_bag

pytestmark = pytest.mark.ros


class FakeTimer:
    """A clock that only `sleep` advances."""

    def __init__(self) -> None:
        self.now_s = 0.0

    def monotonic(self) -> float:
        return self.now_s

    def sleep(self, seconds: float) -> None:
        assert seconds > 0
        self.now_s += seconds


class FakePublisher:
    """Keeps what is published and when; it has its subscriber from a moment on."""

    def __init__(self, timer: FakeTimer) -> None:
        self._timer = timer
        self.matched_at_s = 0.0
        self.sent: list[tuple[float, Any]] = []
        self.acknowledged = 0

    def get_subscription_count(self) -> int:
        return int(self._timer.now_s >= self.matched_at_s)

    def publish(self, message: Any) -> None:
        self.sent.append((self._timer.now_s, message))

    def wait_for_all_acked(self, _timeout: Any) -> None:
        self.acknowledged = len(self.sent)

    @property
    def times_s(self) -> list[float]:
        return [time_s for time_s, _ in self.sent]


class FakeNode:
    """As much of a node as a player uses."""

    def __init__(self) -> None:
        self.timer = FakeTimer()
        self.publishers: dict[str, FakePublisher] = {}

    def create_publisher(self, _kind: Any, topic: str, _qos: Any) -> FakePublisher:
        return self.publishers.setdefault(topic, FakePublisher(self.timer))

    def count_subscribers(self, _topic: str) -> int:
        return 1

    def get_logger(self) -> Any:
        return SimpleNamespace()

    def get_fully_qualified_name(self) -> str:
        return '/play_bag'

    def get_clock(self) -> Any:
        from builtin_interfaces.msg import Time

        return SimpleNamespace(now=lambda: SimpleNamespace(to_msg=Time))


@pytest.fixture
def node() -> FakeNode:
    return FakeNode()


@pytest.fixture
def infos(tmp_path: Path) -> Iterator[Bag]:
    """Return a bag of one camera info of each side, with one stamp."""
    records = [record for record in stereo_records(1) if 'info' in record[0]]
    with Bag(write_bag(tmp_path / 'bag', records)) as bag:
        yield bag


def player(node: FakeNode, bag: Bag, **options: Any) -> Any:
    from binocular_recon.nodes.player import Player

    fake: Any = node
    return Player(fake, bag, timer=node.timer, **options)


def clock_ns(node: FakeNode) -> list[int]:
    """Return the times of the recording that were published on /clock."""
    stamps = [message.clock for _, message in node.publishers['/clock'].sent]
    return [stamp.sec * 1_000_000_000 + stamp.nanosec for stamp in stamps]


def statuses(node: FakeNode) -> list[dict[str, str]]:
    """Return the values of the statuses that were published."""
    sent = [message.status[0] for _, message in node.publishers['/diagnostics'].sent]
    return [{item.key: item.value for item in status.values} for status in sent]


@pytest.mark.parametrize('clock', [True, False])
def test_messages_are_published_when_they_are_due(
    node: FakeNode, tmp_path: Path, clock: bool
) -> None:
    rate, after_ms = 2.5, [0, 50, 350, 370, 390, 790, 900, 1150]
    stamps_ns = [START_NS + ms * 1_000_000 for ms in after_ms]
    records = [('/left/camera_info', info_message(rig().left, at), at) for at in stamps_ns]
    with Bag(write_bag(tmp_path / 'bag', records)) as bag:
        player(node, bag, rate=rate, clock=clock).play_once()
    times_s = node.publishers['/left/camera_info'].times_s
    assert times_s == pytest.approx([ms / 1000 / rate for ms in after_ms], abs=1e-6)


def test_the_last_messages_and_the_last_time_are_delivered(node: FakeNode, infos: Bag) -> None:
    playing = player(node, infos, clock=True)
    playing.play_once()
    playing.wait_for_delivery()
    for topic in ('/left/camera_info', '/right/camera_info', '/clock'):
        assert node.publishers[topic].acknowledged == len(node.publishers[topic].sent) > 0


def test_late_messages_are_published_at_once_and_the_delay_reported(
    node: FakeNode, tmp_path: Path
) -> None:
    records = [record for record in stereo_records(5) if record[0] == '/left/camera_info']
    with Bag(write_bag(tmp_path / 'bag', records)) as bag:
        playing = player(node, bag)
        sender = node.publishers['/left/camera_info']

        def publish(message: Any) -> None:
            if not sender.sent:
                node.timer.now_s += 1.25  # the machine is busy during the first one
            sender.sent.append((node.timer.now_s, message))

        sender.publish = publish  # type: ignore[method-assign]
        playing.play_once()
    assert sender.times_s == [1.25] * 5
    assert [status['behind the recording'] for status in statuses(node)] == ['1.250 s']


@pytest.mark.parametrize(
    ('matched_at_s', 'starts_at_s'),
    [((0.0, 0.0), 0.5), ((0.1, 0.4), 0.9), ((0.0, 9.0), 2.0)],
    ids=['at once', 'when all have matched', 'after two seconds'],
)
def test_playing_starts_when_subscribers_have_matched(
    node: FakeNode, infos: Bag, matched_at_s: tuple[float, float], starts_at_s: float
) -> None:
    waiting = player(node, infos, clock=True)
    for side, at_s in zip(('left', 'right'), matched_at_s, strict=True):
        node.publishers[f'/{side}/camera_info'].matched_at_s = at_s
    waiting.wait_for_subscribers()
    assert node.timer.now_s == pytest.approx(starts_at_s, abs=0.011)  # it looks every 0.01 s
    # meanwhile the clock stands
    assert set(clock_ns(node)) == {START_NS}
    assert len(clock_ns(node)) == pytest.approx(100 * starts_at_s, abs=2)


def test_a_delay_is_the_least_time_before_the_first_message(node: FakeNode, infos: Bag) -> None:
    player(node, infos).wait_for_subscribers(4.0)
    assert node.timer.now_s == pytest.approx(4.0)
    assert node.publishers['/diagnostics'].times_s == pytest.approx([0, 1, 2, 3], abs=0.02)


def test_rounds_follow_each_other_as_messages_do(node: FakeNode, tmp_path: Path) -> None:
    with Bag(write_bag(tmp_path / 'bag', stereo_records(5))) as bag:
        playing = player(node, bag, rate=2.0)
        for _ in range(2):
            playing.play_once()
            playing.pause()
    times_s = node.publishers['/left/image_raw'].times_s
    period_s = PERIOD_NS / 1e9 / 2
    assert times_s == pytest.approx([period_s * k for k in range(10)], abs=1e-6)


def test_the_clock_goes_on_between_two_rounds(node: FakeNode, infos: Bag) -> None:
    """A recording without a length pauses for one second."""
    playing = player(node, infos, clock=True, rate=2.0)
    playing.play_once()
    played = len(clock_ns(node))
    playing.pause()
    during_ns = clock_ns(node)[played:]
    assert during_ns == sorted(during_ns)
    assert len(during_ns) == pytest.approx(101, abs=2)  # 100 Hz
    assert (during_ns[0], during_ns[-1]) == (START_NS, START_NS + 2_000_000_000)


def test_the_clock_has_the_time_of_every_message_and_100_hz_of_real_time(
    node: FakeNode, tmp_path: Path
) -> None:
    with Bag(write_bag(tmp_path / 'bag', stereo_records(6))) as bag:
        player(node, bag, clock=True, rate=0.5).play_once()
    steps_s = [
        later - earlier
        for earlier, later in zip(
            node.publishers['/clock'].times_s, node.publishers['/clock'].times_s[1:], strict=False
        )
    ]
    assert max(steps_s) == pytest.approx(0.01)
    assert {stamp_ns for _, _, stamp_ns in stereo_records(6)} <= set(clock_ns(node))
    assert node.timer.now_s == pytest.approx(1.0, abs=0.01)


def test_diagnostics_come_once_a_second(node: FakeNode, tmp_path: Path) -> None:
    with Bag(write_bag(tmp_path / 'bag', stereo_records(50))) as bag:
        player(node, bag).play_once()
    assert node.publishers['/diagnostics'].times_s == pytest.approx([0, 1, 2, 3, 4], abs=0.1)
    assert {status['behind the recording'] for status in statuses(node)} == {'0.000 s'}
    assert (
        statuses(node)[-1]['published /left/image_raw'] == '40'
    )  # that of the fourth second follows


def test_no_code_in_the_current_folder_is_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A bag may name any package, and lie beside one of that name."""
    from binocular_recon.nodes.player import _message_type

    for package in ('evil_pkg', 'sensor_msgs', 'shape_msgs'):
        folder = tmp_path / package
        folder.mkdir()
        (folder / '__init__.py').write_text(f"open('{tmp_path}/ran', 'w')")
        (folder / 'msg.py').write_text('class Image: get_fields_and_field_types = None')
    monkeypatch.chdir(tmp_path)
    for first in ('', str(tmp_path), '.'):
        monkeypatch.syspath_prepend(first)
        assert _message_type('evil_pkg/msg/Image') is None
        assert _message_type('shape_msgs/msg/Image') is None
        found = _message_type('sensor_msgs/msg/Image')
        assert found is not None and found.__module__ == 'sensor_msgs.msg._image'
    assert not (tmp_path / 'ran').exists()


@pytest.mark.parametrize(
    'name',
    ['os/msg/path', 'sensor_msgs/msg/Nothing', 'sensor_msgs/Image', '../msg/A', '', 'a/msg/'],
)
def test_what_is_no_installed_message_type_is_skipped(name: str) -> None:
    from binocular_recon.nodes.player import _message_type

    assert _message_type(name) is None
