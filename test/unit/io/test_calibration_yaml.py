# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml

from binocular_recon.camera import Camera, StereoRig
from binocular_recon.errors import CalibrationError, FileError
from binocular_recon.io.calibration_yaml import read_camera, read_rig, write_camera, write_rig

# As camera_calibration writes it.
FILE = """\
image_width: 640
image_height: 480
camera_name: narrow_stereo/left
camera_matrix:
  rows: 3
  cols: 3
  data: [438.783367, 0.000000, 305.593336, 0.000000, 437.302876, 243.738352, 0., 0., 1.]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [-0.361976, 0.110510, 1e-05, 0.000506, 0.000000]
rectification_matrix:
  rows: 3
  cols: 3
  data: [1, 0, 0, 0, 1, 0, 0, 0, 1]
projection_matrix:
  rows: 3
  cols: 4
  data: [393.653800, 0.0, 322.797939, 0.0, 0.0, 393.653800, 241.090902, 0, 0, 0, 1, 0]
"""


def random_rig() -> StereoRig:
    generator = np.random.default_rng(5)
    noise = generator.normal(size=(2, 3)) / 3
    noise[0, 1] = noise[1, 0] = 0
    K = np.array([[500, 0, 320], [0, 501, 240], [0, 0, 1]]) + np.pad(noise, ((0, 1), (0, 0)))
    rotation = np.linalg.qr(generator.normal(size=(3, 3)))[0]
    P = np.hstack([K, np.zeros((3, 1))])
    right = P.copy()
    right[0, 3] = -np.pi * 100
    D = generator.normal(size=5) * 1e-5
    return StereoRig(Camera(640, 480, K, D, rotation, P), Camera(640, 480, K, D, rotation, right))


def test_file_of_camera_calibration(tmp_path: Path) -> None:
    (tmp_path / 'left.yaml').write_text(FILE)
    camera = read_camera(tmp_path / 'left.yaml')
    assert camera.size == (640, 480) and camera.distortion_model == 'plumb_bob'
    np.testing.assert_allclose(camera.D, [-0.361976, 0.110510, 1e-5, 0.000506, 0])
    assert camera.K[1, 1] == 437.302876 and camera.P[0, 2] == 322.797939


def test_every_digit_comes_back(tmp_path: Path) -> None:
    rig = random_rig()
    write_rig(tmp_path, rig, ('cam_l', 'cam_r'))
    again = read_rig(tmp_path)
    for camera, copy in ((rig.left, again.left), (rig.right, again.right)):
        for key in 'KDRP':
            np.testing.assert_array_equal(getattr(copy, key), getattr(camera, key))
    content = yaml.safe_load((tmp_path / 'right.yaml').read_text())
    assert content['camera_name'] == 'cam_r'
    shapes = {key: (value['rows'], value['cols']) for key, value in content.items() if 'ix' in key}
    assert shapes == {
        'camera_matrix': (3, 3),
        'rectification_matrix': (3, 3),
        'projection_matrix': (3, 4),
    }
    assert content['distortion_coefficients']['cols'] == 5
    # small numbers are numbers to every YAML reader
    assert all(isinstance(value, float) for value in content['distortion_coefficients']['data'])


@pytest.mark.parametrize(
    ('old', 'new', 'message'),
    [
        ('image_width: 640', '', r'left\.yaml is not a camera file .*: it lacks image_width;'),
        ('[393.653800', '[what', r'left\.yaml is not a camera file .*what'),
        ('data: [438.783367, 0.000000,', 'data: [438.783367,', 'K must have 9 values, got 8'),
        ('plumb_bob', 'fov', "distortion model 'fov' is not one of plumb_bob"),
        (
            'image_width: 640',
            'image_width: 640.5',
            'image_width must be a whole number, got 640.5',
        ),
        ('cols: 4\n  data', 'cols: 4\n  date', 'it lacks data of projection_matrix'),
        ('  data: [438', '  data: [[[438', 'not a camera file: while parsing'),
        (FILE, '[1, 2]', 'not a camera file as camera_calibration_parsers writes it'),
    ],
)
def test_bad_file(tmp_path: Path, old: str, new: str, message: str) -> None:
    (tmp_path / 'left.yaml').write_text(FILE.replace(old, new))
    with pytest.raises(CalibrationError, match=message):
        read_camera(tmp_path / 'left.yaml')


def test_missing_file(tmp_path: Path) -> None:
    with pytest.raises(FileError, match=r'left\.yaml cannot be read: No such file'):
        read_rig(tmp_path)
    (tmp_path / 'left.yaml').write_bytes(b'\xff\xfe\xfd')
    with pytest.raises(FileError, match=r'cannot be read: byte 0 is not UTF-8'):
        read_camera(tmp_path / 'left.yaml')


def test_file_that_cannot_be_written(tmp_path: Path) -> None:
    with pytest.raises(FileError, match=r'nowhere.* cannot be written: No such file'):
        write_camera(tmp_path / 'nowhere' / 'left.yaml', random_rig().left, 'left')
