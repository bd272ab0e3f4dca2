# SPDX-License-Identifier: Apache-2.0
"""Files that are no calibration, or made to harm, are refused soon and in words."""

from __future__ import annotations

import gzip
import os
from pathlib import Path

import pytest
import yaml

from binocular_recon.errors import CalibrationError, FileError
from binocular_recon.io.calibration_yaml import read_rig
from binocular_recon.io.calibrations.registry import read_calibration
from test.unit.io.calibrations.foreign_files import (
    SIZE,
    colmap,
    kalibr,
    opencv_one_file,
)

BOMB = ''.join(
    f'{name}: &{name} [{f"*{before}," * 9}]\n'
    for before, name in zip('abcdefgh', 'bcdefghi', strict=True)
)


@pytest.mark.parametrize(
    ('name', 'text', 'message'),
    [
        ('deep.yaml', '[' * 2_000, 'nested too deeply'),
        ('deep.json', '[' * 100_000, 'nested too deeply'),
        ('deep.xml', f'<opencv_storage>{"<a>" * 9999}{"</a>" * 9999}</opencv_storage>', 'nested'),
        ('deep.cameramodel', '{"lensmodel": ' + '[' * 100_000, 'read as a Python dictionary'),
        ('endless.yaml', 'cam0: {intrinsics: &a [*a]}', 'stand for more than'),
        ('bomb.yaml', f'a: &a [1, 1, 1, 1, 1, 1, 1]\n{BOMB}', 'stand for more than'),
        ('merge.yaml', 'a: &a {<<: [*a, *a]}', 'not a camera file'),
        ('many.json', '[' + '[],' * 300_000 + '1]', 'has more than 500000 values'),
        ('entities.xml', '<!DOCTYPE a [<!ENTITY b "c">]><document/>', 'declares entities'),
        ('object.yaml', '!!python/object/apply:os.getcwd []', 'could not determine a constructor'),
        ('date.yaml', 'M1: 2020-13-45', 'month must be in'),
        ('key.yaml', '? [a]\n: 1\n', 'unhashable key'),
        ('notes.yaml', 'camera: mine\nfocal: 5', r'in notes\.yaml \(it has camera, focal\);'),
        ('empty.yaml', '', r'no calibration is found in empty\.yaml; ROS camera info .* are read'),
        ('a.txt', 'hello', r"no calibration is found in a\.txt \(it begins with 'hello'\);"),
        (
            'zed.conf',
            '[LEFT_CAM_HD]\nfx=5',
            r"zed\.conf \(it begins with '\[LEFT_CAM_HD\]'\); ROS",
        ),
        ('ost.ini', '# oST\n[image]\n\nwidth\n640', r'ost\.ini \(it has image_width\);'),
        (
            'K.npz',
            'PK\x03\x04',
            r'no calibration is found in K\.npz \(it is no text\); .* are read',
        ),
    ],
)
def test_hostile_and_unknown_files(tmp_path: Path, name: str, text: str, message: str) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(CalibrationError, match=message):
        read_rig(tmp_path / name)


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(FileError, match=r'nowhere\.yaml cannot be read: No such file'):
        read_rig(tmp_path / 'nowhere.yaml')
    large = tmp_path / 'large.yaml'
    large.write_text('a: [' + '1, ' * 400_000)
    with pytest.raises(FileError, match='has more than 1 MB, the limit of such files'):
        read_rig(large)
    packed = tmp_path / 'packed.yml.gz'
    packed.write_bytes(gzip.compress(bytes(65 << 20)))
    with pytest.raises(FileError, match='has more than 64 MB'):
        read_rig(packed)
    packed.write_bytes(gzip.compress(b'a: 1')[:-9])
    with pytest.raises(FileError, match=r'cannot be read: (Compressed file|Error)'):
        read_rig(packed)
    (tmp_path / 'text.yaml').write_bytes('a: 1'.encode('utf-16'))
    with pytest.raises(FileError, match='byte 0 is not UTF-8'):
        read_rig(tmp_path / 'text.yaml')


def test_several_formats_and_left_over_files(tmp_path: Path) -> None:
    files = [*kalibr(tmp_path), *opencv_one_file(tmp_path)]
    with pytest.raises(
        CalibrationError,
        match=r'several formats: camchain.yaml \(Kalibr\); stereo.yaml \(OpenCV\)',
    ):
        read_rig(tmp_path)
    (tmp_path / 'notes.yaml').write_text('a: 1')
    (tmp_path / 'broken.yaml').write_text('[')
    files[1].unlink()
    assert read_rig(tmp_path).left.size == SIZE  # other files of a folder do not matter
    with pytest.raises(
        CalibrationError, match=r'notes\.yaml is no part of a calibration of Kalibr'
    ):
        read_calibration([files[0], tmp_path / 'notes.yaml'])
    with pytest.raises(CalibrationError, match=r'broken\.yaml is not a camera file'):
        read_calibration([files[0], tmp_path / 'broken.yaml'])
    second = tmp_path / 'other.yaml'
    second.write_text(yaml.safe_dump(yaml.safe_load(files[0].read_text())))
    with pytest.raises(CalibrationError, match='two calibrations of Kalibr; give one'):
        read_calibration([files[0], second])


def test_points_of_an_image_without_an_end(tmp_path: Path) -> None:
    """Which a file of the disk's holes costs nothing."""
    cameras = colmap(tmp_path)[0]
    images = cameras.with_name('images.txt')
    os.truncate(images, 1 << 38)
    with pytest.raises(CalibrationError, match=r'images\.txt: line \d+ has more than 64 MB'):
        read_rig(cameras.parent)
