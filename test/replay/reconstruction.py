# SPDX-License-Identifier: Apache-2.0
"""Run ``reconstruct`` on small bags."""

from __future__ import annotations

import json
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
