# SPDX-License-Identifier: Apache-2.0
"""``calibrate`` from images and from points, with images that cannot be used."""

from __future__ import annotations

import json
import re
import shutil
from base64 import b64decode
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml

from binocular_recon.calibration.rectification.metric_rectification import metric_rig
from binocular_recon.calibration.session.captures import find_boards, read_board, read_captures
from binocular_recon.calibration.target.rods import save_rods
from binocular_recon.cli.main import main
from binocular_recon.evaluation.calibration import self_check as calibration_check
from binocular_recon.evaluation.calibration.self_check import (
    AccuracyRow,
    RowsRow,
    true_calibration,
)
from binocular_recon.io.calibration_yaml import read_rig, write_camera
from binocular_recon.rotations import rotation
from binocular_recon.simulation.capture import CaptureOptions, simulate_capture
from binocular_recon.simulation.rig import survey_rig
from binocular_recon.simulation.rods import paper_board
from test.calibration_tools import CHESSBOARD

BOARD = paper_board(0.002)
# half the size of the survey rig's images, so boards stand at half the distance
RIG = survey_rig(scale=0.5)
OPTIONS = CaptureOptions(depth_m=(3.0, 8.0))


@pytest.fixture(scope='module')
def images(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Five good boards and one for each reason to leave a board out."""
    folder = tmp_path_factory.mktemp('captures')

    def save(name: str, left: np.ndarray[Any, Any], right: np.ndarray[Any, Any]) -> None:
        cv2.imwrite(str(folder / f'left_{name}.png'), left)
        cv2.imwrite(str(folder / f'right_{name}.png'), right)

    taken = [
        simulate_capture(BOARD, RIG, np.random.default_rng([7, index]), OPTIONS)
        for index in range(8)
    ]
    for index, capture in enumerate(taken[:5]):
        save(f'{index}', capture.left, capture.right)
    save('blurred', *(cv2.blur(image, (41, 41)) for image in (taken[5].left, taken[5].right)))
    save('moved', taken[5].left, taken[6].right)
    save('swapped', taken[7].right, taken[7].left)
    (folder / 'left_5.png').write_bytes(b'not an image')
    cv2.imwrite(str(folder / 'right_5.png'), np.zeros((600, 960), np.uint8))
    cv2.imwrite(str(folder / 'left_6.png'), np.zeros((600, 960), np.uint8))
    for side, size in (('left', (480, 640)), ('right', (600, 960))):
        cv2.imwrite(str(folder / f'{side}_7.png'), np.zeros(size, np.uint8))
    cv2.imwrite(str(folder / 'left_8.png'), np.zeros((600, 960), np.uint8))
    cv2.imwrite(str(folder / 'right_8.png'), np.zeros((600, 960), np.uint8))
    (folder / 'notes.txt').write_text('not a board')
    save_rods(BOARD, folder / 'rods.yaml')
    return folder


def calibrate(*args: object) -> int:
    return main(['calibrate', *map(str, args)])


@pytest.mark.long
def test_images_to_a_calibrated_rig(
    images: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / 'rig'
    assert calibrate(images, '--rods', images / 'rods.yaml', '--output', output) == 0
    text = capsys.readouterr().out
    content = json.loads((output / 'calibration.json').read_text())
    assert [board['name'] for board in content['boards']] == list('01234')
    reasons = {board['name']: board['reason'] for board in content['rejected']}
    assert 'left_5.png is not an image' in reasons['5']
    assert reasons['6'] == 'there is no right image'
    assert '640x480' in reasons['7'] and '960x600' in reasons['7']
    assert 'no board found' in reasons['8']
    assert 'rods were moved in between' in reasons['moved']
    assert 'left and right image are exchanged' in reasons['swapped']
    assert 'blurred' in reasons
    assert all(f'left out: {name}: ' in text for name in reasons)
    pattern = r'^12 boards in [\d.]+ s: marks [\d.]+ s, calibration [\d.]+ s, report [\d.]+ s'
    assert re.search(pattern, text, re.MULTILINE)
    if Path('/proc/self/status').exists():
        (peak_mb,) = re.findall(r'at most (\d+) MB of memory', text)
        assert 50 < int(peak_mb) < 8000
    rig = read_rig(output)
    assert rig.left.size == (960, 600)
    assert abs(rig.baseline_m - 1.0) < 4 * content['sigma']['baseline_m']
    error = rig.left.K[0, 0] - RIG.left.K[0, 0]
    assert abs(error) < 4 * content['sigma']['fx_left_px']
    _check_images((output / 'report.html').read_text(), content)


@pytest.mark.long
def test_an_old_calibration_is_checked_with_new_boards(
    images: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It holds, whatever one bad board says, until a camera turns."""
    for side in ('left', 'right'):
        for name in ('0', '1', 'moved'):
            shutil.copy(images / f'{side}_{name}.png', tmp_path)
    (tmp_path / 'rig').mkdir()
    rig = metric_rig(true_calibration(RIG))
    for side, camera in (('left', rig.left), ('right', rig.right)):
        write_camera(tmp_path / 'rig' / f'{side}.yaml', camera, side)
    args = tmp_path, '--rods', images / 'rods.yaml', '--check', tmp_path / 'rig'
    assert calibrate(*args) == 0
    text = capsys.readouterr().out
    assert 'left out: moved: its rows or lengths differ from those of most boards' in text
    assert text.startswith('2 boards, ') or '\n2 boards, ' in text
    assert text.endswith('the calibration holds\n')


def _check_images(report: str, content: dict[str, Any]) -> None:
    """Every board with a readable image is shown, the marks of those used in green."""
    assert '<svg' in report
    figures = dict(
        re.findall(r'<img [^>]*alt="Board (\w+)" src="data:image/jpeg;base64,([^"]+)"', report)
    )
    assert set(figures) == {*'012345678', 'blurred', 'moved', 'swapped'}
    image = cv2.imdecode(np.frombuffer(b64decode(figures['0']), np.uint8), cv2.IMREAD_COLOR)
    assert image.shape == (400, 1280, 3)
    blue, green, red = image.astype(int).transpose(2, 0, 1)
    vivid = (green > blue + 60) & (green > red + 60)
    # a circle 5 px in radius and 2 px thick around each mark of both images
    assert vivid.sum() > 40 * content['boards'][0]['marks']


@pytest.mark.long
def test_chessboard_points(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert calibrate('--points', CHESSBOARD, '--output', tmp_path) == 0
    assert 'assumed to be 640x480' in capsys.readouterr().out
    content = json.loads((tmp_path / 'calibration.json').read_text())
    # 0.215 px with the board taken as flat
    assert content['rms_px'] == pytest.approx(0.208, rel=0.01)
    assert content['baseline_m'] == pytest.approx(0.0832, rel=0.02)
    _check_later_points(tmp_path, capsys)
    size = ('--image-size', '644x482')
    assert calibrate('--points', CHESSBOARD, *size, '--output', tmp_path) == 0
    assert read_rig(tmp_path).left.size == (644, 482)


def _check_later_points(rig: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Check the calibration with its own boards, then once a camera has turned."""
    check = '--points', CHESSBOARD, '--check', rig, '--output', rig / 'later'
    assert calibrate(*check) == 0
    assert 'the calibration holds' in capsys.readouterr().out
    content = json.loads((rig / 'later' / 'check.json').read_text())
    assert content['faults'] == [] and all(one['passed'] for one in content['distances'])
    camera = yaml.safe_load((rig / 'right.yaml').read_text())
    turned = rotation(np.array([4e-3, 0, 0])) @ np.reshape(
        camera['rectification_matrix']['data'], (3, 3)
    )
    camera['rectification_matrix']['data'] = turned.ravel().tolist()
    (rig / 'right.yaml').write_text(yaml.safe_dump(camera))
    (rig / 'calibration.json').unlink()
    assert calibrate(*check) == 1
    error = capsys.readouterr().err
    content = json.loads((rig / 'later' / 'check.json').read_text())
    assert content['faults'][0].startswith('rows differ by 1.9')
    # 4 mrad of f = 535 px, resampled to 480 px
    assert 'the calibration does not hold: rows differ by 1.9' in error
    assert 'else calibrate again' in error


def test_self_check_tells_and_writes_its_rows(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The checks themselves are run in the tests of the adjustment and of `solve`."""
    three = (0.01, 0.02, 0.03)
    accuracy = AccuracyRow(0.005, 1.02, 2.5, 1.03, three, three, three, three, 0.9, 0.8, 0.2)
    monkeypatch.setattr(calibration_check, 'check_accuracy', lambda **_: [accuracy])
    monkeypatch.setattr(calibration_check, 'check_rows', lambda **_: [RowsRow(0.0, 5.5, 0.2, 0.1)])
    assert calibrate('--self-check', '--output', tmp_path) == 0
    text = capsys.readouterr().out
    assert 'placement  5.0 mm:    20,    20,    20,    20 mm; 1.02 (2.50); 1.03' in text
    assert 'all: error / bound 1.020' in text and 'placement  0.0 mm: 5.50, 0.200, 0.100' in text
    content = json.loads((tmp_path / 'self_check.json').read_text())
    assert content['accuracy'][0]['bound_ratio'] == 1.02
    assert content['rows'][0]['corrected_px'] == 0.2


@pytest.mark.parametrize(
    ('args', 'message'),
    [
        ((), 'give either a folder of images or --points'),
        (('DIR', '--points', 'x.csv'), 'give either'),
        (('DIR',), 'need --rods rods.yaml'),
        (('--points', str(CHESSBOARD), '--image-size', '640'), '--image-size must be WxH'),
        (('--points', str(CHESSBOARD), '--image-size', '0x0'), '--image-size must be WxH'),
        (('--points', str(CHESSBOARD), '--rods', 'x.yaml'), '--points has its own coordinates'),
        (('DIR', '--rods', 'x.yaml', '--image-size', '8x8'), '--image-size belongs to --points'),
    ],
)
def test_wrong_usage(
    args: tuple[str, ...], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert calibrate(*args, '--output', tmp_path) == 2
    error = capsys.readouterr().err
    assert message in error and error.count('\n') == 1


@pytest.mark.parametrize(
    'args',
    [
        ('calibrate', '--self-check', '--sets', '0'),
        ('calibrate', '--self-check', '--draws', '-1'),
        ('simulate', 'rods', '--boards', '0', '--evaluate'),
        ('simulate', 'rods', '--seed', '-1'),
        ('simulate', 'scene', '--frames', '0'),
    ],
)
def test_numbers_out_of_range(
    args: tuple[str, ...], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit, match='2'):
        main([*args, '--output', str(tmp_path)])
    error = capsys.readouterr().err
    assert 'must not be negative' in error or 'above 0' in error


def test_problems_with_the_input(
    images: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rods = images / 'rods.yaml'

    def refused(folder: Path, message: str, *args: object) -> None:
        assert calibrate(folder, '--rods', rods, '--output', tmp_path / 'rig', *args) == 1
        error = capsys.readouterr().err
        assert message in error and error.count('\n') == 1
        assert not (tmp_path / 'rig').exists()

    refused(tmp_path / 'absent', 'is not a folder')
    empty = tmp_path / 'empty'
    empty.mkdir()
    refused(empty, 'holds no images of boards')
    blank = tmp_path / 'blank'
    blank.mkdir()
    for side in ('left', 'right'):
        cv2.imwrite(str(blank / f'{side}_a.png'), np.full((300, 400), 90, np.uint8))
    refused(blank, 'no rods were found in any of the 1 boards')
    few = tmp_path / 'few'
    few.mkdir()
    for name in ('left_0.png', 'right_0.png', 'left_6.png'):
        (few / name).write_bytes((images / name).read_bytes())
    refused(few, '1 of 2 boards can be used and at least 3 are needed; capture 2 more')


@pytest.mark.parametrize(
    ('args', 'message'),
    [
        (('--self-check',), 'give --output DIR'),
        (('--check', 'rig', '--self-check'), '--check and --self-check exclude each other'),
        (('--check', 'rig'), 'give either a folder of images or --points'),
    ],
)
def test_arguments_that_exclude_each_other_are_refused(
    args: tuple[str, ...], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert calibrate(*args) == 2
    assert message in capsys.readouterr().err


def test_boards_are_found_by_name(tmp_path: Path) -> None:
    for name in ('left_b.png', 'right_b.PNG', 'right_a.tif', 'left.png', 'left_c.txt', 'up_d.png'):
        (tmp_path / name).write_bytes(b'')
    found = [
        (board.name, board.left is None, board.right is None) for board in find_boards(tmp_path)
    ]
    assert found == [('a', True, False), ('b', False, False)]


def test_two_images_of_one_side_are_named(tmp_path: Path) -> None:
    for name in ('left_1.png', 'left_1.jpg', 'right_1.png'):
        (tmp_path / name).write_bytes(b'')
    (files,) = find_boards(tmp_path)
    assert files.left is None and files.right is not None
    reading = read_board(files, BOARD)
    assert reading.capture is None
    assert reading.reason == 'there are 2 left images (left_1.jpg, left_1.png); keep one'


@pytest.mark.long
def test_images_of_another_size_are_left_out(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    for index, rig in enumerate((RIG, RIG, survey_rig(scale=0.4))):
        capture = simulate_capture(BOARD, rig, rng, CaptureOptions(depth_m=(3.0, 6.0)))
        for side, image in (('left', capture.left), ('right', capture.right)):
            cv2.imwrite(str(tmp_path / f'{side}_{index}.png'), image)
    found = read_captures(tmp_path, BOARD)
    assert [capture.name for capture in found.captures] == ['0', '1']
    assert found.image_size == (960, 600)
    assert found.rejected[0].reason == (
        'its images are 768x480 px, but most images are 960x600 px'
    )
