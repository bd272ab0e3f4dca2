# SPDX-License-Identifier: Apache-2.0
"""Lens models against OpenCV, their derivatives, and their exact inversion."""

from __future__ import annotations

from itertools import pairwise

import cv2
import numpy as np
import pytest

from binocular_recon.camera import FloatArray
from binocular_recon.lenses import LENSES
from test.calibration_tools import numeric_jacobian

SIZE = (1920, 1200)
K = np.array([[700.0, 0, 955], [0, 710, 604], [0, 0, 1]])
REALISTIC = {
    'plumb_bob': [
        [],
        [-0.08, 0.03, 5e-4, -3e-4],
        [-0.30, 0.10, 2e-4, 1e-4],
        [0.12, -0.05, -1e-3, 2e-3, 0.02],
    ],
    'rational_polynomial': [
        [0.3, -0.1, 1e-4, -2e-4, 0.02, 0.5, -0.05, 0.01],
        [8.5, 4.9, 1e-4, -2e-5, 0.2, 8.9, 7.9, 1.3],
        [0.3, -0.1, 1e-4, -2e-4, 0.02, 0.5, -0.05, 0.01, 1e-3, -2e-4, -5e-4, 1e-4],
        [0.3, -0.1, 1e-4, -2e-4, 0.02, 0.5, -0.05, 0.01, 1e-3, 0, -5e-4, 0, 0.02, -0.03],
    ],
    'equidistant': [[0.0] * 4, [-0.02, 0.01, -0.003, 0.001], [0.05, -0.02, 0.01, -0.002]],
}  # fmt: skip
CASES = [(name, D) for name, many in REALISTIC.items() for D in many]


def raw_grid(margin_px: float = 0.0) -> FloatArray:
    """Return a grid over the image, and beyond it by a margin, px."""
    axes = [np.linspace(-margin_px, side - 1 + margin_px, 33) for side in SIZE]
    return np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)


def round_trip_px(name: str, D: FloatArray, pixels: FloatArray, K: FloatArray = K) -> FloatArray:
    """Return how far pixels are from themselves after undistortion and distortion; NaN stays."""
    lens = LENSES[name]
    errors: FloatArray = np.linalg.norm(
        lens.pixels(lens.rays(pixels, K, D), K, D) - pixels, axis=1
    )
    return errors


@pytest.mark.parametrize(('name', 'D'), CASES)
def test_distortion_is_that_of_opencv(name: str, D: list[float]) -> None:
    rays = np.random.default_rng(0).uniform(-0.8, 0.8, (200, 2))
    points = np.column_stack([rays, np.ones(200)])[:, None]
    module = cv2.fisheye if name == 'equidistant' else cv2
    expected = module.projectPoints(points, np.zeros(3), np.zeros(3), K, np.array(D))[0][:, 0]
    np.testing.assert_allclose(LENSES[name].pixels(rays, K, np.array(D)), expected, atol=1e-9)


@pytest.mark.parametrize('name', ['plumb_bob', 'rational_polynomial', 'equidistant'])
def test_derivatives_are_those_of_central_differences(name: str) -> None:
    lens = LENSES[name]
    D = np.array(REALISTIC[name][1])
    D = np.pad(D, (0, 8 - D.size)) if name == 'plumb_bob' else D
    focal = np.array([700.0, 710.0])
    rays = np.array([[0.3, -0.2], [0.0, 0.0], [1e-5, 0.0], [-0.9, 0.7]])
    points, by_ray, by_coefficient = lens.derivatives(rays, D, focal)
    np.testing.assert_allclose(points, lens.distort(rays, D), atol=1e-15)
    for index, ray in enumerate(rays):
        numeric = numeric_jacobian(lambda r: lens.distort(r, D), ray)
        np.testing.assert_allclose(by_ray[index], numeric, atol=1e-8)
        numeric = numeric_jacobian(lambda d: focal * lens.distort(ray, d), D)  # noqa: B023
        np.testing.assert_allclose(by_coefficient[index], numeric, atol=1e-5)


@pytest.mark.parametrize(('name', 'D'), CASES)
def test_the_whole_image_of_a_real_lens_is_undistorted_exactly(name: str, D: list[float]) -> None:
    coefficients = np.array(D)
    rays = np.random.default_rng(0).uniform(-0.75, 0.75, (500, 2))
    lens = LENSES[name]
    found = lens.undistort(lens.distort(rays, coefficients), coefficients)
    np.testing.assert_allclose(found, rays, atol=1e-12)
    assert np.nanmax(round_trip_px(name, coefficients, raw_grid())) < 1e-9


