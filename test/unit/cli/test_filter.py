# SPDX-License-Identifier: Apache-2.0
"""``filter``: another matcher's disparity file to a dense map."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from binocular_recon.cli.main import main
from binocular_recon.evaluation.speed.synthetic import SyntheticPair, synthetic_pair
from binocular_recon.io.disparity_png import write_disparity_png
from binocular_recon.io.image_files import read_image_file, write_image_file
from binocular_recon.io.pfm import read_pfm, write_pfm
from binocular_recon.stereo.validity import Validity

WIDTH, HEIGHT, RANGE = 160, 100, 32


@pytest.fixture(scope='module')
def pair() -> SyntheticPair:
    return synthetic_pair(WIDTH, HEIGHT, RANGE, seed=5)


@pytest.fixture
def files(pair: SyntheticPair, tmp_path: Path) -> Path:
    """Write the pair, and a disparity with noise of 0.2 px, holes and a wrong region."""
    random = np.random.default_rng(1)
    noise = random.normal(0, 0.2, pair.disparity_px.shape)
    theirs = (pair.disparity_px + noise).astype(np.float32)
    theirs[40:48, 60:70] += 9
    theirs[60:66, 100:120] = np.nan
    write_image_file(tmp_path / 'left.png', pair.left)
    write_image_file(tmp_path / 'right.png', pair.right)
    write_pfm(tmp_path / 'theirs.pfm', theirs)
    write_disparity_png(tmp_path / 'theirs.png', theirs)
    np.save(tmp_path / 'theirs.npy', theirs)
    return tmp_path


def filtered(files: Path, *words: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    output = files / 'new' / 'd.pfm'
    assert main(['filter', str(files / 'left.png'), *words, '--output', str(output)]) == 0
    return (
        read_pfm(output),
        read_pfm(output.with_name('d_sigma.pfm')),
        read_image_file(output.with_name('d_validity.png')),
    )


@pytest.mark.parametrize('name', ['theirs.pfm', 'theirs.png', 'theirs.npy'])
def test_a_disparity_file_becomes_dense(files: Path, pair: SyntheticPair, name: str) -> None:
    disparity, sigma, validity = filtered(files, str(files / name))
    error = np.abs(disparity - pair.disparity_px)
    assert np.isfinite(disparity).all() and (sigma > 0).all()
    assert np.median(error) < 0.14  # of the noise 0.135
    assert (validity[61:65, 101:119] & Validity.MEASURED == 0).all()
    assert (validity[10:30] == Validity.MEASURED).all()


def test_the_right_image_drops_what_it_contradicts(
    files: Path, pair: SyntheticPair, capsys: pytest.CaptureFixture[str]
) -> None:
    heat = files / 'heat.png'
    words = [str(files / 'theirs.pfm'), '--right', str(files / 'right.png')]
    _, _, trusting = filtered(files, words[0])
    _, sigma, validity = filtered(files, *words, '--heat-map', str(heat))
    region = np.s_[41:47, 61:69]
    assert (trusting[region] == Validity.MEASURED).all()
    # smooth texture is like itself at a distance: what is not dropped has a large sigma
    dropped = validity[region] != Validity.MEASURED
    assert dropped.mean() > 0.2
    assert np.median(sigma[region]) > 2 * np.median(sigma[pair.visible])
    good = pair.visible.copy()
    good[35:70] = False
    assert np.mean(validity[good] == Validity.MEASURED) > 0.8
    # left of the first column of the right image
    hidden = np.arange(WIDTH) - pair.disparity_px < -2
    assert (validity[hidden] & Validity.CONFLICT > 0).all()
    assert heat.stat().st_size > 1000
    assert 'passed the checks, 100.0% have one now' in capsys.readouterr().out


def test_a_confidence_is_taken_as_it_is(files: Path) -> None:
    confidence = np.ones((HEIGHT, WIDTH), np.float32)
    confidence[20:30, 20:40] = 0
    cv2.imwrite(str(files / 'sure.tiff'), confidence)
    words = [str(files / 'theirs.pfm'), '--confidence', str(files / 'sure.tiff')]
    _, _, validity = filtered(files, *words, '--min-disparity', '0', '--disparity-range', '32')
    assert (validity[20:30, 20:40] & Validity.MEASURED == 0).all()
    assert (validity[10:20] == Validity.MEASURED).all()


def test_what_does_not_fit_is_one_line(files: Path, capsys: pytest.CaptureFixture[str]) -> None:
    theirs = str(files / 'theirs.pfm')
    write_pfm(files / 'short.pfm', np.ones((HEIGHT - 1, WIDTH), np.float32))
    write_pfm(files / 'empty.pfm', np.full((HEIGHT, WIDTH), np.nan, np.float32))
    wild = np.linspace(0, 1e6, HEIGHT * WIDTH, dtype=np.float32).reshape(HEIGHT, WIDTH)
    write_pfm(files / 'wild.pfm', wild)
    write_pfm(files / 'percent.pfm', np.full((HEIGHT, WIDTH), 80, np.float32))
    both = ['--right', str(files / 'right.png'), '--confidence', theirs]
    for words, status, message in (
        ([str(files / 'gone.pfm')], 1, 'gone.pfm cannot be read'),
        ([str(files / 'left.png')], 1, 'is not a disparity map: 16-bit grey'),
        ([str(files / 'short.pfm')], 1, 'left.png is 160x100 px and the disparity 160x99 px'),
        ([str(files / 'empty.pfm')], 1, 'empty.pfm has no disparity'),
        ([str(files / 'wild.pfm')], 1, 'disparities from 0 to 1e+06 px; set --min-disparity'),
        ([theirs, '--confidence', str(files / 'percent.pfm')], 1, 'values from 80 to 80; a conf'),
        ([theirs, '--confidence', str(files / 'short.pfm')], 1, 'short.pfm is 160x99 px'),
        ([theirs, *both], 2, 'leave out one of --right and --confidence'),
    ):
        output = ['--output', str(files / 'd.pfm')]
        assert main(['filter', str(files / 'left.png'), *words, *output]) == status
        text = capsys.readouterr().err
        assert message in text and text.count('\n') == 1
    assert not (files / 'd.pfm').exists()
