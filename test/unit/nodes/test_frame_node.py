# SPDX-License-Identifier: Apache-2.0
"""What a node does with a frame that it cannot process."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

import pytest

from binocular_recon.errors import CalibrationError, ImageError
from binocular_recon.pairing import Synchronizer

pytestmark = pytest.mark.ros


@pytest.mark.parametrize(
    ('error', 'dropped', 'text'),
    [
        (ImageError('too dark'), 'bad input', 'too dark'),
        (CalibrationError('no K'), 'bad calibration', 'no K'),
        (
            MemoryError('Unable to allocate 9 GiB'),
            'not enough memory',
            'Unable to allocate 9 GiB; reduce disparity_range or the size of the images',
        ),
    ],
)
def test_a_frame_that_fails_is_counted_and_reported(
    error: Exception, dropped: str, text: str
) -> None:
    from binocular_recon.nodes.runtime.worker import InTwoThreads, LatestWorker

    def fail() -> None:
        raise error

    for process in (Mock(side_effect=error), Mock(return_value=fail)):  # in either half
        health, workers = Mock(), []

        def start(work: Callable[[Any], None], kind: type[LatestWorker[Any]]) -> LatestWorker[Any]:
            workers.append(kind(work, Mock()))  # noqa: B023 - called at once
            return workers[-1]  # noqa: B023

        frames = InTwoThreads(health, process, start)
        frames.process(('left', 'right'))
        workers[0].close(5)
        process.assert_called_once_with('left', 'right')
        health.dropped.assert_called_once_with(dropped)
        assert text in health.error.call_args.args[0]
        assert frames.processed() == 0


@pytest.mark.parametrize('running', [True, False])
def test_an_internal_error_is_counted_and_reported_while_the_node_runs(running: bool) -> None:
    from binocular_recon.nodes.runtime.frame_node import FrameNode

    node: Any = SimpleNamespace(health=Mock(), context=Mock(ok=lambda: running))
    FrameNode._on_internal_error(node, ZeroDivisionError('fault'))
    if running:
        node.health.dropped.assert_called_once_with('internal error')
        assert 'ZeroDivisionError: fault' in node.health.error.call_args.args[0]
    else:
        assert node.health.mock_calls == []


def missing_frames(
    feed: Callable[[Synchronizer], None],
    silent: dict[str, float],
    confidence_publishers: int,
    loss: str = '',
) -> str:
    """Return why there are no frames of images, disparities and optional confidences."""
    from binocular_recon.nodes.runtime.frame_node import FrameNode
    from binocular_recon.nodes.runtime.options import InputOptions

    names = ('left', 'disparity', 'confidence')
    node: Any = object.__new__(FrameNode)
    node._inputs = dict.fromkeys(names)
    node._optional = {'confidence': '/rig/confidence'}
    node._synchronizer = Synchronizer(names, queue_size=5)
    node._synchronizer.expect('confidence', expected=confidence_publishers > 0)
    node.options = Mock(of=lambda _: InputOptions())
    node.health = Mock(silent=lambda: silent, loss=lambda: loss)
    node.count_publishers = lambda _: confidence_publishers
    feed(node._synchronizer)
    return FrameNode.explain_missing_frames(node)


def add(
    synchronizer: Synchronizer, lag: int = 0, miss_ns: int = 0, *, still: bool = False
) -> None:
    for k in range(20):
        synchronizer.add('left', 0 if still else 10**8 * k, k)
        if k >= lag:
            synchronizer.add('disparity', 10**8 * (k - lag) + miss_ns, k)


@pytest.mark.parametrize(
    ('feed', 'silent', 'publishers', 'text'),
    [
        (
            add,
            {'confidence': 4.0},
            1,
            (
                'frames wait for confidence, which has a publisher but no messages; check that'
                ' publisher or stop it: confidence is optional'
            ),
        ),
        (
            partial(add, lag=8),
            {'confidence': 4.0},
            0,
            (
                'messages on disparity arrive too late: their partners had already been dropped;'
                ' raise queue_size to at least 9'
            ),
        ),
        (
            partial(add, miss_ns=2_000_000),
            {},
            0,
            (
                'stamps never match those of left: disparity is 2.000 ms later (nearest recent'
                ' ones); trigger the cameras together or set approximate_sync with'
                ' approximate_sync_tolerance_seconds of at least 0.002000'
            ),
        ),
        (
            partial(add, miss_ns=50_000_000),
            {},
            0,
            (
                'stamps never match those of left: disparity is 50.000 ms later (nearest recent'
                ' ones); that is at least half a frame period, so no tolerance tells which belong'
                ' together: trigger the cameras together and stamp them by one clock'
            ),
        ),
        (
            partial(add, still=True),
            {},
            0,
            (
                'stamps of left do not advance: all are 0.000000000 s, so nothing tells which'
                ' images belong together; let the driver stamp them, or set pairing to arrival if'
                ' a hardware trigger takes them'
            ),
        ),
    ],
)
def test_why_there_are_no_frames(
    feed: Callable[[Synchronizer], None], silent: dict[str, float], publishers: int, text: str
) -> None:
    assert missing_frames(feed, silent, publishers) == text


def test_losses_in_transport_come_before_what_they_cause() -> None:
    loss = 'messages are lost in transport: 12 of 19 on left'
    assert missing_frames(partial(add, miss_ns=50_000_000), {}, 0, loss) == loss


def test_the_remedy_for_a_constant_is_a_parameter() -> None:
    from binocular_recon.inputs.clocks import Mismatch
    from binocular_recon.nodes.runtime.remedies import remedy

    text = remedy(Mismatch('', None, -0.06), 0)
    assert text.startswith('set stamp_offset to -0.060000, or pairing to arrival')
    text = remedy(Mismatch('', None, -0.06, 0.012), 10_000_000)
    assert (
        '-0.060000 with approximate_sync and approximate_sync_tolerance_seconds of 0.012' in text
    )
    text = remedy(Mismatch('', 0.03, -0.03), 0)
    assert 'at least 0.030000, or set stamp_offset to -0.030000' in text


@pytest.mark.parametrize(
    ('ages_s', 'too_late', 'level', 'text'),
    [
        ({}, '', 'OK', '7 frames in the last second'),
        ({'confidence': 9.0}, '', 'OK', '7 frames in the last second'),
        ({}, 'arrive too late', 'WARN', 'arrive too late'),
        (
            {'disparity': 4.0, 'sets': 4.0},
            '',
            'ERROR',
            'no messages on disparity for 4.0 s; /rig/match_node publishes them but sends nothing',
        ),
        (
            {'left': 4.0, 'disparity': 4.0},
            '',
            'STALE',
            'no messages on left, disparity; /rig/match_node publishes them but sends nothing',
        ),
        # an image that has a publisher may be lost on its way
        ({'left': 4.0}, '', 'ERROR', '; if images are sent on left, all are lost: start the pro'),
        ({'sets': 4.0}, 'arrive too late', 'ERROR', 'arrive too late'),
    ],
)
def test_what_prevents_frames(
    ages_s: dict[str, float], too_late: str, level: str, text: str
) -> None:
    """An optional input may be silent."""
    from diagnostic_msgs.msg import DiagnosticStatus

    from binocular_recon.nodes.runtime.frame_node import FrameNode

    node: Any = object.__new__(FrameNode)
    node._frames = Mock(processed=lambda: 7)
    node._subscriptions_in_use = [Mock()] * 3
    node._intake = Mock(superseded=lambda: 0)
    node._inputs = {
        name: Mock(transported=name == 'left') for name in ('left', 'disparity', 'confidence')
    }
    node._optional = {'confidence': '/rig/confidence'}
    node.count_publishers = lambda _: 1
    node.health = Mock(silent=lambda: ages_s, loss=lambda: '', pausing=lambda _: {})
    publisher = SimpleNamespace(node_namespace='/rig', node_name='match_node')
    node.get_publishers_info_by_topic = lambda _: [publisher]
    node._explain_lateness = lambda: too_late
    node._synchronizer = Synchronizer(['left'], queue_size=5)
    reported = FrameNode.condition(node)
    assert reported[0] == getattr(DiagnosticStatus, level) and text in reported[1]
    assert node.health.log.called == (level != 'OK')


@pytest.mark.parametrize(
    ('publishers', 'text'),
    [
        ([], 'nobody publishes them: start the cameras or check the remappings'),
        ([('/', 'camera')], '/camera publishes them but sends nothing: its log and its status'),
        ([('/', '_NODE_NAME_UNKNOWN_')], 'their publisher publishes them but sends nothing'),
    ],
)
def test_who_is_silent(publishers: list[tuple[str, str]], text: str) -> None:
    from binocular_recon.nodes.runtime.frame_node import FrameNode

    infos = [SimpleNamespace(node_namespace=space, node_name=name) for space, name in publishers]
    node: Any = SimpleNamespace(
        get_publishers_info_by_topic=lambda _: infos,
        _inputs={'left': Mock(transported=False)},
        _subscriptions_in_use=[Mock()],
    )
    assert FrameNode._who_is_silent(node, ['left']).startswith(text)