@pytest.mark.parametrize('name', [name for name in LENSES if LENSES[name].COEFFICIENTS])
def test_what_a_calibration_needs_of_a_lens_fits_together(name: str) -> None:
    lens = LENSES[name]
    sets = list(lens.models.values())
    assert lens.models[lens.default_model] == lens.DEFAULT_COEFFICIENTS
    assert sets[0] == () and sets[-1] == lens.COEFFICIENTS
    assert all(smaller == larger[: len(smaller)] for smaller, larger in pairwise(sets))
    assert set(lens.TANGENTIAL) <= set(lens.COEFFICIENTS)
    for values in (np.zeros(len(lens.COEFFICIENTS)), np.full(len(lens.COEFFICIENTS), 0.01)):
        model, D = lens.stated(values)
        assert D.size in LENSES[model].counts
        np.testing.assert_array_equal(D, values[: D.size])
        assert not values[D.size :].any()


def test_the_strong_distortion_of_a_wide_lens_is_undone_where_opencv_is_off() -> None:
    K_wide = np.array([[1000.0, 0, 960], [0, 1000, 600], [0, 0, 1]])
    D = np.array([-0.30, 0.10, 0, 0])
    pixels = raw_grid()
    lens = LENSES['plumb_bob']
    rays = lens.rays(pixels, K_wide, D)
    assert np.linalg.norm(lens.pixels(rays, K_wide, D) - pixels, axis=1).max() < 1e-9
    five = cv2.undistortPoints(pixels[:, None], K_wide, D)[:, 0]
    assert 1000 * np.abs(five - rays).max() > 0.1


@pytest.mark.parametrize('name', LENSES)
def test_round_trips_of_any_coefficients_are_exact_or_nan(name: str) -> None:
    """Realistic and extreme coefficients; half of the latter fold the image or have a pole."""
    rng = np.random.default_rng(7)
    lens, pixels = LENSES[name], raw_grid(200.0)
    K_long = K * [[2.0, 1, 1], [1, 2, 1], [1, 1, 1]]
    undone = []
    for spread in np.repeat([0.02, 0.1, 0.5, 2.0, 10.0], 12):
        count = rng.choice(lens.counts[-2:])
        D = rng.normal(0, spread, count)
        if name != 'equidistant':
            D[2:4] *= 0.02
            D[8:12] *= 0.02
            D[12:] = rng.normal(0, 0.05, D[12:].size)
        errors = round_trip_px(name, D, pixels, K_long)
        assert np.nanmax(errors, initial=0.0) < 1e-6, D
        undone.append(np.isfinite(errors).mean())
    assert undone[0] > 0.9 and min(undone) < 0.5


@pytest.mark.parametrize(
    'D',
    [
        [-0.318, -0.191, -0.003, -0.002, 0.106, 0.028, 0.387, -0.351],
        [-0.23, 0.188, -0.001, 0.0, -0.091, -0.352, 0.839, -0.347],
        [0.516, -0.915, -0.004, 0.003, 0.501, 0.037, 0.816, -0.23],
    ],
)
def test_a_pole_outside_of_the_image_does_not_matter(D: list[float]) -> None:
    """A rational lens whose denominator vanishes at radius 1.4 to 2; the rays end at 0.6."""
    angle, radius = np.meshgrid(np.linspace(0, 2 * np.pi, 24), np.linspace(0, 0.6, 31))
    rays = radius[..., None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    lens, coefficients = LENSES['rational_polynomial'], np.array(D)
    found = lens.undistort(lens.distort(rays, coefficients), coefficients)
    np.testing.assert_allclose(found, rays, atol=1e-12)


def test_behind_a_fold_nothing_is_made_up() -> None:
    """Radius r (1 - r^2 / 3) grows up to r = 1, where it is 2 / 3, and falls beyond."""
    lens, D = LENSES['plumb_bob'], np.array([-1 / 3, 0, 0, 0])
    reached = lens.undistort(np.array([[0.66, 0.0], [0.0, -0.666666]]), D)
    assert np.isfinite(reached).all() and (np.abs(reached) < 1).all()
    missed = lens.undistort(np.array([[0.67, 0.0], [2.0, 1.0], [np.nan, 0.0]]), D)
    assert np.isnan(missed).all()


def test_a_fisheye_ends_at_ninety_degrees() -> None:
    lens, D = LENSES['equidistant'], np.zeros(4)
    rays = lens.undistort(np.array([[1.5, 0.0], [0.0, 1.58], [1.2, -1.2]]), D)
    np.testing.assert_allclose(rays[0], [np.tan(1.5), 0.0], rtol=1e-12)
    assert np.isnan(rays[1:]).all()
