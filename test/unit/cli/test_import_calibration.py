# SPDX-License-Identifier: Apache-2.0
"""``import-calibration``: the files that it writes, what it says, and its exit statuses."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from binocular_recon.cli.main import main
from binocular_recon.io.calibration_yaml import read_rig
from test.unit.io.calibrations.foreign_files import kalibr, mrcal, opencv_sample, true_rig


def run(*words: object) -> int:
    return main(['import-calibration', *map(str, words)])


def test_the_files_and_what_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    output = tmp_path / 'new' / 'rig'
    assert run(*mrcal(tmp_path), '--output', output) == 0
    said = capsys.readouterr()
    assert said.out == (
        f'{output}: calibration of mrcal, left is the left camera, right the right one; baseline'
        ' 0.9109 m, focal lengths left 458.65 and 457.30 px, right 462.59 and 459.13 px, rectified'
        f' {true_rig().focal_px:.2f} px; images of 752x480 px\n'
    )
    assert 'left camera: left of' in said.err and 'as their names say' in said.err
    rig = read_rig(output)
    np.testing.assert_allclose(rig.right.P, true_rig().right.P, atol=1e-4)
    # a second one takes its place
    assert run(tmp_path / 'left.cameramodel', tmp_path / 'right.cameramodel', '--baseline', '2',
               '--output', output) == 0  # fmt: skip
    assert read_rig(output).baseline_m == pytest.approx(2.0)
    assert read_rig(output / 'previous').baseline_m == pytest.approx(rig.baseline_m)


def test_what_the_files_leave_open(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def without_size(chain: dict[str, dict[str, object]]) -> None:
        for camera in chain.values():
            del camera['resolution']

    words = [*kalibr(tmp_path, without_size), '--output', tmp_path]
    assert run(*words) == 1
    assert 'the image size is missing (Kalibr); state it with' in capsys.readouterr().err
    assert run(*words, '--image-size', '752x480', '--cameras', 'cam1,cam0') == 0
    assert 'cam0 is the left camera, cam1 the right one' in capsys.readouterr().out
    assert run(*words, '--image-size', '752x480', '--baseline', '50') == 0
    assert 'warning: the baseline is 50 m, outside 0.01 to 20 m' in capsys.readouterr().err


@pytest.mark.parametrize(
    ('words', 'status', 'message'),
    [
        (['--cameras', 'cam0'], 2, '--cameras takes two names such as cam0,cam1, got 1'),
        (['--image-size', 'large'], 2, '--image-size must be WxH'),
        (['--cameras', 'camera 1,cam9'], 1, "has no camera 'cam9'"),
    ],
)
def test_wrong_words(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], words: list[str], status: int, message: str
) -> None:
    (tmp_path / 'rig').write_text('')
    assert run(*opencv_sample(tmp_path), '--output', tmp_path / 'rig', *words) == status
    assert message in capsys.readouterr().err


def test_names_of_cameras_do_not_steer_the_terminal(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    left, right = mrcal(tmp_path)
    left = left.rename(tmp_path / '\x1b[2Jleft.cameramodel')
    assert run(left, right, '--output', tmp_path / 'rig') == 0
    said = capsys.readouterr()
    assert '\\x1b[2Jleft is the left camera' in said.out and '\x1b' not in said.out + said.err
