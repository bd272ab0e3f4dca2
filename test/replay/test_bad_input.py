# SPDX-License-Identifier: Apache-2.0
"""``reconstruct`` on input that is wrong, damaged or interrupted: status, words, what is kept."""

from __future__ import annotations

import errno
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from binocular_recon.apps import output_folder as results
from binocular_recon.cli.main import main
from binocular_recon.io.ply import write_ply
from test.bag_tools import (
    HEIGHT,
    START_NS,
    WIDTH,
    compressed_message,
    image_message,
    info_message,
    pictures,
    rig,
    stereo_records,
    write_bag,
)

# The test pictures have 6 px of disparity; a small range is quick.
RANGE = ['--disparity-range', '16']
IMAGES = ['--left-image', '/left/image_raw', '--right-image', '/right/image_raw']
INFOS = ['--left-info', '/left/camera_info', '--right-info', '/right/camera_info']


def reconstruct(bag: Path, output: Path, *words: str) -> int:
    return main(['reconstruct', str(bag), '--output', str(output), *RANGE, *words])


def frames_of(output: Path) -> int:
    """Return the number of frames, each with all its files and an entry in the summary."""
    summary = json.loads((output / 'summary.json').read_text())
    count = len(summary['frames'])
    names = {
        f'{i:06d}{ending}'
        for i in range(count)
        for ending in ('.ply', '_disparity.pfm', '_disparity.png')
    }
    assert {path.name for path in output.iterdir()} == names | {'summary.json'}
    assert [frame['index'] for frame in summary['frames']] == list(range(count))
    return count


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


def unsynchronised(folder: Path) -> Path:
    records = stereo_records(3)
    for topic, message, _ in records:
        if topic == '/right/image_raw':
            message.header.stamp.nanosec += 3_000_000
    return write_bag(folder / 'bag', records)


def wrong_size(folder: Path) -> Path:
    records = stereo_records(2)
    small = pictures(0, (HEIGHT - 8, WIDTH))[0]
    records[1] = (records[1][0], image_message(small, START_NS), START_NS)
    records[5] = (records[5][0], image_message(small, START_NS + 10**8), START_NS + 10**8)
    return write_bag(folder / 'bag', records)


def odd_encoding(folder: Path) -> Path:
    records = stereo_records(1)
    records[1][1].encoding = 'infrared9'
    return write_bag(folder / 'bag', records)


