# SPDX-License-Identifier: Apache-2.0
"""Thinned clouds against slow, obvious twins."""

from __future__ import annotations

import math
from collections import defaultdict

import numpy as np
import pytest

from binocular_recon.cloud_config import CloudConfig
from binocular_recon.errors import ConfigError
from binocular_recon.stereo.thinning import PointSet, thin
from binocular_recon.stereo.triangulation import Cloud
from binocular_recon.stereo.validity import Validity

ROWS, COLUMNS = 23, 31
FILLED = Validity.FILLED | Validity.CONFLICT


def points(seed: int, sigmas: int = 3) -> PointSet:
    """Return points about 10 m away, on both sides of the origin in x and y, some missing."""
    rng = np.random.default_rng(seed)
    xyz = rng.normal([0, 0, 10], [0.6, 0.4, 0.3], (ROWS, COLUMNS, 3)).astype(np.float32)
    sigma = rng.uniform(0.01, 0.2, (ROWS, COLUMNS, sigmas)).astype(np.float32)
    missing = rng.random((ROWS, COLUMNS)) < 0.2
    xyz[missing], sigma[missing] = np.nan, np.nan
    choices = [Validity.MEASURED, FILLED, Validity.FILLED | Validity.LOW_TEXTURE]
    validity = rng.choice(choices, (ROWS, COLUMNS), p=[0.3, 0.4, 0.3]).astype(np.uint8)
    bgr = rng.integers(0, 256, (ROWS, COLUMNS, 3)).astype(np.uint8)
    count = rng.integers(1, 500, (ROWS, COLUMNS)).astype(np.uint16)
    return PointSet(Cloud(xyz, sigma), validity, bgr, count)


def naive_voxels(given: PointSet, size: float) -> dict[tuple[int, ...], list[float]]:
    """Return point, sigmas, colour, validity and frames of each voxel, pixel by pixel."""
    assert given.bgr is not None and given.averaged is not None
    members = defaultdict(list)
    for row in range(given.validity.shape[0]):
        for column in range(given.validity.shape[1]):
            xyz = [float(v) for v in given.cloud.points_xyz[row, column]]
            if not any(math.isnan(v) for v in xyz):
                members[tuple(math.floor(v / size) for v in xyz)].append((row, column))
    found = {}
    for cell, pixels in members.items():
        measured = [p for p in pixels if given.validity[p] & 1]
        counting = measured or pixels
        weights = [1 / float(given.cloud.sigma_m[p][-1]) ** 2 for p in counting]
        total, bits = sum(weights), 0
        for pixel in counting:
            bits |= int(given.validity[pixel])
        means = []
        for image in (given.cloud.points_xyz, given.cloud.sigma_m, given.bgr):
            for k in range(image.shape[2]):
                values = (w * float(image[p][k]) for w, p in zip(weights, counting, strict=True))
                means.append(sum(values) / total)
        found[cell] = [*means, bits, min(int(given.averaged[p]) for p in counting)]
    return found


