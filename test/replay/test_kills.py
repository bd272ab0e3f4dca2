# SPDX-License-Identifier: Apache-2.0
"""``reconstruct`` killed at random moments and run again: the files are those of one quiet run."""

from __future__ import annotations

import contextlib
import os
import random
import signal
import time
from pathlib import Path

import pytest

from test.frame_results import contents
from test.replay.reconstruction import RANGE, Runner, kill, runs
from test.replay.test_resume import STATEFUL, exposed_bag

# `KILLS=200 SEED=7` in the environment kills more often and at other moments.
KILLS, SEED = int(os.environ.get('KILLS', '6')), int(os.environ.get('SEED', '0'))
MOST_KILLS = 3  # of one run


@pytest.mark.long
@pytest.mark.timeout(0 if KILLS > 10 else 300)
def test_runs_killed_at_random_moments_leave_the_files_of_an_undisturbed_one(
    tmp_path: Path,
) -> None:
    bag = exposed_bag(tmp_path)
    generator = random.Random(SEED)

    def words(output: Path) -> list[str]:
        return ['reconstruct', str(bag), '--output', str(output), *RANGE, *STATEFUL]

    with contextlib.closing(Runner(tmp_path / 'log')) as runner:
        for name in ('compiled', 'undisturbed'):
            begun_s = time.monotonic()
            runner.start(words(tmp_path / name))
            assert runner.status() == 1  # a pair is left out
            whole_s = time.monotonic() - begun_s
        undisturbed = contents(tmp_path / 'undisturbed')
        assert contents(tmp_path / 'compiled') == undisturbed
        kills = runs_of_all = 0
        while kills < KILLS:
            output = tmp_path / f'killed_{runs_of_all}'
            runs_of_all += 1
            for _ in range(generator.randint(1, MOST_KILLS)):
                run, begun_s = runner.start(words(output)), time.monotonic()
                end_s = begun_s + generator.uniform(0, whole_s)
                while time.monotonic() < end_s and runs(run):
                    time.sleep(0.0005)
                kill(run, signal.SIGKILL)
                if runner.status() != -signal.SIGKILL:  # it was quicker
                    whole_s = min(whole_s, time.monotonic() - begun_s)
                    break
                kills += 1
            runner.start(words(output))
            assert runner.status() == 1
            assert contents(output) == undisturbed
    assert 'Traceback' not in (tmp_path / 'log').read_text()
