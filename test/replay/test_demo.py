# SPDX-License-Identifier: Apache-2.0
"""The demo: a real pair against its ground truth."""

from __future__ import annotations

import hashlib
import json
import re
import runpy
from pathlib import Path

import numpy as np
import pytest

from binocular_recon.cli.main import main
from binocular_recon.config import ChainConfig
from binocular_recon.evaluation.accuracy.visibility import visible_from_truth
from binocular_recon.images import FloatImage
from binocular_recon.io.bags.reader import Bag
from binocular_recon.io.disparity_png import read_disparity_png
from binocular_recon.io.image_files import read_image_file
from binocular_recon.io.pfm import read_pfm
from binocular_recon.stereo.pipeline import estimate_disparity
from binocular_recon.stereo.validity import Validity
from test.replay.clouds import pixels_of, read_ply

BAGS = Path(__file__).parents[2] / 'bags'


@pytest.fixture(scope='module')
def demo(tmp_path_factory: pytest.TempPathFactory) -> Path:
    output = tmp_path_factory.mktemp('demo')
    assert main(['demo', '--output', str(output)]) == 0
    return output


def test_demo_reaches_its_figures(demo: Path) -> None:
    summary = json.loads((demo / 'summary.json').read_text())
    (frame,) = summary['frames']
    assert frame['density'] == 1.0
    assert summary['preset'] == 'default'
    truth_px = read_disparity_png(BAGS / 'motorcycle_truth' / 'disparity.png')
    known = np.isfinite(truth_px)
    error_px = np.abs(read_pfm(demo / '000000_disparity.pfm') - truth_px)[known]
    bad_percent = 100 * np.mean(error_px > 2)
    assert bad_percent <= 16.0
    assert summary['accuracy']['bad-2.0 %'] == pytest.approx(bad_percent, abs=0.006)


@pytest.mark.large
def test_accurate_beats_default_on_the_demo(demo: Path, tmp_path: Path) -> None:
    assert main(['demo', '--output', str(tmp_path), '--preset', 'accurate']) == 0
    truth_px = read_disparity_png(BAGS / 'motorcycle_truth' / 'disparity.png')
    known = np.isfinite(truth_px)
    bad_percent = [
        100 * np.mean(np.abs(read_pfm(out / '000000_disparity.pfm') - truth_px)[known] > 2)
        for out in (tmp_path, demo)
    ]
    assert bad_percent[0] < bad_percent[1]
    assert bad_percent[0] <= 8.6


def test_demo_cloud_is_metric(demo: Path) -> None:
    # Z = f B / (d + doffs), as Middlebury's calibration file defines it
    truth_px = read_disparity_png(BAGS / 'motorcycle_truth' / 'disparity.png')
    truth_m = 999.421 * 0.193001 / (truth_px + 32.778)
    vertices = read_ply(demo / '000000.ply')
    place = pixels_of(vertices, demo)
    assert len(vertices) > 0.85 * truth_px.size
    assert len(set(zip(*place, strict=True))) == len(vertices)
    z = vertices['xyz'][:, 2]
    error_mm = 1000 * np.abs(z - truth_m[place])
    assert np.nanmedian(error_mm) < 15
    left = read_image_file(demo / '000000_cloud.png')[:, : truth_px.shape[1]]
    np.testing.assert_array_equal(vertices['rgb'], left[place][:, ::-1])


def test_demo_says_what_is_measured(demo: Path) -> None:
    vertices = read_ply(demo / '000000.ply')
    summary = json.loads((demo / 'summary.json').read_text())
    validity = read_image_file(demo / '000000_validity.png')
    np.testing.assert_array_equal(vertices['validity'], validity[pixels_of(vertices, demo)])
    measured = (validity & Validity.MEASURED) > 0
    assert summary['matched'] == summary['frames'][0]['matched'] == pytest.approx(measured.mean())
    assert 0.8 < summary['matched'] < 0.9
    # one of the three, and a reason exactly where it is not measured
    assert set(np.unique(validity & 7)) == {1, 2, 4}
    np.testing.assert_array_equal(validity >= 8, ~measured)
    # no point is extrapolated or as uncertain as a tenth of its depth
    assert not (vertices['validity'].astype(int) & Validity.EXTRAPOLATED).any()
    assert (vertices['sigma_z'] <= 0.1 * vertices['xyz'][:, 2]).all()
    # few points are off by more than three standard deviations
    truth_px = read_disparity_png(BAGS / 'motorcycle_truth' / 'disparity.png')
    truth_m = (999.421 * 0.193001 / (truth_px + 32.778))[pixels_of(vertices, demo)]
    off = np.abs(vertices['xyz'][:, 2] - truth_m) > 3 * vertices['sigma_z']
    assert off[np.isfinite(truth_m)].mean() < 0.065


