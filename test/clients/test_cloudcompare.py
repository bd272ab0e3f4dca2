# SPDX-License-Identifier: Apache-2.0
"""CloudCompare opens our clouds and finds points, colours and standard deviations (make clients).

Not a part of ``make test``: it needs programs of the system. A CloudCompare without the plugin of
a format, as Debian's for LAZ and E57, skips that format and says so.
"""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from binocular_recon.apps.frame_formats import FRAME_FORMATS
from binocular_recon.io.exports.placement import Placement
from binocular_recon.io.exports.point_table import PointTable
from binocular_recon.stereo.triangulation import Cloud

PROGRAMS = 'CloudCompare', 'xvfb-run'
UTM_M = np.array([500_000.0, 5_000_000.0, 431.0])
SIGMAS = ['sigma_x', 'sigma_y', 'sigma_z']
# What M3C2-PM is given, and the other columns that CloudCompare has for each format.
SCALARS = {'ply': SIGMAS, 'laz': SIGMAS, 'e57': ['Intensity']}

pytestmark = pytest.mark.skipif(
    not all(map(shutil.which, PROGRAMS)),
    reason='needs CloudCompare and Xvfb: apt-get install cloudcompare xvfb xauth',
)


@pytest.fixture(scope='module')
def table() -> PointTable:
    rng = np.random.default_rng(3)
    points = (rng.uniform(-3, 3, (20, 30, 3)) + np.array([0, 0, 12])).astype(np.float32)
    sigma = rng.uniform(0.01, 0.05, (20, 30, 3)).astype(np.float32)
    bgr = rng.integers(0, 256, (20, 30, 3), np.uint8)
    return PointTable.of_cloud(Cloud(points, sigma), np.ones((20, 30), np.uint8), bgr)


@pytest.mark.parametrize('site', [False, True])
@pytest.mark.parametrize('name', list(SCALARS))
def test_cloudcompare_reads_points_colours_and_sigmas(
    table: PointTable, tmp_path: Path, name: str, site: bool
) -> None:
    if site:
        table = table.placed(Placement(np.eye(3), UTM_M, crs='EPSG:32632'))
    path, text = tmp_path / f'cloud.{name}', tmp_path / 'cloud.asc'
    FRAME_FORMATS[name].write(path, table)
    words = ['CloudCompare', '-SILENT', '-AUTO_SAVE', 'OFF', '-O', '-GLOBAL_SHIFT', 'AUTO']
    words += [str(path), '-C_EXPORT_FMT', 'ASC', '-PREC', '6', '-ADD_HEADER']
    done = subprocess.run(
        ['xvfb-run', '-a', *words, '-SAVE_CLOUDS', 'FILE', str(text)],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    if f"unhandled file extension '{name}'" in done.stdout + done.stderr:
        pytest.skip(f'this CloudCompare has no plugin for {name}')
    assert done.returncode == 0, done.stdout + done.stderr
    header = text.read_text().partition('\n')[0].removeprefix('//').split()
    found = dict(zip(header, np.loadtxt(text, skiprows=1).T, strict=True))
    (whole,) = table.chunks()
    # CloudCompare keeps 32 bits after a shift of its own
    for axis, column in enumerate('XYZ'):
        assert np.abs(found[column] - whole.xyz[:, axis]).max() < 2e-4
    for axis, column in enumerate('RGB'):
        np.testing.assert_array_equal(found[column], whole.rgb[:, axis])
    for column, sigma in zip(SCALARS[name], SIGMAS[-len(SCALARS[name]) :], strict=True):
        assert np.abs(found[column] - whole.scalars[sigma]).max() < 2e-6
