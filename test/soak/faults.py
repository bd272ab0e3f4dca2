# SPDX-License-Identifier: Apache-2.0
"""The faults that running nodes must survive: how each begins and ends, and what names it."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass

from test.soak.rig import RATE_HZ, SIZES, Rig, spoil_some

_HOUR_NS = 3600 * 1_000_000_000
_LEAVES = 50


@dataclass(frozen=True)
class Fault:
    """A fault.

    Attributes
    ----------
    name : str
        What happens.
    cause : str
        Regular expression that a message, a new drop or a new state in the diagnostics matches;
        '' = nothing is lost, so that nothing is to be said.
    begin, end : callable
        Cause and mend it.
    seconds : float
        How long it lasts.

    """

    name: str
    cause: str
    begin: Callable[[Rig], object]
    end: Callable[[Rig], object]
    seconds: float = 2.5


def _set(**values: object) -> Callable[[Rig], None]:
    """Return what sets attributes of the cameras."""

    def change(rig: Rig) -> None:
        for name, value in values.items():
            setattr(rig.cameras, name, value)

    return change


def _restart(rig: Rig) -> None:
    """Let the cameras come back with another size and encoding."""
    now = SIZES.index(rig.cameras.size)
    rig.cameras.resize(SIZES[1 - now])
    _set(rate_hz=RATE_HZ, sides=('left', 'right'), colour=not rig.cameras.colour)(rig)


def _replace(rig: Rig) -> None:
    rig.cameras.resize(rig.cameras.size, baseline=1.25)


def _loop(rig: Rig) -> None:
    """Play a second of recorded stamps again and again."""
    for _ in range(3):
        rig.cameras.offset_ns -= 1_000_000_000
        time.sleep(0.7)


def _leave_and_rejoin(rig: Rig) -> None:
    """Leave the clouds and come back, often."""
    for _ in range(_LEAVES):
        rig.leave()
        time.sleep(0.02)
        rig.listen()
        time.sleep(0.02)
    rig.leave()  # and come late


def _stop_clock(rig: Rig) -> None:
    rig.cameras.frozen_ns = time.time_ns()


def _kill(rig: Rig) -> None:
    name = list(rig.nodes)[len(rig.nodes) // 2]
    rig.nodes[name].kill()


def _start_again(rig: Rig) -> None:
    """Start what was killed; the fault has ended when it is there."""
    name = list(rig.nodes)[len(rig.nodes) // 2]
    rig.start(name)
    limit_s = time.monotonic() + 60
    while not rig.has_started(name) and time.monotonic() < limit_s:
        time.sleep(0.01)


def _starve(rig: Rig) -> None:
    """Keep every core busy twice."""
    rig.burden = [
        subprocess.Popen([sys.executable, '-c', 'while True: pass'])
        for _ in range(2 * len(os.sched_getaffinity(0)))
    ]


def _feed(rig: Rig) -> None:
    for process in rig.burden:
        process.kill()
        process.wait()
    rig.burden = []


_SILENT = r'no messages on .*right/(image|camera)'
FAULTS = (
    Fault('one camera stops', _SILENT, _set(sides=('left',)), _set(sides=('left', 'right'))),
    Fault('cameras restart with another size and encoding', _SILENT, _set(sides=()), _restart),
    Fault(
        'calibration replaced',
        r'calibration: .*baseline 0\.3125 m',
        _replace,
        lambda rig: rig.cameras.resize(rig.cameras.size),
    ),
    Fault('stamps jump an hour ahead', '', _set(offset_ns=_HOUR_NS), lambda _: None, 1.0),
    Fault(
        'stamps jump an hour back',
        'stamps of .* went back by 3(599|600)',
        _set(offset_ns=0),
        lambda _: None,
        1.5,
    ),
    Fault('a bag loops', 'stamps of .* went back by 0', _loop, _set(offset_ns=0), 0.5),
    Fault(
        f'the subscriber leaves and rejoins {_LEAVES} times',
        'idle: no subscribers',
        _leave_and_rejoin,
        Rig.listen,
        1.5,
    ),
    Fault(
        '10 % of the messages corrupted',
        'dropped: (bad|.* without partner)',
        _set(spoil=spoil_some),
        _set(spoil=None),
        3.0,
    ),
    Fault('processor taken by other work', '', _starve, _feed, 3.0),
    Fault(
        'ten times the rate',
        'cannot keep up|a newer set came',
        _set(rate_hz=10 * RATE_HZ),
        _set(rate_hz=RATE_HZ),
    ),
    Fault('one camera 100 ms late', '', _set(late_s=0.1), _set(late_s=0.0)),
    Fault(
        'a simulated clock that stops',
        'do not advance',
        _stop_clock,
        _set(frozen_ns=0),
        5.0,
    ),
)
# It ends the life of a process, over which its memory is looked at.
KILL = Fault('a node killed and restarted', '', _kill, _start_again, 0.5)
