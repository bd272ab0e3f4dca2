# SPDX-License-Identifier: Apache-2.0
"""Saving a calibration: complete or not at all, the one before is kept."""

from __future__ import annotations

import json
from collections.abc import Callable
from datetime import datetime, timedelta, timezone
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from binocular_recon.calibration.session import calibration_files
from binocular_recon.calibration.session.calibration_files import (
    FILES,
    finish_saving,
    save_calibration,
    save_rig,
)
from binocular_recon.errors import CalibrationError, FileError
from binocular_recon.io.calibration_yaml import read_camera, read_rig
from binocular_recon.stereo.point_covariance import joint_covariance
from test.calibration_tools import solved


def contents(folder: Path) -> dict[str, bytes]:
    return {name: (folder / name).read_bytes() for name in FILES}


def test_files_hold_the_calibration(tmp_path: Path) -> None:
    result = solved(0.005)
    files = save_calibration(result, tmp_path / 'new' / 'rig', ('cam_l', 'cam_r'))
    assert [path.name for path in files] == list(FILES)
    rig = read_rig(tmp_path / 'new' / 'rig')
    np.testing.assert_array_equal(rig.left.K, result.calibration.K_left)
    np.testing.assert_array_equal(rig.right.P, result.rig.right.P)
    assert rig.baseline_m == pytest.approx(result.calibration.baseline_m)
    assert 'camera_name: cam_r' in (tmp_path / 'new' / 'rig' / 'right.yaml').read_text()
    content = json.loads((tmp_path / 'new' / 'rig' / 'calibration.json').read_text())
    assert content['baseline_m'] == result.calibration.baseline_m
    age = datetime.now(timezone.utc) - datetime.fromisoformat(content['date'])
    assert timedelta(0) <= age + timedelta(seconds=1) < timedelta(hours=1)
    assert sorted(path.name for path in (tmp_path / 'new' / 'rig').iterdir()) == sorted(FILES)


def test_the_covariance_comes_back(tmp_path: Path) -> None:
    result = solved(0.005)
    save_calibration(result, tmp_path)
    content = json.loads((tmp_path / 'calibration.json').read_text())
    assert content['parameters'] == list(result.calibration.parameters)
    known = read_rig(tmp_path).covariance
    assert known is not None and result.rig.covariance is not None
    assert known.parameters == result.calibration.parameters
    np.testing.assert_array_equal(known.matrix, result.rig.covariance.matrix)
    free = result.estimate.problem.free
    np.testing.assert_array_equal(known.matrix[np.ix_(free, free)], result.estimate.covariance)
    assert not known.matrix[~free].any() and not known.matrix[:, ~free].any()
    # a point of the cloud is as uncertain as the calibration says
    points = np.array([[0.0, 0.0, 15.0], [1.5, 0.5, 15.0]])
    sigma = np.sqrt(joint_covariance(points, read_rig(tmp_path))[[0, 1], 2, [0, 1], 2])
    assert sigma == pytest.approx(result.depth_sigma_m(15.0, 0.0), rel=0.3)


def test_a_folder_without_covariance_is_a_calibration_without_it(tmp_path: Path) -> None:
    save_calibration(solved(0.005), tmp_path)
    path = tmp_path / 'calibration.json'
    content = json.loads(path.read_text())
    del content['covariance']  # as written by earlier versions
    path.write_text(json.dumps(content))
    assert read_rig(tmp_path).covariance is None
    path.unlink()
    assert read_rig(tmp_path).covariance is None


def _without_a_row(content: dict[str, Any]) -> None:
    content['covariance'].pop()


def _other_camera(content: dict[str, Any]) -> None:
    content['left']['K'][0][0] += 1.0


def _other_lens(content: dict[str, Any]) -> None:
    content['right']['D'] = [0.0] * 4


def _text(content: dict[str, Any]) -> None:
    content['covariance'][0][0] = 'many'


def _no_names(content: dict[str, Any]) -> None:
    del content['parameters']


@pytest.mark.parametrize(
    ('change', 'reason'),
    [
        (_without_a_row, 'rows and columns'),
        (_other_camera, r'the left camera is not that of left\.yaml'),
        (_other_lens, r'the right camera is not that of right\.yaml'),
        (_text, "covariance must hold finite numbers, got 'many'"),
        (_no_names, 'parameters must be a list of names'),
    ],
)
def test_a_covariance_that_does_not_fit_is_refused(
    tmp_path: Path, change: Callable[[dict[str, Any]], None], reason: str
) -> None:
    save_calibration(solved(0.005), tmp_path)
    path = tmp_path / 'calibration.json'
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))
    with pytest.raises(CalibrationError, match=reason) as error:
        read_rig(tmp_path)
    assert str(error.value).startswith(str(path))


