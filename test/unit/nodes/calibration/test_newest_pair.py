# SPDX-License-Identifier: Apache-2.0
"""Which pair a capture takes, and when it takes none."""

from __future__ import annotations

import threading

import numpy as np
import pytest

from binocular_recon.errors import CalibrationError
from binocular_recon.nodes.calibration.newest_pair import ImagePair, NewestPair


def pair(arrived_s: float = 0.0) -> ImagePair:
    image = np.zeros((4, 6), np.uint8)
    return ImagePair(image, image, arrived_s)


def no_silence() -> str:
    return ''


def test_a_capture_takes_the_newest_pair_once() -> None:
    pairs = NewestPair()
    with pytest.raises(CalibrationError, match='pair has arrived yet; no messages on left'):
        pairs.take(lambda: 'no messages on left')
    first, second = pair(), pair()
    pairs.put(first)
    assert pairs.take(no_silence) is first and first.sizes.left == (6, 4)
    pairs.mark_captured(first)
    with pytest.raises(CalibrationError, match=r'since the last capture; wait for the next one'):
        pairs.take(no_silence)
    # another pair, even with the same stamp, as of a driver that sets none
    pairs.put(second)
    assert pairs.take(no_silence) is second
    pairs.mark_captured(second)
    pairs.mark_captured(None)
    assert pairs.take(no_silence) is second


def test_a_stale_pair_is_not_captured() -> None:
    pairs = NewestPair()
    pairs.put(pair(arrived_s=-1e6))
    with pytest.raises(
        CalibrationError, match=r'pair arrived \d+\.\d s ago; no messages on right'
    ):
        pairs.take(lambda: 'no messages on right')


def test_a_pair_that_cannot_be_used_outdates_the_one_before() -> None:
    pairs = NewestPair()
    first = pair()
    pairs.put(first)
    pairs.invalidate('left image is 6x4, right 8x4 px')
    with pytest.raises(CalibrationError, match='pair is unusable: left image is 6x4, right 8x4'):
        pairs.take(no_silence)
    assert pairs.wait_for_next(first, 0.0) is None
    again = pair()
    pairs.put(again)
    assert pairs.take(no_silence) is again


def test_the_next_pair_is_waited_for() -> None:
    pairs = NewestPair()
    first, second = pair(), pair()
    pairs.put(first)
    assert pairs.wait_for_next(first, 0.01) is None
    sender = threading.Thread(target=pairs.put, args=[second])
    sender.start()
    assert pairs.wait_for_next(first, 10.0) is second
    sender.join()