def test_the_demo_finds_its_range(demo: Path) -> None:
    frame = json.loads((demo / 'summary.json').read_text())['frames'][0]
    truth_px = read_disparity_png(BAGS / 'motorcycle_truth' / 'disparity.png')
    assert frame['disparity_px']['min'] == -34  # just behind infinity, at -32.8 px
    assert np.nanmax(truth_px) < frame['disparity_px']['max'] < 1.4 * np.nanmax(truth_px)


def _normalised_error_rms(error_px: FloatImage, sigma_px: FloatImage) -> float:
    """Return the RMS of error / sigma of the pixels that are matched correctly."""
    correct = np.abs(error_px) < 1
    return float(np.sqrt(np.mean((error_px[correct] / sigma_px[correct]) ** 2)))


def test_sigma_z_of_the_demo_is_calibrated(demo: Path) -> None:
    truth_px = read_disparity_png(BAGS / 'motorcycle_truth' / 'disparity.png')
    visible = read_image_file(BAGS / 'motorcycle_truth' / 'visible.png') > 0
    vertices = read_ply(demo / '000000.ply')
    place = pixels_of(vertices, demo)
    sigma_px = 999.421 * 0.193001 * vertices['sigma_z'] / vertices['xyz'][:, 2] ** 2
    error_px = (read_pfm(demo / '000000_disparity.pfm') - truth_px)[place]
    known = (visible & np.isfinite(truth_px))[place]
    # the motorcycle is one of the scenes where sigma is on the safe side
    assert 0.6 < _normalised_error_rms(error_px[known], sigma_px[known]) < 1.4
    assert np.quantile(sigma_px, 0.9) > 2 * np.quantile(sigma_px, 0.1)  # no constant


@pytest.mark.parametrize('scene', ['cones', 'teddy'])
def test_sigma_of_other_scenes_is_calibrated(shared_data: Path, scene: str) -> None:
    folder = shared_data / 'stereo' / scene
    truth_px = read_pfm(folder / 'disparity.pfm')
    config = ChainConfig.preset('default', disparity_range=65)
    left, right = (read_image_file(folder / f'{side}.png') for side in ('left', 'right'))
    filtered = estimate_disparity(left, right, config).filtered
    known = visible_from_truth(truth_px) & np.isfinite(truth_px)
    error_px = (filtered.disparity_px - truth_px)[known]
    assert 0.7 < _normalised_error_rms(error_px, filtered.sigma_px[known]) < 1.4


def test_the_shipped_files_are_those_of_the_readme() -> None:
    sums = re.findall(r'^([0-9a-f]{64})  (\S+)$', (BAGS / 'README.md').read_text(), re.MULTILINE)
    assert {name for _, name in sums} == {
        str(path.relative_to(BAGS)) for path in BAGS.glob('*/*') if path.is_file()
    }
    for checksum, name in sums:
        assert hashlib.sha256((BAGS / name).read_bytes()).hexdigest() == checksum, name
    assert sum(path.stat().st_size for path in BAGS.rglob('*') if path.is_file()) < 6e6


def test_the_shipped_bag_can_be_made_again(shared_data: Path, tmp_path: Path) -> None:
    script = runpy.run_path(str(BAGS / 'make_motorcycle.py'))
    script['make'](shared_data / 'stereo' / 'motorcycle', tmp_path)
    with Bag(BAGS / 'motorcycle') as shipped, Bag(tmp_path / 'motorcycle') as made:
        assert list(shipped.messages()) == list(made.messages())
    for name in ('disparity.png', 'visible.png'):
        one, other = (read_image_file(x / 'motorcycle_truth' / name) for x in (BAGS, tmp_path))
        np.testing.assert_array_equal(one, other)
    truth_px = read_pfm(shared_data / 'stereo' / 'motorcycle' / 'disparity.pfm')
    kept_px = read_disparity_png(BAGS / 'motorcycle_truth' / 'disparity.png')
    np.testing.assert_allclose(kept_px, truth_px, atol=0.002)
