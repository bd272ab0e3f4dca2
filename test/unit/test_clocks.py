# SPDX-License-Identifier: Apache-2.0
"""Clocks that differ, stand still or are of no use."""

from __future__ import annotations

import random
from typing import Any

import pytest

from binocular_recon.errors import ConfigError
from binocular_recon.inputs.clocks import clock_offset
from binocular_recon.inputs.options import PairingOptions
from binocular_recon.pairing import STANDING_STILL, Synchronizer
from test.unit.pairing_tools import MS, Message

PERIOD = 100 * MS


def pair_up(
    synchronizer: Synchronizer, ahead_ns: int, frames: int = 20, jitter_ns: int = 4 * MS
) -> list[tuple[int, int]]:
    """Feed frames of two cameras on one trigger; return the numbers of those that are paired."""
    generator = random.Random(1)
    arrivals = []
    for k in range(frames):
        for name, offset in (('left', 0), ('right', ahead_ns)):
            arrived = k * PERIOD + 20 * MS + generator.randint(0, jitter_ns)
            arrivals.append((arrived, name, k * PERIOD + offset, k))
    found = []
    for arrived, name, stamp, k in sorted(arrivals):
        found += synchronizer.add(name, stamp, k, arrived)
    return found


def synchronizer_of(pairing: PairingOptions, tolerance_ns: int | None = 0) -> Synchronizer:
    return Synchronizer(
        ('left', 'right'),
        queue_size=5,
        tolerance_ns=tolerance_ns,
        by_arrival=pairing.pairing == 'arrival',
        offsets_ns={'right': pairing.stamp_offset_ns},
    )


@pytest.mark.parametrize(
    'ahead_ms', [30, 60, -60, 95, 130, 1234, -777_777, 3_600_000, 1_700_000_000_000]
)
def test_a_constant_is_measured_and_removes_the_mismatch(ahead_ms: int) -> None:
    plain = synchronizer_of(PairingOptions())
    assert pair_up(plain, ahead_ms * MS) == []
    mismatch = plain.explain()
    assert mismatch is not None and mismatch.offset_s is not None
    assert mismatch.offset_s == pytest.approx(-ahead_ms / 1000, abs=1e-6)
    way = 'ahead' if ahead_ms > 0 else 'behind'
    assert f'its clock is {abs(ahead_ms):.3f} ms {way}, a constant' in mismatch.text
    # the nearest stamp is that of the same moment only below half a frame period
    assert (mismatch.tolerance_s is None) == (abs(ahead_ms) >= 50)
    mended = synchronizer_of(PairingOptions(stamp_offset=mismatch.offset_s))
    assert pair_up(mended, ahead_ms * MS) == [(k, k) for k in range(20)]


@pytest.mark.parametrize(
    ('ahead_ns', 'spread_ns'),
    [(60_123_456, 0), (1_700_000_000_123_456_789, 0), (30 * MS, MS), (-77_000_000_001, 2 * MS)],
)
def test_what_is_advised_pairs_clocks_of_any_constant(ahead_ns: int, spread_ns: int) -> None:
    """Constants of fractions of a microsecond, and stamps that scatter."""
    generator = random.Random(3)
    lags = [ahead_ns + round(generator.gauss(0, spread_ns)) for _ in range(20)]

    def pairs(options: PairingOptions, tolerance_s: float) -> tuple[list[Any], Any]:
        synchronizer = synchronizer_of(options, round(tolerance_s * 1e9))
        found: list[Any] = []
        for k, lag in enumerate(lags):
            found += synchronizer.add('left', k * PERIOD, k, k * PERIOD)
            found += synchronizer.add('right', k * PERIOD + lag, k, k * PERIOD)
        return found, synchronizer.explain()

    found, mismatch = pairs(PairingOptions(), 0.0)
    assert found == []
    assert bool(mismatch.offset_tolerance_s) == (ahead_ns > 1e18 or spread_ns > 0)
    assert mismatch.offset_tolerance_s <= max(2e-6, 8e-9 * spread_ns)
    advised = PairingOptions(stamp_offset=float(mismatch.offset_text))
    found, _ = pairs(advised, mismatch.offset_tolerance_s)
    # the last one may wait for a nearer stamp
    assert found[:19] == [(k, k) for k in range(19)]


@pytest.mark.parametrize('ahead_ms', [0, 60, 3_600_000])
def test_pairing_by_arrival_needs_no_stamps(ahead_ms: int) -> None:
    found = pair_up(synchronizer_of(PairingOptions(pairing='arrival')), ahead_ms * MS)
    assert set(found) <= {(k, k) for k in range(20)}
    assert len(found) >= 18


def test_pairing_by_arrival_survives_a_lost_image() -> None:
    synchronizer = synchronizer_of(PairingOptions(pairing='arrival'))
    found = []
    for k in range(20):
        for name, lag in (('left', 0), ('right', 3 * MS)):
            if (name, k) not in {('right', 5), ('left', 11)}:
                found += synchronizer.add(name, 0, k, k * PERIOD + lag)
    assert all(left == right for left, right in found)
    assert len(found) >= 16
    assert synchronizer.standing_still() == ''


def test_stamps_that_wander_have_no_constant() -> None:
    generator = random.Random(2)
    leading = [(k * PERIOD, k * PERIOD) for k in range(30)]
    other = [(k * PERIOD + generator.randint(0, PERIOD), k * PERIOD) for k in range(30)]
    assert clock_offset(leading, other) is None
    assert clock_offset(leading[:3], leading[:3]) is None
    assert clock_offset(leading, leading) == (0, 0)


def test_a_tolerance_of_half_a_period_is_not_a_remedy() -> None:
    """Without times of arrival no constant is known, but the tolerance is not advised either."""
    synchronizer = synchronizer_of(PairingOptions())
    for k in range(9):
        synchronizer.add('left', k * PERIOD, k)
        synchronizer.add('right', k * PERIOD + PERIOD // 2, k)
    mismatch = synchronizer.explain()
    assert mismatch is not None and mismatch.tolerance_s is None and mismatch.offset_s is None


@pytest.mark.parametrize('stamp_ns', [0, 1_700_000_000_123_456_789])
def test_stamps_that_do_not_advance_make_no_sets(stamp_ns: int) -> None:
    synchronizer = synchronizer_of(PairingOptions(), tolerance_ns=None)
    found = []
    for k in range(20):
        found += synchronizer.add('left', stamp_ns, k, k * PERIOD)
        found += synchronizer.add('right', stamp_ns, k, k * PERIOD)
    assert len(found) < STANDING_STILL
    text = f'stamps of left do not advance: all are {stamp_ns / 1e9:.9f} s'
    assert synchronizer.standing_still().startswith(text)
    found = synchronizer.add('left', stamp_ns + PERIOD, 20, 20 * PERIOD)
    found += synchronizer.add('right', stamp_ns + PERIOD, 20, 20 * PERIOD)
    assert found[-1:] == [(20, 20)]
    assert synchronizer.standing_still() == ''


def test_a_message_that_is_repeated_is_no_standing_clock() -> None:
    synchronizer = synchronizer_of(PairingOptions())
    found = []
    for k in range(10):
        for name in ('left', 'right', 'left'):
            found += synchronizer.add(name, k * PERIOD, Message(name, k))
    assert len(found) == 10 and synchronizer.standing_still() == ''


def test_pairing_options() -> None:
    assert PairingOptions(stamp_offset=-0.0400001).stamp_offset_ns == -40_000_100
    with pytest.raises(ConfigError, match='pairing must be one of stamps, arrival'):
        PairingOptions(pairing='order')
