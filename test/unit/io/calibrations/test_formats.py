# SPDX-License-Identifier: Apache-2.0
"""One rig written in every format reads to the same rig; damaged files are refused."""

from __future__ import annotations

import contextlib
import re
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from binocular_recon.camera import Camera, StereoRig
from binocular_recon.errors import BinocularReconError
from binocular_recon.io.calibration_yaml import read_rig, write_rig
from binocular_recon.io.calibrations.formats._mat_file import read_mat
from binocular_recon.io.calibrations.registry import FORMATS, read_calibration
from binocular_recon.stereo.rectification import Rectifier, rectification_maps
from test.unit.io.calibrations.foreign_files import (
    WRITERS,
    matlab_structure,
    opencv_of_ros,
    opencv_sample,
    true_rig,
)

TRUE = true_rig()
TOKENS = b'.nan 1e999 -1 0 [] {} null 1e308 99999999999999 "x" [[1,2],[3]] - true &a *a 2020-13-45'


def largest_difference_px(rig: StereoRig, true: StereoRig = TRUE) -> float:
    """Return by how much the rectification of two rigs differs."""

    def maps(camera: Camera) -> np.ndarray[tuple[int, ...], np.dtype[np.float32]]:
        return np.stack(rectification_maps(camera))

    pairs = (rig.left, true.left), (rig.right, true.right)
    return max(float(np.abs(maps(one) - maps(other)).max()) for one, other in pairs)


@pytest.mark.parametrize('name', WRITERS)
def test_every_format_is_the_same_rig(name: str, tmp_path: Path) -> None:
    files = WRITERS[name](tmp_path)
    found = read_calibration(files)
    assert largest_difference_px(found.rig) < 1e-3
    assert found.rig.baseline_m == pytest.approx(TRUE.baseline_m, rel=1e-6)
    assert found.format in {one.NAME for one in FORMATS}
    assert f'left camera: {found.names[0]} of ' in found.rig.notices[0]
    Rectifier(found.rig)
    # where --calibration takes it: the folder, or the only file
    for path in (tmp_path, *(files if len(files) == 1 else ())):
        assert largest_difference_px(read_rig(path)) < 1e-3
    write_rig(tmp_path, found.rig)  # beside the others, they come first
    again = read_rig(tmp_path)
    assert again.notices == () and largest_difference_px(again) < 1e-3


@pytest.mark.parametrize('name', WRITERS)
def test_damaged_files_raise_no_other_errors(name: str, tmp_path: Path) -> None:
    files = WRITERS[name](tmp_path)
    files = sorted({*files, *tmp_path.glob('images.txt')})
    whole = [path.read_bytes() for path in files]
    generator = np.random.default_rng(8)
    refused = 0
    for _ in range(30):
        which = int(generator.integers(len(files)))
        data = whole[which]
        at = int(generator.integers(len(data)))
        kind = generator.integers(3)
        if kind == 0:
            data = data[:at]
        elif kind == 1:
            data = data[:at] + generator.bytes(1) + data[at + 1 :]
        else:
            numbers = list(re.finditer(rb'-?[\d.]+(e-?\d+)?', data))
            one = numbers[int(generator.integers(len(numbers)))]
            data = data[: one.start()] + generator.choice(TOKENS.split()) + data[one.end() :]
        files[which].write_bytes(data)
        try:
            read_calibration(files)
        except BinocularReconError:
            refused += 1
        files[which].write_bytes(whole[which])
    assert refused > 5


def test_the_files_of_a_real_rig(shared_data: Path) -> None:
    """EuRoC's own files, and the same rig as other programs wrote it."""
    true = read_rig(shared_data / 'raw_stereo')
    assert true.baseline_m == pytest.approx(0.1101, abs=5e-5)
    folder = shared_data.parent / 'trials' / 'calibrations'
    names = ('opencv_ros_keys', 'opencv_stereo_sample', 'kalibr_camchain.yaml', 'mrcal')
    for name in names if folder.is_dir() else ():
        assert largest_difference_px(read_rig(folder / name), true) < 1e-3


@pytest.mark.parametrize('compressed', [False, True])
def test_mat_files_as_scipy_writes_them(tmp_path: Path, compressed: bool) -> None:
    values = {
        'matrix': np.arange(6.0).reshape(2, 3),
        'one': 3.5,
        'small': np.array([1, 2, 3], np.int16),
        'text': 'millimeters',
        'empty': np.zeros((0, 0)),
        'nested': {'a': {'b': np.eye(2)}, 'long_name_of_a_field': 'x'},
        'cell': np.array([1, 'a'], dtype=object),
    }
    savemat(tmp_path / 'a.mat', values, do_compression=compressed)
    data = (tmp_path / 'a.mat').read_bytes()
    found = read_mat(data)
    assert list(found) == list(values)
    np.testing.assert_array_equal(found['matrix'], values['matrix'])
    assert found['one'] == 3.5 and found['text'] == 'millimeters' and found['cell'] is None
    np.testing.assert_array_equal(found['small'], [[1, 2, 3]])
    np.testing.assert_array_equal(found['nested']['a']['b'], np.eye(2))
    assert found['nested']['long_name_of_a_field'] == 'x' and found['empty'].size == 0
    generator = np.random.default_rng(2)
    for _ in range(200):
        at = int(generator.integers(126, len(data)))
        with contextlib.suppress(ValueError):
            read_mat(data[:at] + generator.bytes(2) + data[at + 2 :])
        with contextlib.suppress(ValueError):
            read_mat(data[:at])


def test_second_order_of_matlab_is_the_other_way_round(tmp_path: Path) -> None:
    """Camera 1 may be the right one: the pose says so."""
    savemat(tmp_path / 'rig.mat', {'s': matlab_structure(new=False, order=(1, 0))})
    found = read_calibration([tmp_path / 'rig.mat'])
    assert found.names == ('camera 2', 'camera 1')
    assert largest_difference_px(found.rig) < 1e-3


def test_exchanged_files_are_put_in_order(tmp_path: Path) -> None:
    """By R and P of camera files whose names do not say which is left."""
    paths = opencv_of_ros(tmp_path, ('a', 'b'))
    found = read_calibration(paths[::-1])
    assert found.names == ('a', 'b')
    assert largest_difference_px(found.rig) < 1e-3


def test_the_image_size_of_the_sample_is_found(tmp_path: Path) -> None:
    rig = read_calibration(opencv_sample(tmp_path)).rig
    assert rig.left.size == (752, 480)
    assert any('752x480 px is that which P1 and P2 were made for' in text for text in rig.notices)
    # one of the two files names the other
    assert largest_difference_px(read_rig(tmp_path / 'extrinsics.yml')) < 1e-3
