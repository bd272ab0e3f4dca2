# SPDX-License-Identifier: Apache-2.0
"""Triangulation against projected points of a rig with different principal points."""

from __future__ import annotations

import numpy as np
import pytest

from binocular_recon.camera import Camera, StereoRig
from binocular_recon.config import CloudConfig
from binocular_recon.errors import ImageError
from binocular_recon.stereo.triangulation import triangulate

WIDTH, HEIGHT = 70, 40
BASELINE_M, FX, FY, CY = 0.8, 300.0, 310.0, 18.5


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
def test_points_project_back_to_both_pictures(offset_px: float) -> None:
    rig = make_rig(offset_px)
    rng = np.random.default_rng(3)
    disparity = (rng.uniform(1, 60, (HEIGHT, WIDTH)) + offset_px).astype(np.float32)
    cloud = triangulate(disparity, np.full_like(disparity, 0.1), rig, CloudConfig())
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
    spread = np.std(triangulate(noisy, sigma, rig, CloudConfig()).depth_m)
    stated = triangulate(disparity, sigma, rig, CloudConfig()).sigma_z_m
    assert stated.min() == stated.max() == pytest.approx(12.0**2 / (FX * BASELINE_M) * 0.2)
    assert spread == pytest.approx(float(stated[0, 0]), rel=0.05)


@pytest.mark.kernel
def test_no_point_without_disparity_behind_infinity_or_out_of_range() -> None:
    offset = -3.0
    disparity = np.full((HEIGHT, WIDTH), 20.0, np.float32)
    disparity[0, :5] = [np.nan, offset, offset - 1, np.inf, -np.inf]
    sigma = np.ones_like(disparity)
    cloud = triangulate(disparity, sigma, make_rig(offset), CloudConfig())
    assert np.isnan(cloud.points_xyz[0, :5]).all() and np.isnan(cloud.sigma_z_m[0, :5]).all()
    assert np.isfinite(cloud.points_xyz[0, 5:]).all()
    depth = FX * BASELINE_M / 23.0
    for config in (CloudConfig(min_depth=depth + 0.1), CloudConfig(max_depth=depth - 0.1)):
        assert np.isnan(triangulate(disparity, sigma, make_rig(offset), config).depth_m).all()


def test_size_of_another_rig_is_refused() -> None:
    disparity = np.zeros((HEIGHT + 1, WIDTH), np.float32)
    with pytest.raises(ImageError, match=r'disparity is \(41, 70\) .* the rig has \(40, 70\)'):
        triangulate(disparity, disparity, make_rig(), CloudConfig())
