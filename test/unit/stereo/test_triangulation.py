# SPDX-License-Identifier: Apache-2.0
"""Triangulation against projected points of a rig with different principal points."""

from __future__ import annotations

import numpy as np
import pytest

from binocular_recon.camera import Camera, StereoRig
from binocular_recon.cloud_config import CloudConfig
from binocular_recon.errors import ConfigError, ImageError
from binocular_recon.stereo.triangulation import triangulate
from binocular_recon.stereo.validity import Validity

WIDTH, HEIGHT = 70, 40
BASELINE_M, FX, FY, CY = 0.8, 300.0, 310.0, 18.5

MEASURED = np.full((HEIGHT, WIDTH), Validity.MEASURED, np.uint8)
EVERY = CloudConfig(max_sigma='100%')  # limited only by a third of the depth


def make_rig(offset_px: float = 0.0) -> StereoRig:
    """Return a rectified rig with cx_left - cx_right = ``offset_px``."""
    cameras = []
    for cx, tx in ((33.0, 0.0), (33.0 - offset_px, -FX * BASELINE_M)):
        projection = np.array([[FX, 0, cx, tx], [0, FY, CY, 0], [0, 0, 1, 0]])
        cameras.append(
            Camera(WIDTH, HEIGHT, projection[:, :3], np.zeros(5), np.eye(3), projection)
        )
    return StereoRig(*cameras)


@pytest.mark.kernel
@pytest.mark.parametrize('offset_px', [-32.8, 0.0, 32.8])
def test_points_project_back_to_both_images(offset_px: float) -> None:
    rig = make_rig(offset_px)
    rng = np.random.default_rng(3)
    disparity = (rng.uniform(1, 60, (HEIGHT, WIDTH)) + offset_px).astype(np.float32)
    cloud = triangulate(disparity, np.full_like(disparity, 0.1), MEASURED, rig, EVERY)
    points = np.concatenate([cloud.points_xyz, np.ones((HEIGHT, WIDTH, 1))], axis=-1)
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    for camera, shift in ((rig.left, 0.0), (rig.right, disparity)):
        image = points @ camera.P.T
        np.testing.assert_allclose(image[..., 0] / image[..., 2], columns - shift, atol=1e-3)
        np.testing.assert_allclose(image[..., 1] / image[..., 2], rows, atol=1e-3)


@pytest.mark.kernel
def test_sigma_is_the_depth_spread_of_perturbed_disparities() -> None:
    rig = make_rig(5.0)
    rng = np.random.default_rng(4)
    disparity = np.full((HEIGHT, WIDTH), 25.0, np.float32)
    sigma = np.full_like(disparity, 0.2)
    noisy = (disparity + rng.normal(0, 0.2, disparity.shape)).astype(np.float32)
    spread = np.std(triangulate(noisy, sigma, MEASURED, rig, EVERY).depth_m)
    stated = triangulate(disparity, sigma, MEASURED, rig, EVERY).sigma_z_m
    assert stated.min() == stated.max() == pytest.approx(12.0**2 / (FX * BASELINE_M) * 0.2)
    assert spread == pytest.approx(float(stated[0, 0]), rel=0.05)


@pytest.mark.kernel
def test_no_point_without_disparity_behind_infinity_or_out_of_range() -> None:
    offset = -3.0
    disparity = np.full((HEIGHT, WIDTH), 20.0, np.float32)
    disparity[0, :5] = [np.nan, offset, offset - 1, np.inf, -np.inf]
    sigma = np.ones_like(disparity)
    cloud = triangulate(disparity, sigma, MEASURED, make_rig(offset), EVERY)
    assert np.isnan(cloud.points_xyz[0, :5]).all() and np.isnan(cloud.sigma_z_m[0, :5]).all()
    assert np.isfinite(cloud.points_xyz[0, 5:]).all()
    depth = FX * BASELINE_M / 23.0
    for config in (CloudConfig(min_depth=depth + 0.1), CloudConfig(max_depth=depth - 0.1)):
        assert np.isnan(
            triangulate(disparity, sigma, MEASURED, make_rig(offset), config).depth_m
        ).all()


def test_size_of_another_rig_is_refused() -> None:
    disparity = np.zeros((HEIGHT + 1, WIDTH), np.float32)
    with pytest.raises(ImageError, match=r'disparity is \(41, 70\), .* the rig has \(40, 70\)'):
        triangulate(disparity, disparity, MEASURED, make_rig(), EVERY)


@pytest.mark.kernel
def test_only_points_of_small_sigma_are_kept() -> None:
    """Depth is 12 m everywhere; sigma_z = z^2 / (f B) sigma_d rises from 0 along the rows."""
    rig = make_rig()
    disparity = np.full((HEIGHT, WIDTH), FX * BASELINE_M / 12.0, np.float32)
    sigma_z = np.linspace(0.1, 8.0, WIDTH, dtype=np.float32)
    sigma = np.broadcast_to(sigma_z / (12.0**2 / (FX * BASELINE_M)), disparity.shape)
    for text, limit_m in (('10%', 1.2), ('0.5', 0.5), ('100%', 4.0), ('50', 4.0)):
        cloud = triangulate(disparity, sigma, MEASURED, rig, CloudConfig(max_sigma=text))
        kept = np.isfinite(cloud.depth_m)
        np.testing.assert_array_equal(kept, np.broadcast_to(sigma_z < limit_m, kept.shape))


@pytest.mark.kernel
def test_filled_points_are_kept_on_request_and_extrapolated_ones_never() -> None:
    disparity = np.full((HEIGHT, WIDTH), 30.0, np.float32)
    validity = MEASURED.copy()
    validity[:10], validity[10:20] = Validity.FILLED | Validity.CONFLICT, Validity.EXTRAPOLATED
    for keep, rows in (('all', [*range(10), *range(20, HEIGHT)]), ('measured', range(20, HEIGHT))):
        config = CloudConfig(keep=keep)
        cloud = triangulate(disparity, np.full_like(disparity, 0.1), validity, make_rig(), config)
        found = np.flatnonzero(np.isfinite(cloud.depth_m).all(axis=1))
        assert found.tolist() == list(rows)


@pytest.mark.parametrize('text', ['', '0', '0%', '-1', 'much', '5 m', 'nan', 'inf'])
def test_what_is_not_a_limit_is_refused(text: str) -> None:
    with pytest.raises(ConfigError, match=r'max_sigma must be metres or a share .* such as 0\.05'):
        CloudConfig(max_sigma=text)
