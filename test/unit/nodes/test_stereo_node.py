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
            'Unable to allocate 9 GiB; choose a smaller disparity_range or smaller pictures',
        ),
    ],
)
def test_a_frame_that_fails_is_counted_and_said(error: Exception, dropped: str, text: str) -> None:
    from binocular_recon.nodes.runtime.base_node import StereoNode

    node: Any = SimpleNamespace(
        process=Mock(side_effect=error), health=Mock(), context=Mock(), _processed=0
    )
    StereoNode._work(node, ('left', 'right'))
    node.health.dropped.assert_called_once_with(dropped)
    assert text in node.health.error.call_args.args[0]
    assert node._processed == 0


@pytest.mark.parametrize('running', [True, False])
def test_a_fault_of_ours_is_counted_and_said_while_the_node_runs(running: bool) -> None:
    from binocular_recon.nodes.runtime.base_node import StereoNode

    node: Any = SimpleNamespace(health=Mock(), context=Mock(ok=lambda: running))
    StereoNode._fail(node, ZeroDivisionError('fault'))
    if running:
        node.health.dropped.assert_called_once_with('internal error')
        assert 'ZeroDivisionError: fault' in node.health.error.call_args.args[0]
    else:
        assert node.health.mock_calls == []


def missing_sets(
    feed: Callable[[Synchronizer], None], silent: dict[str, float], confidence_publishers: int
) -> str:
    """Return why there are no sets of pictures, disparities and optional confidences."""
    from binocular_recon.nodes.runtime.base_node import StereoNode
    from binocular_recon.nodes.runtime.options import InputOptions

    names = ('left', 'disparity', 'confidence')
    node: Any = object.__new__(StereoNode)
    node._inputs = dict.fromkeys(names)
    node._optional = {'confidence': '/rig/confidence'}
    node._synchronizer = Synchronizer(names, queue_size=5)
    node._synchronizer.expect('confidence', expected=confidence_publishers > 0)
    node.options = Mock(of=lambda _: InputOptions())
    node.health = Mock(silent=lambda: silent)
    node.count_publishers = lambda _: confidence_publishers
    feed(node._synchronizer)
    return StereoNode.explain_missing_sets(node)


def add(synchronizer: Synchronizer, lag: int = 0, miss_ns: int = 0) -> None:
    for k in range(20):
        synchronizer.add('left', 10**8 * k, k)
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
                'sets wait for confidence, which has a publisher but no messages; check that'
                ' publisher or stop it: sets are complete without'
            ),
        ),
        (
            partial(add, lag=8),
            {'confidence': 4.0},
            0,
            (
                'messages on disparity come too late: others of their stamp have made room for'
                ' newer ones by then; raise queue_size to at least 9'
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
    ],
)
def test_why_there_are_no_sets(
    feed: Callable[[Synchronizer], None], silent: dict[str, float], publishers: int, text: str
) -> None:
    assert missing_sets(feed, silent, publishers) == text


@pytest.mark.parametrize(
    ('ages_s', 'too_late', 'level', 'text'),
    [
        ({}, '', 'OK', '7 frames within a second'),
        ({'confidence': 9.0}, '', 'OK', '7 frames within a second'),
        ({}, 'come too late', 'WARN', 'come too late'),
        ({'disparity': 4.0, 'sets': 4.0}, '', 'ERROR', 'no message on disparity for 4.0 s; check'),
        ({'left': 4.0, 'disparity': 4.0}, '', 'STALE', 'no messages on left, disparity; start'),
        ({'sets': 4.0}, 'come too late', 'ERROR', 'come too late'),
    ],
)
def test_what_keeps_frames_from_coming(
    ages_s: dict[str, float], too_late: str, level: str, text: str
) -> None:
    """An optional input may be silent."""
    from diagnostic_msgs.msg import DiagnosticStatus

    from binocular_recon.nodes.runtime.base_node import StereoNode

    node: Any = object.__new__(StereoNode)
    node._processed, node._superseded, node._listening = 7, 0, [Mock()]
    node._inputs = dict.fromkeys(('left', 'disparity', 'confidence'))
    node._optional = {'confidence': '/rig/confidence'}
    node.count_publishers = lambda _: 1
    node.health = Mock(silent=lambda: ages_s)
    node._explain_lateness = lambda: too_late
    said = StereoNode._condition(node)
    assert said[0] == getattr(DiagnosticStatus, level) and text in said[1]
    assert node.health.log.called == (level != 'OK')