@pytest.mark.parametrize('text', ['', '{', '[' * 100_000, '\x00'])
def test_a_damaged_calibration_json_is_refused(tmp_path: Path, text: str) -> None:
    save_calibration(solved(0.005), tmp_path)
    (tmp_path / 'calibration.json').write_text(text)
    with pytest.raises(FileError, match=r'is not valid JSON: .*delete it to go on'):
        read_rig(tmp_path)


def test_the_calibration_before_is_kept(tmp_path: Path) -> None:
    save_calibration(solved(0.0), tmp_path)
    before = contents(tmp_path)
    save_calibration(solved(0.005), tmp_path)
    assert contents(tmp_path / 'previous') == before
    assert contents(tmp_path) != before


def test_a_rig_from_elsewhere_takes_the_place_of_a_calibration(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without covariance and report, which stay with the calibration that they belong to."""
    save_calibration(solved(0.0), tmp_path)
    before = contents(tmp_path)
    rig = solved(0.005).rig

    replace = Path.replace

    def interrupted(self: Path, target: Path) -> Path:
        if target.parent.name == 'previous':
            raise KeyboardInterrupt
        return replace(self, target)

    with monkeypatch.context() as patch:
        patch.setattr(Path, 'replace', interrupted)
        with pytest.raises(KeyboardInterrupt):
            save_rig(rig, tmp_path)
    for _ in range(2):  # while its files wait for their places, and after
        read = read_rig(tmp_path)
        np.testing.assert_array_equal(read.left.P, rig.left.P)
        assert read.covariance is None
        finish_saving(tmp_path)
    assert contents(tmp_path / 'previous') == before
    names = sorted(path.name for path in tmp_path.iterdir())
    assert names == ['left.yaml', 'previous', 'right.yaml']
    save_calibration(solved(0.005), tmp_path)
    assert read_rig(tmp_path).covariance is not None


@pytest.mark.parametrize('after', range(9))
def test_an_interruption_leaves_one_whole_calibration(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, after: int
) -> None:
    """Stop before each step that changes names in the folder, as a power cut would."""
    monkeypatch.setattr(calibration_files, 'render_report', lambda *_: 'short')  # takes a while
    save_calibration(solved(0.0), tmp_path)
    before = contents(tmp_path)
    steps = 0

    def interrupted(original: object) -> object:
        def step(self: Path, target: Path) -> object:
            nonlocal steps
            if target.parent == tmp_path or target.parent.name == 'previous':
                steps += 1
                if steps > after:
                    raise KeyboardInterrupt
            return original(self, target)  # type: ignore[operator]

        return step

    with monkeypatch.context() as patch:
        patch.setattr(Path, 'replace', interrupted(Path.replace))
        patch.setattr(Path, 'rename', interrupted(Path.rename))
        with pytest.raises(KeyboardInterrupt):
            save_calibration(solved(0.005), tmp_path)
    # as readers see it before anybody finishes the saving
    last, read = solved(0.0 if after == 0 else 0.005).rig, read_rig(tmp_path)
    np.testing.assert_array_equal(read.left.P, last.left.P)
    np.testing.assert_array_equal(read.right.P, last.right.P)
    finish_saving(tmp_path)
    now = contents(tmp_path)
    if after == 0:
        assert now == before
    else:
        assert contents(tmp_path / 'previous') == before
        expected = solved(0.005).rig.left, solved(0.005).rig.right
        new = read_camera(tmp_path / 'left.yaml'), read_camera(tmp_path / 'right.yaml')
        for camera, true in zip(new, expected, strict=True):
            np.testing.assert_array_equal(camera.P, true.P)
    save_calibration(solved(0.005), tmp_path)
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted((*FILES, 'previous'))


def test_a_full_disk_harms_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    save_calibration(solved(0.0), tmp_path)
    before = contents(tmp_path)

    def full(*_: object) -> None:
        raise FileError('no space')

    monkeypatch.setattr(calibration_files, 'write_json', full)
    with pytest.raises(FileError, match='no space'):
        save_calibration(solved(0.005), tmp_path)
    assert contents(tmp_path) == before


def test_a_folder_that_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / 'file').write_text('')
    with pytest.raises(FileError, match='cannot be made'):
        save_calibration(solved(0.0), tmp_path / 'file' / 'rig')


def test_a_file_in_the_way_is_named(tmp_path: Path) -> None:
    save_calibration(solved(0.0), tmp_path / 'rig')
    (tmp_path / 'rig' / 'previous').write_text('')
    with pytest.raises(FileError, match=r'cannot be saved in .* the one before is unharmed'):
        save_calibration(solved(0.005), tmp_path / 'rig')
