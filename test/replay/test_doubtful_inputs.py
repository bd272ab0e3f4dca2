# SPDX-License-Identifier: Apache-2.0
"""``reconstruct`` and ``match`` where an input states one thing and holds another."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from binocular_recon.camera import Camera
from binocular_recon.cli.main import main
from binocular_recon.evaluation.speed.synthetic import SyntheticPair, synthetic_pair
from binocular_recon.io.bags.writer import new_message
from binocular_recon.io.messages.images import fill_image
from binocular_recon.io.pfm import read_pfm
from test.bag_tools import PERIOD_NS, START_NS, Record, header, info_message, write_bag

WIDTH, HEIGHT, FOCAL_PX, BASELINE_M = 320, 240, 300.0, 0.5
Change = Callable[[Any], Any]


@pytest.fixture(scope='module')
def scene() -> SyntheticPair:
    """Return a scene at 5 to 50 px."""
    return synthetic_pair(WIDTH, HEIGHT, 56, seed=1)


def camera(tx: float) -> Camera:
    P = np.array([[FOCAL_PX, 0, 160, tx], [0, FOCAL_PX, 120, 0], [0, 0, 1, 0.0]])
    return Camera(WIDTH, HEIGHT, P[:, :3], np.zeros(5), np.eye(3), P)


def bag_of(
    folder: Path,
    scene: SyntheticPair,
    *,
    frames: int = 1,
    image: Change = lambda image: image,
    right: Change = lambda image: image,
    encoding: str = 'mono8',
    info: Change = lambda info: info,
    ahead_ns: int = 0,
) -> Path:
    """Write a rectified pair and its camera infos, changed, as a bag."""
    records: list[Record] = []
    left_grey, right_grey = (
        cv2.cvtColor(i, cv2.COLOR_BGR2GRAY) for i in (scene.left, scene.right)
    )
    pictures = {'left': image(left_grey), 'right': image(right(right_grey))}
    for k in range(frames):
        recorded_ns = START_NS + k * PERIOD_NS
        for side, tx in (('left', 0.0), ('right', -FOCAL_PX * BASELINE_M)):
            stamp_ns = recorded_ns + (ahead_ns if side == 'right' else 0)
            message = new_message('sensor_msgs/msg/Image')
            fill_image(message, pictures[side], encoding, header(stamp_ns))
            records.append(
                (f'/{side}/camera_info', info(info_message(camera(tx), stamp_ns)), recorded_ns)
            )
            records.append((f'/{side}/image_rect', message, recorded_ns))
    return write_bag(folder / 'bag', records)


def reconstruct(bag: Path, output: Path, *words: str) -> int:
    return main(['reconstruct', str(bag), '--output', str(output), *words])


def wrong_share(output: Path, scene: SyntheticPair) -> float:
    found = read_pfm(output / '000000_disparity.pfm')
    return float(np.mean(~(np.abs(found - scene.disparity_px) <= 2)))


def changed(**members: Any) -> Change:
    def change(info: Any) -> Any:
        for name, value in members.items():
            setattr(info, name, value)
        return info

    return change


def in_millimetres(info: Any) -> Any:
    info.p = info.p * np.array([1, 1, 1, 1000] + 8 * [1.0])
    return info


def test_a_baseline_in_millimetres_is_warned_of_and_stated(
    tmp_path: Path, scene: SyntheticPair, capsys: pytest.CaptureFixture[str]
) -> None:
    assert reconstruct(bag_of(tmp_path, scene, info=in_millimetres), tmp_path / 'out') == 0
    printed = capsys.readouterr()
    assert 'warning: the baseline is 500 m, outside 0.01 to 20 m: if it is in mill' in printed.err
    assert 'baseline 500 m, focal length 300 px, searched from ' in printed.out


@pytest.mark.parametrize(
    'members',
    [
        {'width': 0, 'height': 0},
        {'distortion_model': 'mystery', 'd': np.array([0.1, 0.2])},
        {'k': np.zeros(9), 'r': np.zeros(9)},
        {'d': np.zeros(14)},
    ],
)
def test_what_does_not_matter_to_rectified_images_is_accepted(
    tmp_path: Path,
    scene: SyntheticPair,
    capsys: pytest.CaptureFixture[str],
    members: dict[str, Any],
) -> None:
    bag = bag_of(tmp_path, scene, info=changed(**members))
    assert reconstruct(bag, tmp_path / 'out') == 0
    assert wrong_share(tmp_path / 'out', scene) < 0.08
    notices = capsys.readouterr().err.count('so only P is used')
    assert notices == (2 if {'distortion_model', 'k'} & members.keys() else 0)


@pytest.mark.parametrize(
    ('image', 'encoding', 'words'),
    [
        (lambda i: i.astype(np.uint16) << 4, 'mono16', []),
        (lambda i: i.astype(np.uint16) << 4, 'mono16', ['--white-level', '4095']),
        (lambda i: 21000 + i.astype(np.uint16) * 11, 'mono16', []),
        (lambda i: i.astype(np.float32), '32FC1', []),
    ],
)
def test_levels_are_found_or_given(
    tmp_path: Path, scene: SyntheticPair, image: Change, encoding: str, words: list[str]
) -> None:
    bag = bag_of(tmp_path, scene, image=image, encoding=encoding)
    assert reconstruct(bag, tmp_path / 'out', *words) == 0
    assert wrong_share(tmp_path / 'out', scene) < 0.08
    options = json.loads((tmp_path / 'out' / 'summary.json').read_text())['options']
    assert options['images']['white_level'] == (4095.0 if words else 0.0)


def test_clocks_that_differ(
    tmp_path: Path, scene: SyntheticPair, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = bag_of(tmp_path, scene, frames=5, ahead_ns=60_000_000)
    assert reconstruct(bag, tmp_path / 'out') == 1
    error = capsys.readouterr().err
    assert 'its clock is 60.000 ms ahead, a constant' in error
    assert 'give --stamp-offset -0.060000, or --pairing arrival' in error
    for words in (['--stamp-offset', '-0.06'], ['--pairing', 'arrival']):
        assert reconstruct(bag, tmp_path / 'out', *words, '--max-frames', '2') == 0


def one_row_lower(image: Any) -> Any:
    return np.roll(image, 1, axis=0)


def test_rows_that_are_off_are_said_once_with_the_number(
    tmp_path: Path, scene: SyntheticPair, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = bag_of(tmp_path, scene, frames=2, right=one_row_lower)
    assert reconstruct(bag, tmp_path / 'out') == 0
    error = capsys.readouterr().err
    assert error.count('warning: rows of left and right differ by') == 1
    frame = json.loads((tmp_path / 'out' / 'summary.json').read_text())['frames'][0]
    assert frame['row_offset_px'] == pytest.approx(1.0, abs=0.1)


def test_an_upside_down_camera_is_named(
    tmp_path: Path, scene: SyntheticPair, capsys: pytest.CaptureFixture[str]
) -> None:
    def turned(image: Any) -> Any:
        return np.ascontiguousarray(image[::-1, ::-1])

    assert reconstruct(bag_of(tmp_path, scene, right=turned), tmp_path / 'out') == 1
    assert 'the right image is upside down' in capsys.readouterr().err


def test_match_says_the_same(
    tmp_path: Path, scene: SyntheticPair, capsys: pytest.CaptureFixture[str]
) -> None:
    files = [str(tmp_path / name) for name in ('left.png', 'right.png', 'd.pfm')]
    cv2.imwrite(files[0], scene.left)
    cv2.imwrite(files[1], one_row_lower(scene.right))
    assert main(['match', *files[:2], '--output', files[2]]) == 0
    assert 'warning: rows of left and right differ by' in capsys.readouterr().err
    cv2.imwrite(files[1], scene.right[::-1])
    assert main(['match', *files[:2], '--output', files[2]]) == 1
    assert 'one of the images is flipped top to bottom' in capsys.readouterr().err
