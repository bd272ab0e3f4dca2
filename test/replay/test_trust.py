# SPDX-License-Identifier: Apache-2.0
"""``reconstruct`` and ``match`` where the result would be wrong: said, and refused."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from binocular_recon.camera import Camera
from binocular_recon.cli.main import main
from binocular_recon.evaluation.speed.synthetic import SyntheticPair, synthetic_pair
from binocular_recon.io.image_files import read_image_file
from binocular_recon.io.pfm import read_pfm
from test.bag_tools import START_NS, Record, image_message, info_message, write_bag

WIDTH, HEIGHT, FOCAL_PX, BASELINE_M = 320, 240, 300.0, 0.5


@pytest.fixture(scope='module')
def scene() -> SyntheticPair:
    """Return a scene at 5 to 50 px."""
    return synthetic_pair(WIDTH, HEIGHT, 56, seed=1)


def bag_of(folder: Path, scene: SyntheticPair, *, exchanged: bool = False) -> Path:
    """Write a rectified pair and its camera infos as a bag."""
    images = (scene.right, scene.left) if exchanged else (scene.left, scene.right)
    records: list[Record] = []
    for side, image, tx in zip(
        ('left', 'right'), images, (0.0, -FOCAL_PX * BASELINE_M), strict=True
    ):
        P = np.array([[FOCAL_PX, 0, 160, tx], [0, FOCAL_PX, 120, 0], [0, 0, 1, 0.0]])
        camera = Camera(WIDTH, HEIGHT, P[:, :3], np.zeros(5), np.eye(3), P)
        records.append((f'/{side}/camera_info', info_message(camera, START_NS), START_NS))
        records.append((f'/{side}/image_rect', image_message(image, START_NS), START_NS))
    return write_bag(folder / 'bag', records)


def reconstruct(bag: Path, output: Path, *words: str) -> int:
    return main(['reconstruct', str(bag), '--output', str(output), *words])


def test_the_range_is_found_and_said(
    tmp_path: Path, scene: SyntheticPair, capsys: pytest.CaptureFixture[str]
) -> None:
    assert reconstruct(bag_of(tmp_path, scene), tmp_path / 'out') == 0
    printed = capsys.readouterr()
    assert 'baseline 0.500 m, focal length 300 px; search range: -1 to' in printed.err
    assert 'm to infinity' in printed.err
    assert 'of the pixels measured' in printed.out
    error_px = np.abs(read_pfm(tmp_path / 'out' / '000000_disparity.pfm') - scene.disparity_px)
    assert np.mean(error_px > 2) < 0.08


def test_a_range_that_is_too_small_is_refused_but_written(
    tmp_path: Path, scene: SyntheticPair, capsys: pytest.CaptureFixture[str]
) -> None:
    bag, small = bag_of(tmp_path, scene), ('--disparity-range', '20')
    assert reconstruct(bag, tmp_path / 'out', *small) == 1
    error = capsys.readouterr().err
    assert 'the search range 0..19 px is too small' in error
    assert '(--least-matched 0); 1 frame is in' in error
    assert (tmp_path / 'out' / '000000.ply').exists()
    frame = json.loads((tmp_path / 'out' / 'summary.json').read_text())['frames'][0]
    assert 'too small' in frame['warning']
    assert reconstruct(bag, tmp_path / 'out', *small, '--least-matched', '0') == 0
    assert 'warning: the search range' in capsys.readouterr().err


def test_exchanged_images_are_refused(
    tmp_path: Path, scene: SyntheticPair, capsys: pytest.CaptureFixture[str]
) -> None:
    assert reconstruct(bag_of(tmp_path, scene, exchanged=True), tmp_path / 'out') == 1
    assert 'left and right are exchanged' in capsys.readouterr().err


def test_depths_instead_of_pixels(tmp_path: Path, scene: SyntheticPair) -> None:
    words = ['--near', '2.5', '--far', '40']
    assert reconstruct(bag_of(tmp_path, scene), tmp_path / 'out', *words) == 0
    summary = json.loads((tmp_path / 'out' / 'summary.json').read_text())
    near, far = summary['depth_searched_m']
    # f B = 150 px m
    assert 2.3 < near < 2.5
    assert 40 < far < 80


@pytest.mark.parametrize(
    ('words', 'message'),
    [
        (['--far', '9'], '--far can only be used with --near'),
        (['--near', '3', '--disparity-range', '64'], '--near and --far replace --min-disparity'),
        (['--near', '9', '--far', '5'], 'near must be above 0 and below far'),
        (['--max-sigma', 'much'], 'max_sigma must be metres or a share'),
    ],
)
def test_bounds_that_do_not_fit_are_wrong_usage(
    tmp_path: Path,
    scene: SyntheticPair,
    capsys: pytest.CaptureFixture[str],
    words: list[str],
    message: str,
) -> None:
    assert reconstruct(bag_of(tmp_path, scene), tmp_path / 'out', *words) == 2
    assert message in capsys.readouterr().err


def test_keep_measured_leaves_filled_points_out(tmp_path: Path, scene: SyntheticPair) -> None:
    bag, counts = bag_of(tmp_path, scene), {}
    for keep in ('measured', 'all'):
        output = tmp_path / keep
        assert reconstruct(bag, output, '--keep', keep, '--max-sigma', '30%') == 0
        frame = json.loads((output / 'summary.json').read_text())['frames'][0]
        counts[keep] = frame['points']
        measured = (read_image_file(output / '000000_validity.png') & 1).sum()
        assert counts['measured'] <= measured
    assert counts['measured'] < counts['all']


def test_match_finds_the_range_and_judges(
    tmp_path: Path, scene: SyntheticPair, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ('left', 'right'):
        cv2.imwrite(str(tmp_path / f'{name}.png'), getattr(scene, name))
    left, right, output = (str(tmp_path / n) for n in ('left.png', 'right.png', 'd.pfm'))
    assert main(['match', left, right, '--output', output]) == 0
    assert 'px searched' in capsys.readouterr().out
    error_px = np.abs(read_pfm(tmp_path / 'd.pfm') - scene.disparity_px)
    assert np.mean(error_px > 2) < 0.08
    assert (read_image_file(tmp_path / 'd_validity.png') & 1).mean() > 0.8
    assert main(['match', left, right, '--max-disparity', '16', '--output', output]) == 1
    assert 'the search range 0..16 px is too small' in capsys.readouterr().err
    words = ['--min-disparity', 'auto', '--output', output]
    assert main(['match', right, left, '--max-disparity', '60', *words]) == 1
    assert 'left and right are exchanged' in capsys.readouterr().err
