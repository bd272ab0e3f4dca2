# SPDX-License-Identifier: Apache-2.0
"""Run ``reconstruct`` on small bags."""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from binocular_recon.apps.frame_formats import FRAME_FORMATS
from binocular_recon.cli.main import main
from test.bag_tools import (
    HEIGHT,
    START_NS,
    WIDTH,
    image_message,
    image_pair,
    stereo_records,
    write_bag,
)

# The test images have 6 px of disparity; a small range is quick.
RANGE = ['--disparity-range', '16']

# Runs a command in a process of its own per line of input, and says which process and how it
# ended. Programs and kernels are loaded once.
_RUNNER = """
import json, os, sys
import cv2
cv2.setNumThreads(1)  # its threads would not survive the fork
from binocular_recon.apps import reconstruction
from binocular_recon.cli.main import main
from binocular_recon.config import ChainConfig
from binocular_recon.stereo.pipeline import warm_up
warm_up(ChainConfig())
for line in sys.stdin:
    child = os.fork()
    if not child:
        os.nice(5)  # whoever waits for a moment to kill it comes first
        sys.argv[1:] = json.loads(line)
        sys.exit(main())
    print(child, flush=True)
    print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)
"""


class Runner:
    """Starts commands that may be killed, one at a time; what they say on stderr goes to a log."""

    def __init__(self, log: Path) -> None:
        pipe = subprocess.PIPE
        command = [sys.executable, '-c', _RUNNER]
        with log.open('w') as said:
            self._process = subprocess.Popen(
                command, stdin=pipe, stdout=pipe, stderr=said, text=True
            )

    def start(self, words: list[str]) -> int:
        """Start a command and return the number of its process."""
        assert self._process.stdin
        print(json.dumps(words), file=self._process.stdin, flush=True)
        return self._said()

    def status(self) -> int:
        """Wait for the end of the command and return its exit status."""
        return self._said()

    def close(self) -> None:
        """End the process that starts the commands."""
        self._process.communicate()

    def _said(self) -> int:
        assert self._process.stdout
        return int(self._process.stdout.readline())


def kill(process: int, number: int) -> None:
    """Send a signal to a process that may have ended."""
    with contextlib.suppress(ProcessLookupError):
        os.kill(process, number)


def runs(process: int) -> bool:
    """Return whether a process exists and has not ended."""
    try:
        status = Path(f'/proc/{process}/stat').read_text()
    except OSError:
        return False
    return status.rpartition(')')[2].split()[0] != 'Z'


def reconstruct(bag: Path, output: Path, *words: str) -> int:
    return main(['reconstruct', str(bag), '--output', str(output), *RANGE, *words])


def said(capsys: pytest.CaptureFixture[str]) -> str:
    """Return what stderr got, without the notice that the first run compiled the kernels."""
    lines = capsys.readouterr().err.splitlines(keepends=True)
    return ''.join(line for line in lines if not line.startswith('kernels compiled in '))


def frames_of(output: Path) -> int:
    """Return the number of frames, each with all its files and an entry in the summary."""
    summary = json.loads((output / 'summary.json').read_text())
    count = len(summary['frames'])
    names = {
        f'{i:06d}{ending}'
        for i in range(count)
        for ending in (spec.ending for spec in FRAME_FORMATS.values() if not spec.on_request)
    }
    assert {path.name for path in output.iterdir()} == names | {'summary.json', 'frames.jsonl'}
    assert [frame['index'] for frame in summary['frames']] == list(range(count))
    return count


def unsynchronised(folder: Path) -> Path:
    records = stereo_records(3)
    for topic, message, _ in records:
        if topic == '/right/image_raw':
            message.header.stamp.nanosec += 3_000_000
    return write_bag(folder / 'bag', records)


def wrong_size(folder: Path) -> Path:
    records = stereo_records(2)
    small = image_pair(0, (HEIGHT - 8, WIDTH))[0]
    records[1] = (records[1][0], image_message(small, START_NS), START_NS)
    records[5] = (records[5][0], image_message(small, START_NS + 10**8), START_NS + 10**8)
    return write_bag(folder / 'bag', records)