@pytest.mark.parametrize(
    ('make', 'message'),
    [
        (missing, 'gone does not exist; check the path'),
        (garbage, 'noise.mcap is no bag: it begins with'),
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
    text = capsys.readouterr().err
    assert text.startswith('binocular_recon reconstruct: ')
    assert text.count('\n') == 1
    assert message in text


def test_stamps_apart_are_paired_when_allowed(tmp_path: Path) -> None:
    words = ['--approximate-sync-tolerance-seconds', '0.004']
    assert reconstruct(unsynchronised(tmp_path), tmp_path / 'out', *words) == 0
    assert frames_of(tmp_path / 'out') == 3


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
    assert 'bag.db3 is damaged (database disk image is malformed); what precedes' in text
    assert text.endswith(f'{count} frames are in {tmp_path / "out"}\n')
    summary = json.loads((tmp_path / 'out' / 'summary.json').read_text())
    assert summary['finished'] is True
    assert len(summary['damage']) >= 1


@pytest.mark.parametrize('kept_bytes', [0, 2000])
def test_a_cut_picture_costs_one_frame(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], kept_bytes: int
) -> None:
    records = []
    for index in range(3):
        stamp = START_NS + index
        for side, camera, picture in zip(
            ('left', 'right'), (rig().left, rig().right), pictures(index), strict=True
        ):
            info, image = info_message(camera, stamp), compressed_message(picture, stamp)
            records.append((f'/{side}/camera_info', info, stamp))
            records.append((f'/{side}/image_raw/compressed', image, stamp))
    records[5][1].data = records[5][1].data[:kept_bytes]
    bag = write_bag(tmp_path / 'bag', records)
    assert reconstruct(bag, tmp_path / 'out') == 1
    assert frames_of(tmp_path / 'out') == 2
    assert '1 of 3 pairs are left out, the first because left image' in capsys.readouterr().err
    summary = json.loads((tmp_path / 'out' / 'summary.json').read_text())
    assert [entry['stamp_ns'] for entry in summary['left_out']] == [START_NS + 1]


def test_an_output_that_cannot_be_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = write_bag(tmp_path / 'bag', stereo_records(1))
    (tmp_path / 'file').write_text('')
    assert reconstruct(bag, tmp_path / 'file' / 'out') == 1
    assert 'file/out cannot be made: Not a directory; choose another' in capsys.readouterr().err


@pytest.mark.skipif(not Path('/dev/full').exists(), reason='needs /dev/full')
def test_a_full_disk_keeps_the_finished_frames(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    bag, output = write_bag(tmp_path / 'bag', stereo_records(3)), tmp_path / 'out'
    assert reconstruct(bag, output) == 0
    old = (output / '000001.ply').read_bytes(), (output / '000002.ply').read_bytes()

    def find_no_space(path: Path, *arguments: Any) -> int:
        if path.name == '000001.ply':
            path.with_name(f'.{path.name}.{os.getpid()}.part').symlink_to('/dev/full')
        return write_ply(path, *arguments)

    monkeypatch.setattr(results, 'write_ply', find_no_space)
    assert reconstruct(bag, output) == 1
    assert 'No space left on device; free some space' in capsys.readouterr().err
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
    assert reconstruct(bag, output, '--pictures') == 0
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


def test_pictures_without_partner_are_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    records = [r for i, r in enumerate(stereo_records(6)) if i not in (1, 7, 13)]
    bag = write_bag(tmp_path / 'bag', records)
    assert reconstruct(bag, tmp_path / 'out') == 0
    assert capsys.readouterr().out.endswith('s per frame; 3 of 9 pictures have no partner\n')
    assert json.loads((tmp_path / 'out' / 'summary.json').read_text())['unpaired'] == 3


def test_a_disk_that_became_read_only_is_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(path: Path, *_args: object, **_options: object) -> None:
        raise OSError(errno.EROFS, os.strerror(errno.EROFS), str(path))

    bag = write_bag(tmp_path / 'bag', stereo_records(1))
    monkeypatch.setattr(Path, 'replace', fail)
    monkeypatch.setattr(Path, 'unlink', fail)
    assert reconstruct(bag, tmp_path / 'out') == 1
    said = capsys.readouterr().err
    assert '000000_disparity.pfm cannot be written: Read-only file system; choose a fold' in said


def test_an_interruption_keeps_the_finished_frames(tmp_path: Path) -> None:
    bag, output = write_bag(tmp_path / 'bag', stereo_records(400)), tmp_path / 'out'
    words = ['reconstruct', str(bag), '--output', str(output), *RANGE]
    command = [sys.executable, '-m', 'binocular_recon', *words]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 60
    last = output / '000002_disparity.png'  # of a frame's files
    while not last.exists() and time.monotonic() < deadline:
        time.sleep(0.01)
    time.sleep(0.003)
    process.send_signal(signal.SIGINT)
    out, error = process.communicate(timeout=30)
    assert process.returncode == 130, error
    count = frames_of(output)
    assert 3 <= count < 400
    expected = f'interrupted; {count} finished frames are kept in {output}\n'
    assert error == f'binocular_recon reconstruct: {expected}'
    assert out == ''
    assert json.loads((output / 'summary.json').read_text())['finished'] is False


@pytest.mark.parametrize(
    ('words', 'message'),
    [
        (['--left-image', '/a'], '--left-image and --right-image belong together'),
        (['--left-info', '/a'], '--left-info and --right-info belong together'),
        (['--alpha', '3'], 'alpha must be -1'),
        (INFOS, '--left-info and --right-info without --left-image and --right-image say nothing'),
        (['--no-rectified'], '--rectified without --left-image and --right-image say nothing'),
        ([*IMAGES, '--namespace', 'rig'], '--namespace looks for the topics that --left-image'),
        ([*IMAGES, *INFOS, '--calibration', 'rig'], '--calibration replaces what --left-info'),
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
    bag = write_bag(tmp_path / 'bag', stereo_records(1, '/odd', image='picture'))
    words = ['--left-image', '/odd/left/picture', '--right-image', '/odd/right/picture']
    assert reconstruct(bag, tmp_path / 'out', *words) == 0
    summary = json.loads((tmp_path / 'out' / 'summary.json').read_text())
    assert summary['source']['infos'] == ['/odd/left/camera_info', '/odd/right/camera_info']
    assert summary['source']['rectified'] is False
