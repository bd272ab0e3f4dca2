# SPDX-License-Identifier: Apache-2.0
"""``reconstruct`` with an interruption or an output folder that cannot be written."""

from __future__ import annotations

import contextlib
import errno
import json
import os
import re
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from binocular_recon.apps.frame_formats import FRAME_FORMATS
from binocular_recon.number_text import counted
from test.bag_tools import (
    stereo_records,
    write_bag,
)
from test.full_disk import largest_file
from test.replay.reconstruction import RANGE, frames_of, reconstruct, wrong_size


def test_an_output_that_cannot_be_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = write_bag(tmp_path / 'bag', stereo_records(1))
    (tmp_path / 'file').write_text('')
    assert reconstruct(bag, tmp_path / 'file' / 'out') == 1
    assert 'file/out cannot be made: Not a directory; choose another' in capsys.readouterr().err


@pytest.mark.parametrize('format_name', list(FRAME_FORMATS))
def test_a_full_disk_keeps_the_finished_frames(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    format_name: str,
) -> None:
    bag, output = write_bag(tmp_path / 'bag', stereo_records(3)), tmp_path / 'out'
    assert reconstruct(bag, output) == 0
    old = (output / '000001.ply').read_bytes(), (output / '000002.ply').read_bytes()
    spec = FRAME_FORMATS[format_name]

    def find_no_space(path: Path, *arguments: Any) -> object:
        with largest_file(100) if path.name.startswith('000001') else contextlib.nullcontext():
            return spec.write(path, *arguments)

    monkeypatch.setitem(FRAME_FORMATS, format_name, spec._replace(write=find_no_space))
    assert reconstruct(bag, output, '--no-resume', '--format', format_name) == 1
    assert 'cannot be written: ' in (text := capsys.readouterr().err)
    assert '; free some space' in text
    summary = json.loads((output / 'summary.json').read_text())
    assert (len(summary['frames']), summary['finished']) == (1, False)
    # what an earlier run had made is kept
    assert ((output / '000001.ply').read_bytes(), (output / '000002.ply').read_bytes()) == old
    assert not list(output.glob('.*'))


def test_an_earlier_run_is_replaced_as_a_whole_or_not_at_all(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / 'out'
    bag = write_bag(tmp_path / 'bag', stereo_records(3))
    assert reconstruct(bag, output, '--drawings') == 0
    (output / '000009_notes.txt').write_text('mine')
    before = sorted(output.iterdir())
    bad = tmp_path / 'bad'
    bad.mkdir()
    assert reconstruct(wrong_size(bad), output) == 1
    assert sorted(output.iterdir()) == before
    assert len(json.loads((output / 'summary.json').read_text())['frames']) == 3
    assert reconstruct(bag, output, '--max-frames', '2') == 0
    (output / '000009_notes.txt').unlink()
    assert frames_of(output) == 2
    assert 'no partner' not in capsys.readouterr().out


def test_a_disk_that_became_read_only_is_an_error(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(path: Path, *_args: object, **_options: object) -> None:
        raise OSError(errno.EROFS, os.strerror(errno.EROFS), str(path))

    bag = write_bag(tmp_path / 'bag', stereo_records(1))
    monkeypatch.setattr(Path, 'replace', fail)
    monkeypatch.setattr(Path, 'unlink', fail)
    assert reconstruct(bag, tmp_path / 'out') == 1
    text = capsys.readouterr().err
    assert '000000_disparity.pfm cannot be written: Read-only file system; choose a fold' in text


def read_terminal(controller: int, until: str = r'(?!)') -> str:
    """Return what a process shows on its terminal until a pattern appears or the process ends."""
    shown = b''
    while not re.search(until, shown.decode()):
        try:
            part = os.read(controller, 1024)
        except OSError:  # on Linux, when the last process has closed the terminal
            break
        if not part:
            break
        shown += part
    return shown.decode()


def test_an_interruption_keeps_the_finished_frames(tmp_path: Path) -> None:
    bag, output = write_bag(tmp_path / 'bag', stereo_records(400)), tmp_path / 'out'
    words = ['reconstruct', str(bag), '--output', str(output), *RANGE]
    command = [sys.executable, '-m', 'binocular_recon', *words]
    controller, terminal = os.openpty()
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=terminal, text=True)
    os.close(terminal)
    shown = read_terminal(controller, until=r'[3-9] of 400 frames')
    process.send_signal(signal.SIGINT)
    shown += read_terminal(controller)
    os.close(controller)
    out = process.communicate(timeout=30)[0]
    error = shown.rpartition('\r\033[K')[2].replace('\r\n', '\n')  # what follows the progress bar
    assert process.returncode == 130, shown
    count = frames_of(output)
    assert 3 <= count < 400
    frames = counted(count, 'finished frame is', 'finished frames are')
    expected = f'interrupted; {frames} kept in {output}\n'
    assert error == f'binocular-recon reconstruct: {expected}'
    assert out == ''
    assert json.loads((output / 'summary.json').read_text())['finished'] is False