@pytest.mark.parametrize(
    ('size', 'sigmas', 'scale'), [(0.3, 3, 1), (0.05, 1, 1), (5.0, 3, 1), (1e-3, 1, 1e6)]
)
def test_a_voxel_is_the_weighted_mean_of_its_points(
    size: float, sigmas: int, scale: float
) -> None:
    """Also with more cells in the volume than 64 bits count."""
    given = points(1, sigmas)
    given.cloud.points_xyz[:, : COLUMNS // 2] *= np.float32(scale)
    expected = naive_voxels(given, size)
    cloud, validity, bgr, count = thin(given, CloudConfig(voxel_size=size))
    assert (
        bgr is not None and count is not None and cloud.points_xyz.shape == (1, len(expected), 3)
    )
    kinds = set()
    for k in range(len(expected)):
        xyz = cloud.points_xyz[0, k]
        naive = expected.pop(tuple(int(v) for v in np.floor(xyz.astype(float) / size)))
        mean = [*xyz, *cloud.sigma_m[0, k]]
        np.testing.assert_allclose(mean, naive[: 3 + sigmas], rtol=1e-5, atol=1e-6)
        assert np.abs(bgr[0, k] - np.array(naive[3 + sigmas : -2])).max() <= 0.5001
        assert [validity[0, k], count[0, k]] == naive[-2:]
        kinds.add(int(validity[0, k]))
    assert not expected and Validity.MEASURED in kinds


def test_filled_points_count_where_none_was_measured_and_keep_their_reasons() -> None:
    xyz = np.full((1, 3, 3), 10.5, np.float32)
    xyz[0, 1:, 0] += 1
    sigma = np.full((1, 3, 1), 0.1, np.float32)
    ambiguous = Validity.FILLED | Validity.AMBIGUOUS
    for bits, wanted in (([1, FILLED, ambiguous], [1, 50]), ([FILLED, 1, 1], [FILLED, 1])):
        given = PointSet(Cloud(xyz, sigma), np.array([bits], np.uint8))
        thinned = thin(given, CloudConfig(voxel_size=1.0))
        assert thinned.validity.tolist() == [wanted] and thinned.bgr is None


def test_sigma_of_a_voxel_bounds_the_error_of_its_mean() -> None:
    """Reached if the errors of all points are the same; half of it if 4 are independent."""
    rng = np.random.default_rng(6)
    sigma = np.full((2, 2, 1), 0.05, np.float32)
    validity = np.ones((2, 2), np.uint8)
    spreads = {}
    for name, shape in (('same', (1, 1)), ('independent', (2, 2))):
        depths = []
        for _ in range(600):
            xyz = np.full((2, 2, 3), 10.0)
            xyz[..., 2] += 0.05 * rng.normal(size=shape)
            given = PointSet(Cloud(xyz.astype(np.float32), sigma), validity)
            thinned = thin(given, CloudConfig(voxel_size=4.0)).cloud
            assert float(thinned.sigma_z_m[0, 0]) == pytest.approx(0.05)
            depths.append(thinned.depth_m[0, 0])
        spreads[name] = float(np.std(depths))
    assert spreads['same'] == pytest.approx(0.05, rel=0.08)
    assert spreads['independent'] == pytest.approx(0.025, rel=0.08)


def test_every_nth_row_and_column() -> None:
    given = points(2)
    cloud, validity, bgr, count = thin(given, CloudConfig(decimation=4))
    assert bgr is not None and given.bgr is not None
    assert count is not None and given.averaged is not None
    assert cloud.points_xyz.shape == (6, 8, 3)
    for row in range(6):
        for column in range(8):
            pixel = 4 * row, 4 * column
            xyz = cloud.points_xyz[row, column]
            np.testing.assert_array_equal(xyz, given.cloud.points_xyz[pixel])
            np.testing.assert_array_equal(cloud.sigma_m[row, column], given.cloud.sigma_m[pixel])
            assert validity[row, column] == given.validity[pixel]
            assert bgr[row, column].tolist() == given.bgr[pixel].tolist()
            assert count[row, column] == given.averaged[pixel]


def test_voxels_of_a_decimated_cloud() -> None:
    given, both = points(3), CloudConfig(decimation=3, voxel_size=0.4)
    expected = thin(thin(given, CloudConfig(decimation=3)), CloudConfig(voxel_size=0.4))
    np.testing.assert_array_equal(thin(given, both).cloud.points_xyz, expected.cloud.points_xyz)


def test_nothing_is_changed_by_default_and_nothing_can_be_left() -> None:
    given = points(4)
    assert thin(given, CloudConfig()) is given
    given.cloud.points_xyz[:] = np.nan
    cloud, validity, bgr, count = thin(given, CloudConfig(voxel_size=0.1))
    assert cloud.points_xyz.shape == (1, 0, 3) and validity.shape == (1, 0)
    assert bgr is not None and bgr.shape == (1, 0, 3)
    assert count is not None and count.shape == (1, 0)


@pytest.mark.parametrize(
    ('options', 'message'),
    [
        ({'decimation': 0}, r'decimation must be within 1\.\.64, got 0'),
        ({'voxel_size': -0.1}, r'voxel_size must be within 0\.0\.\.100\.0 m, got -0\.1'),
        ({'voxel_size': 1e-6}, r'voxel_size must be at least 0\.0001 m, or 0 to keep every'),
    ],
)
def test_limits(options: dict[str, float], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        CloudConfig(**options)  # type: ignore[arg-type]
