# SPDX-License-Identifier: Apache-2.0
"""Bad input: a clear message in log and diagnostics, no wrong output, good frames are used."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np
import pytest
from stereo_msgs.msg import DisparityImage

from binocular_recon.io.messages.disparities import read_disparity
from binocular_recon.io.messages.images import stamp_ns
from binocular_recon.stereo.rectification import Rectifier
from test.system.conftest import StartNode
from test.system.graph import Graph, Inbox, wait_until
from test.system.rig import CameraPair, header, image_message, image_pair, info_message, raw_rig

NODE = '/rig/match_node'
RIG = Rectifier(raw_rig()).rig
IMAGES = Rectifier(raw_rig())(*image_pair(6))
DISPARITY: tuple[str, type[DisparityImage]] = ('/rig/disparity', DisparityImage)
_index = iter(range(100_000))


@pytest.fixture(scope='module')
def log(start_node: StartNode) -> Callable[[], str]:
    node = start_node('match_node', disparity_range=32)
    return lambda: str(node.text())


@pytest.fixture
def cameras(graph: Graph, log: Callable[[], str]) -> CameraPair:
    del log  # the node runs
    return CameraPair(graph, RIG, image='image_rect')


def bad_image(index: int, side: str, **members: Any) -> Any:
    message = image_message(IMAGES[side == 'right'], header(index, side))
    for member, value in members.items():
        setattr(message, member, value)
    return message


def bad_info(index: int, side: str, **members: Any) -> Any:
    message = info_message(RIG.right if side == 'right' else RIG.left, header(index, side))
    for member, value in members.items():
        setattr(message, member, value)
    return message


BAD: dict[str, tuple[str, Callable[[int], dict[str, Any]], str]] = {
    'uncalibrated': (
        'bad calibration',
        lambda i: {'left_info': bad_info(i, 'left', k=np.zeros(9), p=np.zeros(12))},
        'left camera: camera is not calibrated (fx = 0, fy = 0 px); calibrate it',
    ),
    'an entry of P': (
        'bad calibration',
        lambda i: {'right_info': bad_info(i, 'right', p=RIG.right.P.ravel() + 5 * np.eye(12)[1])},
        'right camera: P[0, 1] is 5, it must be 0',
    ),
    'size of the pair': (
        'bad calibration',
        lambda i: {'right_info': bad_info(i, 'right', width=80)},
        'left camera is 160x120, right is 80x120; rectified images must have the same size',
    ),
    'size of the calibration': (
        'bad input',
        lambda i: {'right_image': bad_image(i, 'right', width=80, step=160)},
        'right image is 80x120 px, its calibration is for 160x120',
    ),
    'baseline': (
        'bad calibration',
        lambda i: {'right_info': bad_info(i, 'left')},
        'baseline must be positive, got 0 m',
    ),
    'encoding': (
        'bad input',
        lambda i: {'left_image': bad_image(i, 'left', encoding='rgb565')},
        "left image has encoding 'rgb565'; convert it to one of",
    ),
    'short data': (
        'bad input',
        lambda i: {'left_image': bad_image(i, 'left', data=bytes(100))},
        'left image holds 100 bytes, step x height is 160 x 120',
    ),
}


def test_bad_frames_are_dropped_and_good_ones_used(
    graph: Graph, cameras: CameraPair, log: Callable[[], str]
) -> None:
    with graph.listening(DISPARITY) as (inbox,):
        graph.wait_for_subscriber(*cameras.topics)
        expected = []
        for name, (_, changes, text) in BAD.items():
            bad, good = next(_index), next(_index)
            cameras.send(bad, IMAGES, **changes(bad))
            wait_until(partial(_holds, log, text), f'{text!r} in the log')
            cameras.send(good, IMAGES)
            expected.append(stamp_ns(header(good)))
            inbox.wait(len(expected))
            assert [stamp_ns(m.header) for m in inbox.messages] == expected, name
        status = graph.wait_for_status(NODE, text)
    assert status.level == status.ERROR
    values = {item.key: item.value for item in status.values}
    reasons = [reason for reason, _, _ in BAD.values()]
    for reason in set(reasons):
        assert values[f'dropped: {reason}'] == str(reasons.count(reason))
    assert values['published disparity'] == str(len(BAD))
    assert text in values['last error']
    assert 'Traceback' not in log()


@pytest.mark.parametrize(
    ('fault', 'text'),
    [
        ('black', 'left image is uniform (grey level 0); check the lens cap'),
        ('white', 'left image is uniform (grey level 255)'),
        ('overexposed', r'left image is saturated in 40 % of its pixels; shorten the exposure'),
        ('nan', 'left image has no data (NaN) in 20.0 % of its pixels'),
    ],
)
def test_an_image_that_cannot_be_matched(
    graph: Graph, cameras: CameraPair, fault: str, text: str
) -> None:
    """A warning, and no disparity where there is nothing to match."""
    image = IMAGES[0].copy()
    rows = {'black': 120, 'white': 120, 'overexposed': 48, 'nan': 24}[fault]
    image[:rows] = 0 if fault == 'black' else 255
    encoding = 'mono8'
    if fault == 'nan':
        image, encoding = (image / 255).astype(np.float32), '32FC1'
        image[:rows] = np.nan
    with graph.listening(DISPARITY) as (inbox,):
        graph.wait_for_subscriber(*cameras.topics)
        index = next(_index)
        message = image_message(image, header(index), encoding)
        cameras.send(index, IMAGES, left_image=message)
        disparity = read_disparity(inbox.wait()[0], RIG).disparity_px
        status = graph.wait_for_status(NODE, text)
    assert status.level == status.WARN
    assert np.isnan(disparity[: rows - 5]).all()
    assert rows == 120 or np.isfinite(disparity[rows + 5 :]).mean() > 0.4


def test_silent_camera_is_named(graph: Graph, cameras: CameraPair) -> None:
    with graph.listening(DISPARITY) as (inbox,):
        graph.wait_for_subscriber(*cameras.topics)
        with sending(cameras, right_image=None):
            status = graph.wait_for_status(NODE, 'no messages on right/image_rect for')
        assert status.level == status.ERROR and inbox.messages == []
        with sending(cameras):
            inbox.wait()
            status = graph.wait_for_status(NODE, 'frames in the last second')


def test_no_camera_at_all_is_stale(graph: Graph, cameras: CameraPair) -> None:
    with graph.listening(DISPARITY):
        graph.wait_for_subscriber(*cameras.topics)
        status = graph.wait_for_status(NODE, 'no messages on left/image_rect, right/image_rect')
    assert status.level == status.STALE


def test_stamps_that_never_match(graph: Graph, cameras: CameraPair) -> None:
    def late(index: int) -> Any:
        message = bad_image(index, 'right')
        message.header.stamp.nanosec += 1_500_000
        return message

    with graph.listening(DISPARITY) as (inbox,):
        graph.wait_for_subscriber(*cameras.topics)
        with sending(cameras, right_image=late):
            status = graph.wait_for_status(NODE, 'stamps never match')
        assert status.level == status.ERROR and inbox.messages == []
    assert 'right/image_rect is 1.500 ms later' in status.message
    assert 'approximate_sync_tolerance_seconds of at least 0.001500' in status.message


def test_loop_and_clock_that_goes_back(graph: Graph, cameras: CameraPair) -> None:
    """Every pair of a bag that loops comes, also where its end is incomplete."""
    with graph.listening(DISPARITY) as (inbox,):
        graph.wait_for_subscriber(*cameras.topics)
        start = 50_000
        for loop in range(3):
            inbox.messages.clear()
            for k in range(6):
                last = k >= 4
                cameras.send(start + k, IMAGES, **({'right_image': None} if last else {}))
                if not last:
                    _wait_for(inbox, start + k, loop)


def _holds(log: Callable[[], str], text: str) -> bool:
    return text in log()


def _wait_for(inbox: Inbox, index: int, loop: int) -> None:
    wait_until(
        lambda: stamp_ns(header(index)) in inbox.by_stamp(), f'frame {index} of loop {loop}'
    )


@contextlib.contextmanager
def sending(cameras: CameraPair, **changes: Any) -> Iterator[None]:
    """Send frames at 20 Hz while the context lasts."""
    done = threading.Event()

    def send() -> None:
        while not done.wait(0.05):
            index = next(_index)
            made = {k: make(index) if callable(make) else make for k, make in changes.items()}
            cameras.send(index, IMAGES, **made)

    thread = threading.Thread(target=send)
    thread.start()
    try:
        yield
    finally:
        done.set()
        thread.join()
