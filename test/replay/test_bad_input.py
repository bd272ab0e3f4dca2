# SPDX-License-Identifier: Apache-2.0
"""``reconstruct`` with wrong or damaged bags: status, messages, kept frames."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from binocular_recon.number_text import counted
from test.bag_tools import (
    HEIGHT,
    START_NS,
    WIDTH,
    compressed_message,
    image_pair,
    info_message,
    rig,
    stereo_records,
    write_bag,
)
from test.replay.reconstruction import frames_of, reconstruct, said, unsynchronised, wrong_size


def missing(folder: Path) -> Path:
    return folder / 'gone'


def garbage(folder: Path) -> Path:
    (folder / 'noise.mcap').write_bytes(np.random.default_rng(0).bytes(100_000))
    return folder / 'noise.mcap'


def empty_folder(folder: Path) -> Path:
    (folder / 'bag').mkdir()
    return folder / 'bag'


def empty_bag(folder: Path) -> Path:
    return write_bag(folder / 'bag', [])


def other_topics(folder: Path) -> Path:
    return write_bag(folder / 'bag', stereo_records(1, image='image_mono'))


def silent_camera(folder: Path) -> Path:
    records = stereo_records(3)
    return write_bag(folder / 'bag', [r for r in records if r[0] != '/right/image_raw'])


def uncalibrated(folder: Path) -> Path:
    records = stereo_records(1)
    records[0][1].k[:] = 0
    return write_bag(folder / 'bag', records)


def swapped(folder: Path) -> Path:
    records = stereo_records(1)
    records[2][1].p[3] *= -1
    return write_bag(folder / 'bag', records)


def odd_encoding(folder: Path) -> Path:
    records = stereo_records(1)
    records[1][1].encoding = 'infrared9'
    return write_bag(folder / 'bag', records)


@pytest.mark.parametrize(
    ('make', 'message'),
    [
        (missing, 'gone does not exist; check the path'),
        (garbage, 'noise.mcap is not a bag: it begins with'),
        (empty_folder, 'holds no bag file'),
        (empty_bag, 'holds no message'),
        (
            other_topics,
            'the bag has /left/camera_info (sensor_msgs/msg/CameraInfo, 1), /left/image_m',
        ),
        (
            silent_camera,
            'the bag has /left/camera_info (sensor_msgs/msg/CameraInfo, 3), /left/image',
        ),
        (uncalibrated, 'left camera: camera is not calibrated (fx = 0'),
        (swapped, 'baseline must be positive'),
        (unsynchronised, 'right/image_raw is 3.000 ms later'),
        (wrong_size, f'{WIDTH}x{HEIGHT - 8} px, its calibration is for {WIDTH}x{HEIGHT}'),
        (odd_encoding, "encoding 'infrared9'"),
    ],
)
def test_input_without_a_single_frame_is_one_line_and_status_1(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    make: Callable[[Path], Path],
    message: str,
) -> None:
    bag = make(tmp_path)
    assert reconstruct(bag, tmp_path / 'out') == 1
    text = said(capsys)
    assert text.startswith('binocular-recon reconstruct: ')
    assert text.count('\n') == 1
    assert message in text


def test_a_damaged_bag_gives_what_precedes_the_damage(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = write_bag(tmp_path / 'bag', stereo_records(30), 'sqlite3')
    file = bag / 'bag.db3'
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 3])
    assert reconstruct(bag, tmp_path / 'out') == 1
    count = frames_of(tmp_path / 'out')
    assert 8 <= count <= 10
    text = capsys.readouterr().err
    assert 'bag.db3 is damaged (database disk image is malformed); messages before' in text
    assert text.endswith(f'{counted(count, "frame is", "frames are")} in {tmp_path / "out"}\n')
    summary = json.loads((tmp_path / 'out' / 'summary.json').read_text())
    assert summary['finished'] is True
    assert len(summary['damage']) >= 1


@pytest.mark.parametrize('kept_bytes', [0, 2000])
def test_a_truncated_image_costs_one_frame(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], kept_bytes: int
) -> None:
    records = []
    for index in range(3):
        stamp = START_NS + index
        for side, camera, pixels in zip(
            ('left', 'right'), (rig().left, rig().right), image_pair(index), strict=True
        ):
            info, image = info_message(camera, stamp), compressed_message(pixels, stamp)
            records.append((f'/{side}/camera_info', info, stamp))
            records.append((f'/{side}/image_raw/compressed', image, stamp))
    records[5][1].data = records[5][1].data[:kept_bytes]
    bag = write_bag(tmp_path / 'bag', records)
    assert reconstruct(bag, tmp_path / 'out') == 1
    assert frames_of(tmp_path / 'out') == 2
    assert '1 of 3 pairs was left out, the first because left image' in capsys.readouterr().err
    summary = json.loads((tmp_path / 'out' / 'summary.json').read_text())
    assert [entry['stamp_ns'] for entry in summary['left_out']] == [START_NS + 1]


def test_images_without_partner_are_counted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    records = [r for i, r in enumerate(stereo_records(6)) if i not in (1, 7, 13)]
    bag = write_bag(tmp_path / 'bag', records)
    assert reconstruct(bag, tmp_path / 'out') == 0
    assert capsys.readouterr().out.endswith('m to infinity; 3 of 9 images have no partner\n')
    assert json.loads((tmp_path / 'out' / 'summary.json').read_text())['unpaired'] == 3
