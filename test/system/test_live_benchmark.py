# SPDX-License-Identifier: Apache-2.0
"""Running nodes are measured beside the chain alone, and no process stays behind."""

from __future__ import annotations

from pathlib import Path

import pytest

from binocular_recon.evaluation.speed.content import Size
from binocular_recon.evaluation.speed.live import OFFLINE, LiveOptions, measure
from binocular_recon.evaluation.speed.live_processes import LiveError, running
from test.system.graph import wait_until

pytestmark = pytest.mark.long


def test_contestants_make_clouds_of_the_same_pairs() -> None:
    said: list[str] = []
    options = LiveOptions(rate_hz=40.0, seconds=0.5, rounds=1, outputs=('points2', 'depth'))
    results = {one.name: one for one in measure(Size(160, 120, 32), options, said.append)}
    assert list(results) == [OFFLINE, 'composed', 'separate'] and len(said) == 3
    for name, one in results.items():
        assert one.clouds_per_s > 0 and one.cpu_s_per_cloud > 0, name
        if name != OFFLINE:
            assert 0 < one.latency_s <= one.latency_95_s
            assert one.memory_mb > 50 and one.relative > 0
    assert results[OFFLINE].relative == results[OFFLINE].cpu_relative == 1


def test_a_process_that_ends_is_named_with_what_it_said_last(tmp_path: Path) -> None:
    code = 'import sys; sys.stdin.readline(); sys.exit("no camera at /dev/video0")'
    with running({'cameras': ['-c', code]}, tmp_path) as processes:
        process = processes['cameras']
        wait_until(lambda: process.usage().memory_mb > 1, 'the process has begun')
        process.send('rate 1')
        process._process.wait()
        with pytest.raises(LiveError, match=r'^cameras ended with status 1: no camera at /dev/v'):
            process.check()
