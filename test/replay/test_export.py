# SPDX-License-Identifier: Apache-2.0
"""``export``, and ``reconstruct --format``: the files of one frame are those of the other way."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from binocular_recon.apps.export import EXPORTS
from binocular_recon.cli.main import main
from test.bag_tools import stereo_records, write_bag
from test.replay.clouds import read_ply
from test.replay.reconstruction import reconstruct

pytest.importorskip('laspy')
pytest.importorskip('pye57')
NAMES = 'ply', 'las', 'laz', 'e57', 'tiff', 'png', 'grey', 'colour'


@pytest.fixture(scope='module')
def output(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the output of two frames in all formats."""
    folder = tmp_path_factory.mktemp('output')
    bag = write_bag(folder / 'bag', stereo_records(2))
    assert reconstruct(bag, folder / 'out', '--format', ','.join(NAMES)) == 0
    return folder / 'out'


def export(output: Path, *words: str) -> int:
    return main(['export', str(output), *words])


def test_what_is_exported_later_is_what_reconstruct_writes(
    output: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert set(EXPORTS) == set(NAMES)
    assert export(output, '--format', ','.join(NAMES), '--output', str(tmp_path)) == 0
    assert capsys.readouterr().out == f'2 frames as {", ".join(EXPORTS)} in {tmp_path}\n'
    endings = {ending for spec in EXPORTS.values() for ending in spec.endings}
    assert len(endings) == 10
    names = {f'{index:06d}{ending}' for index in range(2) for ending in endings}
    assert {path.name for path in tmp_path.iterdir()} == names
    for name in names:
        assert (tmp_path / name).read_bytes() == (output / name).read_bytes(), name
    depth_m = cv2.imread(str(tmp_path / '000001_depth.tiff'), cv2.IMREAD_UNCHANGED)
    points = read_ply(output / '000001.ply')['xyz']
    np.testing.assert_array_equal(depth_m[np.isfinite(depth_m)], points[:, 2])


def test_by_default_files_lie_in_a_folder_of_their_own_and_reconstruct_leaves_them(
    output: Path, tmp_path: Path
) -> None:
    folder = tmp_path / 'out'
    shutil.copytree(output, folder)
    assert export(folder, '--format', 'laz') == 0
    assert {path.name for path in (folder / 'export').iterdir()} == {'000000.laz', '000001.laz'}
    assert reconstruct(output.parent / 'bag', folder, '--max-frames', '1') == 0
    # formats that were not asked for again are removed
    assert not list(folder.glob('*.laz')) and not list(folder.glob('*_depth.json'))
    assert len(list((folder / 'export').iterdir())) == 2


def test_clouds_lie_where_the_control_points_say(
    output: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    laspy = pytest.importorskip('laspy')
    folder = tmp_path / 'out'
    shutil.copytree(output, folder)
    turn = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])  # z forward becomes y, y down -z
    pivot_site = np.array([500_000.0, 5_000_000, 120])
    tie = {
        'transform': {
            'R': turn.tolist(),
            't': pivot_site.tolist(),
            'scale': 1.0,
            'pivot': [0, 0, 0],
            'pivot_site': pivot_site.tolist(),
        },
        'crs': {'epsg': 32632},
        'errors': {
            'covariance': np.diag([0, 0, 0, 0.04**2, 0, 0, 0]).tolist(),
            'by_calibration': [[]] * 7,
        },
        'axes': ['E', 'N', 'h'],
        'level': True,
    }
    path = folder / 'georeference.json'
    path.write_text(json.dumps(tie))
    assert export(folder, '--format', 'laz,tiff') == 0
    assert 'in the frame of the site (EPSG:32632)\n' in capsys.readouterr().out
    las = laspy.read(folder / 'export' / '000000.laz')
    vertices = read_ply(output / '000000.ply')
    placed = vertices['xyz'].astype(float) @ turn.T + pivot_site
    assert np.abs(np.stack([las.x, las.y, las.z], -1) - placed).max() < 1e-3 / 10
    x, _, z = vertices['xyz'].astype(float).T
    matching = vertices['sigma_z'] * x / z  # along the ray
    np.testing.assert_allclose(las['sigma_x'], np.hypot(matching, 0.04), rtol=1e-4)
    np.testing.assert_allclose(las['sigma_y'], vertices['sigma_z'], rtol=1e-4)
    depth = (folder / 'export' / '000000_depth.tiff').read_bytes()
    assert depth == (output / '000000_depth.tiff').read_bytes()
    assert export(folder, '--format', 'laz', '--no-georeference') == 0
    las = laspy.read(folder / 'export' / '000000.laz')
    assert np.abs(las.z - vertices['xyz'][:, 2]).max() < 1e-4
    small = {'covariance': [[1.0]]}
    wrong: list[Any] = [{}, [], {**tie, 'errors': small}, {**tie, 'crs': {'epsg': 'x'}}]
    for damaged in wrong:
        path.write_text(json.dumps(damaged))
        assert export(folder, '--format', 'laz') == 1
        assert 'georeference.json is not a georeference: ' in capsys.readouterr().err


def test_what_cannot_be_exported(
    output: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    thin = tmp_path / 'thin'
    bag = str(output.parent / 'bag')
    assert reconstruct(Path(bag), thin, '--max-frames', '1', '--decimation', '2') == 0
    cut = tmp_path / 'cut'
    shutil.copytree(output, cut)
    (cut / '000001.ply').write_bytes(b'ply')
    other = tmp_path / 'other'
    other.mkdir()
    (other / 'summary.json').write_text(json.dumps({'frames': [{}]}))
    for folder, words, status, said in (
        (output, ('--format', 'obj'), 2, "--format must be among ply, las, .*got 'obj'"),
        (output, ('--format', 'laz', '--output', str(output)), 2, 'choose another folder'),
        (tmp_path, ('--format', 'laz'), 1, 'there is no summary.json; give the folder'),
        (other, ('--format', 'laz'), 1, 'is damaged: frame 0 has another index'),
        (thin, ('--format', 'tiff'), 2, 'were thinned .* reconstruct --format'),
        (cut, ('--format', 'laz'), 1, '000001.ply is not a cloud of this program'),
    ):
        assert export(folder, *words) == status
        err = capsys.readouterr().err
        assert re.search(said, err), err
    # what was finished before stays
    assert {path.name for path in (cut / 'export').iterdir()} == {'000000.laz'}
    assert export(thin, '--format', 'laz') == 0
