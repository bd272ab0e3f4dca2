# SPDX-License-Identifier: Apache-2.0
"""``reconstruct`` with options that choose topics and pairs."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from test.bag_tools import (
    START_NS,
    stereo_records,
    write_bag,
)
from test.replay.reconstruction import frames_of, reconstruct, unsynchronised

IMAGES = ['--left-image', '/left/image_raw', '--right-image', '/right/image_raw']
INFOS = ['--left-info', '/left/camera_info', '--right-info', '/right/camera_info']


def test_stamps_apart_are_paired_when_allowed(tmp_path: Path) -> None:
    words = ['--approximate-sync-tolerance-seconds', '0.004']
    assert reconstruct(unsynchronised(tmp_path), tmp_path / 'out', *words) == 0
    assert frames_of(tmp_path / 'out') == 3


@pytest.mark.parametrize(
    ('words', 'message'),
    [
        (['--left-image', '/a'], '--left-image and --right-image belong together'),
        (['--left-info', '/a'], '--left-info and --right-info belong together'),
        (['--alpha', '3'], 'alpha must be -1'),
        (INFOS, '--left-info and --right-info can only be used with --left-image'),
        (['--no-rectified'], '--rectified can only be used with --left-image'),
        ([*IMAGES, '--namespace', 'rig'], '--namespace selects the topics that --left-image'),
        (
            [*IMAGES, *INFOS, '--calibration', 'rig'],
            '--calibration replaces the topics of --left-info',
        ),
    ],
)
def test_options_that_do_not_go_together_are_wrong_usage(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], words: list[str], message: str
) -> None:
    bag = write_bag(tmp_path / 'bag', stereo_records(1))
    assert reconstruct(bag, tmp_path / 'out', *words) == 2
    assert message in capsys.readouterr().err


def test_every_nth_pair_and_no_more_than_asked(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / 'bag', stereo_records(9))
    assert reconstruct(bag, tmp_path / 'out', '--every', '3', '--max-frames', '2') == 0
    summary = json.loads((tmp_path / 'out' / 'summary.json').read_text())
    stamps = [(frame['stamp_ns'] - START_NS) // 10**8 for frame in summary['frames']]
    assert stamps == [0, 3]


def test_named_topics_are_used(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / 'bag', stereo_records(1, '/odd', image='photo'))
    words = ['--left-image', '/odd/left/photo', '--right-image', '/odd/right/photo']
    assert reconstruct(bag, tmp_path / 'out', *words) == 0
    summary = json.loads((tmp_path / 'out' / 'summary.json').read_text())
    assert summary['source']['infos'] == ['/odd/left/camera_info', '/odd/right/camera_info']
    assert summary['source']['rectified'] is False
