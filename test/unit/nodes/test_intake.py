# SPDX-License-Identifier: Apache-2.0
"""Which frames reach the worker: the newest, at the rate of the consumers and of the user."""

from __future__ import annotations

import time
from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

import pytest

pytestmark = pytest.mark.ros


def make_intake(max_rate_hz: float = 0.0) -> tuple[Any, list[int], Any]:
    """Return an intake, what it has handed on, and its health; the worker holds one frame."""
    from binocular_recon.nodes.runtime.worker import Intake

    passed: list[int] = []
    health = Mock()

    def submit(frame: int) -> bool:
        passed.append(frame)
        return False

    return Intake(health, submit, lambda: max_rate_hz), passed, health


def make_demand(node: Any, on_ask: Any = lambda: None) -> Any:
    from binocular_recon.nodes.runtime.demand import PAIRS_WANTED, Demand

    outputs: Any = [SimpleNamespace(topic='left/image_rect')]
    return Demand(node, PAIRS_WANTED, outputs, on_ask)


def graph(asking: list[str], listening: list[str]) -> Any:
    """Return a node that sees who asks for its output, and who takes it."""

    def infos(names: list[str]) -> list[Any]:
        return [SimpleNamespace(node_namespace='/rig', node_name=name) for name in names]

    return Mock(
        resolve_topic_name=lambda topic: f'/rig/{topic}',
        get_publishers_info_by_topic=lambda _: infos(asking),
        get_subscriptions_info_by_topic=lambda _: infos(listening),
    )


def test_without_consumers_that_ask_every_frame_passes() -> None:
    intake, passed, health = make_intake()
    for frame in range(3):
        intake.offer(frame)
    assert passed == [0, 1, 2] and intake.superseded() == 0
    health.dropped.assert_not_called()


def test_the_newest_frame_waits_until_it_is_asked_for() -> None:
    intake, passed, health = make_intake()
    intake.demand = make_demand(graph(['match_node'], ['match_node']), intake.release)
    intake.update()
    for frame in range(4):
        intake.offer(frame)
    assert passed == [0]  # asked for from the start
    intake.demand._ask(None)
    assert passed == [0, 3]
    assert intake.superseded() == 2 and intake.superseded() == 0
    health.dropped.assert_called_with('a newer set came before it was begun')
    intake.demand._ask(None)
    intake.offer(4)
    assert passed == [0, 3, 4]


def test_a_request_that_was_lost_holds_nothing_up(monkeypatch: pytest.MonkeyPatch) -> None:
    intake, passed, _ = make_intake()
    intake.demand = make_demand(graph(['match_node'], ['match_node']))
    intake.update()
    now_s = time.monotonic()
    monkeypatch.setattr(time, 'monotonic', lambda: now_s)
    intake.offer(0)
    intake.offer(1)
    assert passed == [0]
    now_s += 1.1
    intake.release()
    assert passed == [0, 1]


@pytest.mark.parametrize(
    ('asking', 'listening', 'passing'),
    [
        (['match_node', 'wls_filter_node'], ['match_node', 'wls_filter_node'], 1),
        (['match_node'], ['match_node', 'rviz2'], 3),
        (['match_node'], ['_NODE_NAME_UNKNOWN_'], 3),
        ([], ['image_view'], 3),
    ],
)
def test_frames_are_made_on_demand_unless_somebody_else_listens(
    asking: list[str], listening: list[str], passing: int
) -> None:
    intake, passed, _ = make_intake()
    intake.demand = make_demand(graph(asking, listening))
    intake.update()
    for frame in range(3):
        intake.offer(frame)
    assert len(passed) == passing


def test_a_node_asks_only_while_its_own_frames_are_wanted() -> None:
    intake, _, _ = make_intake()
    intake.requests = Mock()
    intake.ask()
    assert intake.requests.ask.call_count == 1
    intake.demand = make_demand(graph(['wls_filter_node'], ['wls_filter_node']))
    intake.update()
    intake.offer(0)
    intake.ask()
    assert intake.requests.ask.call_count == 1
    intake.demand._ask(None)
    intake.ask()
    assert intake.requests.ask.call_count == 2


def test_frames_beyond_the_rate_are_dropped(monkeypatch: pytest.MonkeyPatch) -> None:
    """At 15 a second with jitter, a limit of 15 drops none, one of 5 two of three."""
    now_s = 0.0
    monkeypatch.setattr(time, 'monotonic', lambda: now_s)
    for limit_hz, expected in ((15.0, 90), (5.0, 30), (0.0, 90)):
        intake, passed, health = make_intake(limit_hz)
        begun_s = now_s
        for frame in range(90):
            now_s = begun_s + frame / 15 + (0.012 if frame % 3 == 1 else 0.0)
            intake.offer(frame)
        assert abs(len(passed) - expected) <= 1
        assert health.dropped.call_count == 90 - len(passed)
        now_s += 10.0
