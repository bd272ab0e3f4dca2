# SPDX-License-Identifier: Apache-2.0
"""A lens that is registered, and nothing else, is calibrated, saved and rectified."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from binocular_recon.calibration.adjustment.uncertainty import depth_sigma_m
from binocular_recon.calibration.result import CalibrationResult
from binocular_recon.calibration.session.calibration_files import save_calibration
from binocular_recon.calibration.solve import calibrate
from binocular_recon.camera import FloatArray
from binocular_recon.errors import CalibrationError
from binocular_recon.evaluation.calibration.self_check import (
    simulated_boards,
    simulated_captures,
    true_calibration,
)
from binocular_recon.io.calibration_yaml import read_rig
from binocular_recon.lenses import LENSES, Lens
from binocular_recon.simulation.rig import RawRig, fisheye_rig, survey_rig
from binocular_recon.stereo.rectification import Rectifier, rectification_maps, rectified_points
from test.calibration_tools import (
    SIZE,
    board_of,
    check_sigmas,
    fisheye_captures,
    numeric_jacobian,
)

pytestmark = pytest.mark.long


class RadialLens(Lens):
    """A lens that images a ray at the ray times a factor of its squared distance r2."""

    COEFFICIENTS = DEFAULT_COEFFICIENTS = ('k1',)

    def factor(self, r2: FloatArray, k1: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the factor and its derivatives by r2 and by k1."""
        raise NotImplementedError

    def distort(self, rays: FloatArray, D: FloatArray) -> FloatArray:
        factor = self.factor(np.sum(rays**2, axis=-1), D[0])[0]
        return np.asarray(rays * factor[..., None])

    def derivatives(
        self, rays: FloatArray, D: FloatArray, scale: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        factor, by_r2, by_k1 = self.factor(np.sum(rays**2, axis=-1), D[0])
        outer = rays[..., :, None] * rays[..., None, :]
        by_ray = factor[..., None, None] * np.eye(2) + 2 * by_r2[..., None, None] * outer
        return (
            rays * factor[..., None],
            by_ray,
            (scale * rays * by_k1[..., None])[..., None],
        )


class DivisionLens(RadialLens):
    """Undistorted = distorted / (1 + k1 r^2), r that of the distorted point (Fitzgibbon 2001)."""

    def factor(self, r2: FloatArray, k1: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        q = np.sqrt(1 - 4 * k1 * r2)
        slope = 4 / (q * (1 + q) ** 2)
        return 2 / (1 + q), k1 * slope, r2 * slope

    def undistort(self, points: FloatArray, D: FloatArray) -> FloatArray:
        return np.asarray(points / (1 + D[0] * np.sum(points**2, axis=-1, keepdims=True)))


class StereographicLens(RadialLens):
    """Fisheye with the distance s (1 + k1 s^2) from the centre, s = 2 tan(angle / 2)."""

    WIDE_ANGLE = True

    def factor(self, r2: FloatArray, k1: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        w = np.sqrt(1 + r2)
        s2 = 4 * (w - 1) / (w + 1)
        ideal, slope = 2 / (1 + w), 2 / (1 + w) ** 2
        by_r2 = (8 * k1 * ideal / (w + 1) ** 2 - slope * (1 + k1 * s2)) / (2 * w)
        return ideal * (1 + k1 * s2), by_r2, ideal * s2

    def undistort(self, points: FloatArray, D: FloatArray) -> FloatArray:
        distance = np.linalg.norm(points, axis=-1)
        s = distance.copy()
        for _ in range(20):
            s = s - (s + D[0] * s**3 - distance) / (1 + 3 * D[0] * s**2)
        s = np.where(s < 2, s, np.nan)  # less than 90 degrees from the axis
        stretch = np.where(s > 0, s / (1 - s**2 / 4) / np.where(s > 0, distance, 1.0), 1.0)
        return np.asarray(points * stretch[..., None])


@pytest.fixture
def own_lens(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Lens:
    lens: Lens = request.param
    monkeypatch.setitem(LENSES, lens.name, lens)
    return lens


def rig_of(lens: Lens) -> RawRig:
    """Return a rig whose cameras have slightly different lenses of this kind."""
    rig, k1 = (fisheye_rig(), -0.02) if lens.WIDE_ANGLE else (survey_rig(), -0.12)
    left, right = (
        replace(camera, D=np.array([value]), distortion_model=lens.name)
        for camera, value in ((rig.left, k1), (rig.right, 1.5 * k1))
    )
    return replace(rig, left=left, right=right)


def calibrated(rig: RawRig) -> CalibrationResult:
    lens = rig.left.lens
    if lens.WIDE_ANGLE:
        captures = fisheye_captures(rig=rig)
    else:
        captures = simulated_captures(rig, simulated_boards(rig, 0.005, 14, 0, 0), 0.2, (0, 0))
    return calibrate(captures, board_of(0.005), SIZE, lens=lens.name)


OWN_LENSES = pytest.mark.parametrize(
    'own_lens',
    [DivisionLens('division', (1,)), StereographicLens('stereographic', (1,))],
    indirect=True,
    ids=lambda lens: lens.name,
)


@OWN_LENSES
def test_the_lens_of_this_test_is_sound(own_lens: Lens) -> None:
    rays = np.random.default_rng(0).uniform(-0.8, 0.8, (50, 2))
    D, focal = np.array([-0.03]), np.array([700.0, 710.0])
    points, by_ray, by_coefficient = own_lens.derivatives(rays, D, focal)
    np.testing.assert_allclose(own_lens.undistort(points, D), rays, atol=1e-12)
    for ray, numeric, of_k1 in zip(rays, by_ray, by_coefficient, strict=True):
        expected = numeric_jacobian(lambda r: own_lens.distort(r, D), ray)
        np.testing.assert_allclose(numeric, expected, atol=1e-8)
        expected = numeric_jacobian(lambda d: focal * own_lens.distort(ray, d), D)  # noqa: B023
        np.testing.assert_allclose(of_k1, expected, atol=1e-5)


@OWN_LENSES
def test_a_registered_lens_is_calibrated(own_lens: Lens, tmp_path: Path) -> None:
    rig = rig_of(own_lens)
    truth, result = true_calibration(rig), calibrated(rig)
    assert result.calibration.lens == own_lens.name
    assert not result.rejected and result.model == 'k1'
    assert [evidence.model for evidence in result.evidence] == ['none', 'k1']
    # the marks call for the coefficient, and show no error but their noise
    assert result.evidence[0].bic > 100
    assert result.adjusted.error_px < 1.1 * 0.2
    check_sigmas(result, truth)
    assert result.sigma['k1_right'] < 0.005
    # depth at 15 m is off by what the covariance says
    reach = 1.2 if own_lens.WIDE_ANGLE else 0.4
    x, y = np.meshgrid(np.linspace(-reach, reach, 7), np.linspace(-0.3, 0.3, 5))
    points = 15.0 * np.column_stack([x.ravel(), y.ravel(), np.ones(x.size)])
    pixels = [truth.project(points, side) for side in ('left', 'right')]
    errors = (result.calibration.triangulate(*pixels) - points)[:, 2]
    estimate = result.estimate
    sigma = depth_sigma_m(result.calibration, estimate.problem.free, estimate.covariance, points)
    assert np.abs(errors / sigma).max() < 4
    # files, report
    save_calibration(result, tmp_path)
    saved = read_rig(tmp_path)
    assert saved.left.distortion_model == own_lens.name
    np.testing.assert_array_equal(saved.right.D, result.calibration.D_right)
    report = (tmp_path / 'report.html').read_text()
    assert '<td>k1</td>' in report and '<td>k2</td>' not in report
    # rows of rectified points correspond, and images are rectified with the same lens
    rows = [
        rectified_points(camera, px)[:, 1]
        for camera, px in zip((saved.left, saved.right), pixels, strict=True)
    ]
    assert np.abs(rows[0] - rows[1]).mean() < 0.3
    columns_raw, rows_raw = rectification_maps(saved.left)
    back = rectified_points(saved.left, np.array([[columns_raw[600, 900], rows_raw[600, 900]]]))
    np.testing.assert_allclose(back, [[900, 600]], atol=1e-3)
    image = np.full((SIZE[1], SIZE[0]), 100, np.uint8)
    left, _ = Rectifier(saved)(image, image)
    assert left[600, 900] == 100


@OWN_LENSES
def test_a_simulated_rig_with_it_is_rectified(own_lens: Lens) -> None:
    rig = rig_of(own_lens)
    rectified, point = rig.stereo_rig(), np.array([[1.0, -0.5, 8.0]])
    rows = [
        rectified_points(camera, view.project(point))[0, 1]
        for camera, view in zip((rectified.left, rectified.right), rig.views(), strict=True)
    ]
    assert rows[0] == pytest.approx(rows[1], abs=1e-6)
    with pytest.raises(CalibrationError, match='cannot be simulated, only its marks'):
        _ = rig.views()[0].numbers


def test_pixels_that_no_ray_reaches_have_no_data() -> None:
    """Half of an image rectified to look 90 degrees aside lies behind the camera."""
    lens = DivisionLens('division', (1,))
    K = np.array([[100.0, 0, 50], [0, 100, 40], [0, 0, 1]])
    aside = np.array([[0.0, 0, -1], [0, 1, 0], [1, 0, 0]])
    columns, rows = lens.raw_pixels(K, np.array([-0.01]), aside, K, (101, 81))
    ahead = np.isfinite(columns) & np.isfinite(rows)
    assert columns.dtype == np.float32 and columns.shape == (81, 101)
    assert not ahead[:, 51:].any() and ahead[:, :50].all()
