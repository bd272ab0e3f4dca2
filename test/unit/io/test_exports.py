# SPDX-License-Identifier: Apache-2.0
"""Files for other programs, read back by the libraries that these programs use."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from binocular_recon.errors import CalibrationError, ConfigError, DependencyError, FileError
from binocular_recon.io.exports.depth import (
    DepthGeometry,
    write_depth_drawing,
    write_depth_png,
    write_depth_tiff,
)
from binocular_recon.io.exports.e57 import write_e57
from binocular_recon.io.exports.las import write_las
from binocular_recon.io.exports.placement import Placement
from binocular_recon.io.exports.ply_table import write_ply_table
from binocular_recon.io.exports.point_table import WHOLE, PointTable
from binocular_recon.io.files import write_text
from binocular_recon.io.ply import read_ply, write_ply
from binocular_recon.rotations import rotation
from binocular_recon.stereo.triangulation import Cloud

COUNT = 600
# Looks north over a site in UTM zone 32 north.
TURN = rotation(np.array([-1.5, 0.2, 0.1]))
UTM_M = np.array([500_000.0, 5_000_000.0, 431.0])
SIGMAS = ('sigma_x', 'sigma_y', 'sigma_z')


@pytest.fixture(scope='module')
def rng() -> np.random.Generator:
    return np.random.default_rng(8)


@pytest.fixture(scope='module')
def table(rng: np.random.Generator) -> PointTable:
    """Return a cloud of 30 x 20 pixels, all but one with a point, as after a calibration."""
    z = rng.uniform(8, 20, (20, 30))
    points = np.stack(
        [z * rng.uniform(-0.5, 0.5, z.shape), z * rng.uniform(-0.3, 0.3, z.shape), z]
    )
    points_xyz = np.moveaxis(points, 0, -1).astype(np.float32)
    points_xyz[3, 4] = np.nan
    along = points_xyz / points_xyz[..., 2:] * rng.uniform(0.01, 0.05, (20, 30, 1))
    sigma = np.sqrt(along**2 + 0.003**2 * np.array([1, 1, 0])).astype(np.float32)
    validity = rng.choice([1, 2 | 16], (20, 30)).astype(np.uint8)
    bgr = rng.integers(0, 256, (20, 30, 3), np.uint8)
    count = rng.integers(1, 1 << 16, (20, 30)).astype(np.uint16)
    return PointTable.of_cloud(Cloud(points_xyz, sigma), validity, bgr, count=count)


@pytest.fixture(scope='module')
def placed(table: PointTable) -> PointTable:
    return table.placed(Placement(TURN, UTM_M, crs='EPSG:32632'))


def whole(table: PointTable) -> Any:
    """Return all points as one part, made of small ones."""
    parts = list(table.chunks(100))
    assert [len(part.xyz) for part in parts] == [100] * 5 + [99]
    xyz, rgb, scalars = zip(*parts, strict=True)
    joined = {name: np.concatenate([one[name] for one in scalars]) for name in scalars[0]}
    return np.concatenate(xyz), np.concatenate(rgb), joined


def test_points_at_a_site(table: PointTable, placed: PointTable) -> None:
    camera, _, given = whole(table)
    xyz, _, scalars = whole(placed)
    np.testing.assert_allclose((xyz - UTM_M) @ TURN, camera, atol=1e-8)
    # the covariance that one has in mind, written out for a few points
    for i in range(0, COUNT - 1, 97):
        ray = camera[i] / camera[i, 2] * given['sigma_z'][i]
        covariance = TURN @ (np.outer(ray, ray) + np.diag([9e-6, 9e-6, 0])) @ TURN.T
        expected = np.sqrt(np.diag(covariance))
        np.testing.assert_allclose([scalars[name][i] for name in SIGMAS], expected, rtol=1e-4)
    # a site's axes that are the camera's change nothing
    same = whole(table.placed(Placement(np.eye(3), np.zeros(3))))[2]
    for name in SIGMAS:
        np.testing.assert_allclose(same[name], given[name], rtol=1e-5)


def test_sigmas_hold_the_share_of_the_control_points(
    table: PointTable, rng: np.random.Generator
) -> None:
    """Against the scatter of points whose placement scatters."""
    centre = np.array([3.0, -2.0, 15.0])
    spread = np.array([0.001, 0.002, 0.003, 0.004, 0.003, 0.002, 0.001])
    still = Placement(TURN, UTM_M, 1.1, np.diag(spread**2), UTM_M + 1.1 * TURN @ centre)
    camera = next(table.chunks(1)).xyz
    made = []
    for turn_shift_scale in rng.normal(size=(4000, 7)) * spread:
        turn, shift = rotation(turn_shift_scale[:3]), turn_shift_scale[3:6]
        assert still.centre_m is not None
        arm = still.points(camera) - still.centre_m
        made.append(still.centre_m + shift + np.exp(turn_shift_scale[6]) * arm @ turn.T)
    zero = {name: np.zeros(1) for name in SIGMAS}
    found = still.sigmas(camera, zero)
    scatter = np.std(made, axis=0)[0]
    np.testing.assert_allclose([found[name][0] for name in SIGMAS], scatter, rtol=0.05)
    with pytest.raises(CalibrationError, match=r'its scale is -1\.0; both must be'):
        Placement(TURN, UTM_M, -1.0)
    with pytest.raises(CalibrationError, match=r'R R\^T of the placement differs from 1 by'):
        Placement(TURN * 1.01, UTM_M)


@pytest.mark.parametrize('suffix', ['.las', '.laz'])
def test_las_keeps_a_tenth_of_a_millimetre_at_utm_coordinates(
    placed: PointTable, tmp_path: Path, suffix: str
) -> None:
    laspy = pytest.importorskip('laspy')
    write_las(tmp_path / f'a{suffix}', placed)
    las = laspy.read(tmp_path / f'a{suffix}')
    xyz, rgb, scalars = whole(placed)
    assert np.abs(np.stack([las.x, las.y, las.z], axis=-1) - xyz).max() < 6e-5
    assert str(las.header.version) == '1.4' and las.header.point_format.id == 7
    np.testing.assert_array_equal(las.header.scales, 1e-4)
    np.testing.assert_array_equal(
        np.stack([las.red, las.green, las.blue], -1), rgb * np.uint16(257)
    )
    assert list(las.point_format.extra_dimension_names) == [*SIGMAS, *WHOLE]
    for name, values in scalars.items():
        assert las[name].dtype == values.dtype
        np.testing.assert_array_equal(las[name], values)
    assert las.header.parse_crs().to_epsg() == 32632
    assert las.header.global_encoding.wkt
    text = next(vlr for vlr in las.header.vlrs if vlr.record_id == 3).record_data_bytes()
    assert b'frame of the site' in text and b'matching and calibration' in text


def test_e57_has_colour_sigmas_and_double_precision(placed: PointTable, tmp_path: Path) -> None:
    pye57 = pytest.importorskip('pye57')
    pyproj = pytest.importorskip('pyproj')
    path = tmp_path / 'a.e57'
    write_e57(path, placed)
    xyz, rgb, scalars = whole(placed)
    with pye57.E57(str(path)) as file:
        assert file.scan_count == 1
        read = file.read_scan(0, intensity=True, colors=True, ignore_missing_fields=True)
        raw = file.read_scan_raw(0, ignore_unsupported_fields=True)
        header = file.get_header(0)
        assert header.point_count == COUNT - 1
        assert {f'sd:{name}' for name in scalars} <= set(header.point_fields)
        assert header.xMinimum == xyz[:, 0].min()
        wkt = file.root['coordinateMetadata'].value()
        buffers = pye57.libe57.VectorSourceDestBuffer()
        size = COUNT - 1
        stored = {name: np.empty(size, values.dtype) for name, values in scalars.items()}
        for name, values in stored.items():
            buffers.append(
                pye57.libe57.SourceDestBuffer(
                    file.image_file, f'sd:{name}', values, size, True, True
                )
            )
        header.points.reader(buffers).read()
    for axis, name in enumerate(('cartesianX', 'cartesianY', 'cartesianZ')):
        np.testing.assert_array_equal(read[name], xyz[:, axis])
    for axis, name in enumerate(('colorRed', 'colorGreen', 'colorBlue')):
        np.testing.assert_array_equal(read[name], rgb[:, axis])
    np.testing.assert_array_equal(read['intensity'], scalars['sigma_z'])
    np.testing.assert_array_equal(raw['intensity'], scalars['sigma_z'])
    np.testing.assert_array_equal(raw['cartesianX'], xyz[:, 0])
    for name, values in stored.items():
        np.testing.assert_array_equal(values, scalars[name])
    assert pyproj.CRS.from_wkt(wkt).to_epsg() == 32632
    before = path.read_bytes()
    write_e57(path, placed)
    assert path.read_bytes() == before


def test_ply_has_double_precision_where_it_needs_it(
    table: PointTable, placed: PointTable, tmp_path: Path
) -> None:
    for one, kind in ((placed, '<f8'), (table, '<f4')):
        write_ply_table(tmp_path / 'a.ply', one)
        vertices, comments = read_ply(tmp_path / 'a.ply')
        assert vertices.dtype['x'].str == kind and len(vertices) == COUNT - 1
        assert vertices.dtype.names is not None
        assert vertices.dtype.names[6:] == tuple(f'scalar_{name}' for name in (*SIGMAS, *WHOLE))
        xyz = np.stack([vertices[:][name] for name in 'xyz'], axis=-1)
        np.testing.assert_array_equal(xyz, whole(one)[0])
        assert any('matching and calibration' in text for text in comments)
        again = PointTable.of_file(tmp_path / 'a.ply')
        assert (again.shares, again.frame) == (one.shares, one.frame_lines)


def test_clouds_without_points_and_without_a_calibration(tmp_path: Path) -> None:
    laspy, pye57 = pytest.importorskip('laspy'), pytest.importorskip('pye57')
    for count in (0, 3):
        points = np.full((1, 3, 3), np.nan, np.float32)
        points[0, :count] = [[1, 2, 9]]
        cloud = Cloud(points, np.full((1, 3, 1), 0.1, np.float32))
        bgr, validity = np.zeros((1, 3, 3), np.uint8), np.ones((1, 3), np.uint8)
        assert write_ply(tmp_path / 'a.ply', cloud, validity, bgr) == count
        few = PointTable.of_file(tmp_path / 'a.ply')
        assert few.scalar_names == ['sigma_z', 'validity']
        write_las(tmp_path / 'a.laz', few)
        assert len(laspy.read(tmp_path / 'a.laz')) == count
        write_e57(tmp_path / 'a.e57', few)
        with pye57.E57(str(tmp_path / 'a.e57')) as file:
            assert file.get_header(0).point_count == count


def test_unknown_systems_missing_packages_and_damaged_clouds(
    table: PointTable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip('pyproj')
    for crs, match in {
        'EPSG:999999': r"no coordinate reference system 'EPSG:999999'",
        '4326': 'WGS 84 has degree as units; clouds are in metres',
    }.items():
        with pytest.raises(ConfigError, match=match):
            write_las(tmp_path / 'a.las', table.placed(Placement(TURN, UTM_M, crs=crs)))
    write_ply_table(tmp_path / 'a.ply', table)
    data = (tmp_path / 'a.ply').read_bytes()
    for damaged in (data[:-1], data[:100], data.replace(b'little', b'BIG   '), b''):
        (tmp_path / 'a.ply').write_bytes(damaged)
        with pytest.raises(FileError, match=r'a\.ply is not a cloud of this program'):
            read_ply(tmp_path / 'a.ply')
    with pytest.raises(FileError, match=r'b\.ply cannot be read: No such file'):
        read_ply(tmp_path / 'b.ply')
    for package, write, extra in (
        ('laspy', write_las, 'survey'),
        ('lazrs', write_las, 'survey'),
        ('pye57', write_e57, 'e57'),
    ):
        monkeypatch.setitem(sys.modules, package, None)
        with pytest.raises(DependencyError, match=rf'{package}, which is not .*\[{extra}\]'):
            write(tmp_path / 'a.laz', table)
        monkeypatch.undo()
    assert [path.name for path in tmp_path.iterdir()] == ['a.ply']


def test_depth_images_and_their_side_files(tmp_path: Path) -> None:
    depth_m = np.linspace(2, 80, 48 * 64, dtype=np.float32).reshape(48, 64)
    depth_m[5:9, 7:20] = np.nan
    P = np.array([[500.0, 0, 30, 0], [0, 510, 24, 0], [0, 0, 1, 0]])
    geometry = DepthGeometry((64, 48), P, 0.8, 'rectified')
    write_depth_tiff(tmp_path / 'a.tiff', depth_m, geometry)
    read = cv2.imread(str(tmp_path / 'a.tiff'), cv2.IMREAD_UNCHANGED)
    assert read.dtype == np.float32
    np.testing.assert_array_equal(read, depth_m)
    side = json.loads((tmp_path / 'a.json').read_text())
    assert (side['unit'], side['invalid']) == ('m', 'nan')
    assert [side[name] for name in ('fx', 'fy', 'cx', 'cy')] == [500, 510, 30, 24]
    write_depth_png(tmp_path / 'a.png', depth_m, geometry)
    read = cv2.imread(str(tmp_path / 'a.png'), cv2.IMREAD_UNCHANGED)
    assert read.dtype == np.uint16
    valid = np.isfinite(depth_m) & (depth_m < 65.535)
    side = json.loads((tmp_path / 'a.json').read_text())
    assert np.abs(read[valid] * side['metres_per_unit'] - depth_m[valid]).max() < 5.1e-4
    assert not read[~valid].any()
    assert side['beyond_largest'] == np.count_nonzero(depth_m > 65.535) > 0
    for coloured in (False, True):
        write_depth_drawing(tmp_path / 'b.png', depth_m, coloured=coloured)
        drawn = cv2.imread(str(tmp_path / 'b.png'))
        assert drawn.shape[0] == 48 and drawn.shape[1] > 64 + 20  # and the bar
        near, far = drawn[1, 1].astype(int), drawn[-2, 62].astype(int)
        if coloured:
            assert near[2] > near[0] and far[0] > far[2]  # red and blue
        else:
            assert (np.ptp(near), np.ptp(far)) == (0, 0) and near[0] > far[0] + 150 and far[0] > 0
        assert not drawn[5:9, 7:20].any()


def test_a_name_that_is_no_utf_8(table: PointTable, tmp_path: Path) -> None:
    pytest.importorskip('pye57')
    with pytest.raises(
        FileError, match=r'\\udcff\.e57 cannot be written: E57 needs a path in UTF'
    ):
        write_e57(tmp_path / os.fsdecode(b'n\xff.e57'), table)
    write_text(tmp_path / 'page.html', os.fsdecode('<p>bä'.encode() + b'\xff</p>'))
    assert (tmp_path / 'page.html').read_text() == '<p>bä\\udcff</p>'
    assert [path.name for path in tmp_path.iterdir()] == ['page.html']
