# SPDX-License-Identifier: Apache-2.0
"""Pipes, devices, loops and cut files in the place of those that commands read."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from binocular_recon.apps.batch.frame_log import NAME, FrameLog
from binocular_recon.cli.main import main
from binocular_recon.errors import FileError
from test.bag_tools import stereo_records, write_bag
from test.replay.reconstruction import reconstruct


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def pipe(path: Path) -> None:
    path.unlink()
    os.mkfifo(path)


def endless(path: Path) -> None:
    path.unlink()
    path.symlink_to('/dev/zero')


def loop(path: Path) -> None:
    path.unlink()
    path.symlink_to(path.name)


@pytest.fixture(scope='module')
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp('results')
    assert reconstruct(write_bag(folder / 'bag', stereo_records(1)), folder / 'out') == 0
    return folder / 'out'


@pytest.mark.timeout(120)
@pytest.mark.parametrize('damage', [cut, pipe, endless, loop])
def test_each_file_of_a_reconstruction(
    results: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    damage: Callable[[Path], None],
) -> None:
    picks, folder, refused = tmp_path / 'picks.csv', tmp_path / 'out', set()
    picks.write_text('name,frame,u,v\nA,0,20,20\nB,0,60,40\n')
    for name in sorted(path.name for path in results.iterdir()):
        shutil.copytree(results, folder)
        damage(folder / name)
        for command in (
            ['measure', str(folder), '--picks', str(picks), '--output', str(tmp_path / 'm')],
            ['export', str(folder), '--format', 'ply,tiff', '--output', str(tmp_path / 'e')],
            ['merge', str(folder), '--output', str(tmp_path / 'o')],
        ):
            status = main(command)
            error = capsys.readouterr().err.splitlines()
            assert status in (0, 1), (name, command)
            if status:
                assert error[-1].startswith(f'binocular-recon {command[0]}: '), error
                refused.add(name)
        shutil.rmtree(folder)
    read = {'summary.json', *(f'000000{end}' for end in ('.ply', '_disparity.pfm', '_sigma.pfm'))}
    assert refused >= read | {'000000_left.png', '000000_validity.png'}


@pytest.mark.timeout(30)
def test_a_log_that_is_a_pipe_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / NAME)
    with pytest.raises(FileError, match=r'frames\.jsonl cannot be written to: it is not a file'):
        FrameLog(tmp_path, [{'index': 0}]).add({'index': 1})
