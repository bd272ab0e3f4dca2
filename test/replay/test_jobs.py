# SPDX-License-Identifier: Apache-2.0
"""``reconstruct --jobs``: its processes end with the command, and what was made is kept."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from binocular_recon.apps.batch.local_processes import LocalProcesses
from binocular_recon.apps.batch.worker import READY
from test.bag_tools import stereo_records, write_bag
from test.frame_results import contents
from test.replay.reconstruction import RANGE, reconstruct, runs

FRAMES = 24


def children(process: int) -> list[int]:
    text = Path(f'/proc/{process}/task/{process}/children').read_text()
    return [int(number) for number in text.split()]


@pytest.mark.long
@pytest.mark.skipif(len(os.sched_getaffinity(0)) < 2, reason='needs two cores')
def test_all_processes_end_with_the_command_and_another_number_of_them_continues(
    tmp_path: Path,
) -> None:
    bag = write_bag(tmp_path / 'bag', stereo_records(FRAMES))
    output = tmp_path / 'out'
    words = ['reconstruct', str(bag), '--output', str(output), *RANGE, '--jobs', '2']
    made = 0
    for number, status, kept in (
        (signal.SIGKILL, -signal.SIGKILL, ''),
        (signal.SIGINT, 130, 'interrupted; '),
    ):
        command = [sys.executable, '-m', 'binocular_recon', *words]
        run = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, start_new_session=True)
        while run.poll() is None and len({*output.glob('*.ply')}) < made + 2:
            time.sleep(0.01)
        started = children(run.pid)
        assert len(started) >= 2
        if number == signal.SIGKILL:
            run.kill()
        else:
            os.killpg(run.pid, number)  # as a terminal does
        error = run.communicate()[1]  # ends with the last process
        assert run.returncode == status, error
        assert kept in error and 'Traceback' not in error
        while any(map(runs, started)):
            time.sleep(0.01)
        made = len({*output.glob('*.ply')})
        assert 2 <= made < FRAMES
    assert not list(output.glob('.*'))
    assert reconstruct(bag, output) == 0
    assert reconstruct(bag, tmp_path / 'alone') == 0
    assert contents(output) == contents(tmp_path / 'alone')


@pytest.mark.skipif(sys.version_info < (3, 11), reason='Python cannot be told so')
def test_processes_import_nothing_from_the_current_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ('_multiprocessing', 'multiprocessing', 'numpy'):
        (tmp_path / f'{name}.py').write_text(f"open('{tmp_path}/ran', 'w')")
    monkeypatch.chdir(tmp_path)
    before = dict(os.environ)
    processes = LocalProcesses(1)
    (process,) = processes._all
    assert process._connection.recv() == READY
    processes.close()
    assert not (tmp_path / 'ran').exists()
    assert dict(os.environ) == before
