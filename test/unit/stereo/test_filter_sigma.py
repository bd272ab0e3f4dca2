# SPDX-License-Identifier: Apache-2.0
"""The standard deviation that the filter states, and what it refuses."""

from __future__ import annotations

import numpy as np
import pytest

from binocular_recon.config import FilterConfig
from binocular_recon.errors import ImageError
from binocular_recon.images import FloatImage
from binocular_recon.stereo.confidence import confidence_from_sigma
from binocular_recon.stereo.filtering._filter_kernels import SigmaTerms, standard_deviation
from binocular_recon.stereo.filtering.wls_filter import (
    LEAST_SIGMA_PX,
    sigma_if_right,
)
from test.unit.stereo.filter_scene import NAN, run


def test_sigma_follows_match_scatter_and_hole() -> None:
    rng = np.random.default_rng(10)
    shape = (60, 90)
    guide = np.full(shape, 100, np.float32)
    disparity = np.full(shape, 20, np.float32)
    sigma = np.full(shape, 0.1, np.float32)
    sigma[:, 45:] = 0.4
    disparity += (sigma * rng.normal(size=shape)).astype(np.float32)
    disparity[20:40, 60:80] = np.nan
    result = run(disparity, confidence_from_sigma(sigma), guide, FilterConfig()).sigma_px
    steady, noisy, hole = result[10:50, 5:35], result[5:15, 60:80], result[28:32, 68:72]
    assert 0.1 < np.median(steady) < 0.25
    assert 0.4 < np.median(noisy) < 1.0
    assert np.median(hole) > 1
    assert hole.min() > 1.5 * result[15:19, 65:75].max()
    assert (result >= LEAST_SIGMA_PX).all()


def test_whole_pixels_are_not_more_certain_than_their_rounding() -> None:
    """A plane between 20.0 and 20.45 px, rounded to 20: the scatter does not show the error."""
    ones, guide = np.ones((30, 40), np.float32), np.full((30, 40), 100, np.float32)
    plane = (20 + 0.45 * np.arange(40) / 40 * ones).astype(np.float32)
    whole = run(np.rint(plane), ones, guide, FilterConfig())
    normalised = (whole.disparity_px - plane) / whole.sigma_px
    assert 0.7 < np.sqrt(np.mean(normalised**2)) < 1.4
    assert run(plane, ones, guide, FilterConfig()).sigma_px.max() < 0.2
    shifted = np.rint(plane) - np.float32(32.778) + np.float32(32.778)  # through a message
    assert run(shifted, ones, guide, FilterConfig()).sigma_px.min() > 0.28


def test_a_hole_between_far_and_near_is_less_certain() -> None:
    disparity = np.full((30, 60), 10, np.float32)
    ones, guide = np.ones_like(disparity), np.full_like(disparity, 100)
    disparity[:, 20:30] = np.nan
    even = run(disparity, ones, guide, FilterConfig()).sigma_px[15, 25]
    disparity[:, 30:] = 30
    assert run(disparity, ones, guide, FilterConfig()).sigma_px[15, 25] > even + 2


def test_sigma_of_a_match_that_is_right_leaves_out_the_share_of_mismatches() -> None:
    right = np.array([0.01, 0.2, 0.45, 0.6, 2.0])
    np.testing.assert_allclose(sigma_if_right(np.sqrt(right**2 + right**6 / 0.45**4)), right)


def naive_with_bends(sigma: FloatImage, filtered: FloatImage) -> FloatImage:
    """Add the share of steps to a standard deviation, pixel by pixel."""
    height, width = filtered.shape
    result = np.empty_like(sigma)
    for y in range(height):
        for x in range(width):
            bend = 0.0
            for reach in (2, 4):
                for dy, dx in ((0, reach), (reach, 0)):
                    if dy <= y < height - dy and dx <= x < width - dx:
                        ends = float(filtered[y - dy, x - dx]) + float(filtered[y + dy, x + dx])
                        bend = max(bend, abs(ends - 2 * float(filtered[y, x])))
            variance = float(sigma[y, x]) ** 2
            more = max(min(bend, 4.0) ** 2 - 9 * variance, 0.0) / 4
            result[y, x] = np.sqrt(variance + more)
    return result


@pytest.mark.kernel
@pytest.mark.parametrize('shape', [(14, 20), (3, 30), (30, 3), (9, 8)])
def test_bends_equal_the_naive_twin(shape: tuple[int, int]) -> None:
    rng = np.random.default_rng(3)
    filtered = (20 + rng.choice([0.0, 0.3, 2.0, 9.0], shape)).astype(np.float32)
    measured: FloatImage = filtered + rng.normal(0, 0.2, shape).astype(np.float32)
    measured[rng.uniform(size=shape) < 0.2] = np.nan
    level = rng.uniform(0.2, 0.9, shape).astype(np.float32)
    terms = SigmaTerms(measured, filtered, level, 0.06, 0.01, 0.0, np.ones_like(level))
    with_bends, without = np.empty_like(level), np.empty_like(level)
    standard_deviation(terms, with_bends, 0, shape[0])
    # bends are those of the filtered disparities; a plane has none
    flat = np.zeros_like(filtered)
    standard_deviation(
        terms._replace(measured=measured - filtered, filtered=flat), without, 0, len(flat)
    )
    expected = np.where(np.isnan(measured), without, naive_with_bends(without, filtered))
    np.testing.assert_allclose(with_bends, expected, rtol=2e-4)


def test_sigma_near_a_step_is_half_of_it_and_on_a_plane_nothing_changes() -> None:
    ones, guide = np.ones((40, 60), np.float32), np.full((40, 60), 100, np.float32)
    plane = (20 + 0.1 * np.arange(60) * ones).astype(np.float32)
    on_plane = run(plane, ones, guide, FilterConfig()).sigma_px
    step = (ones * (np.arange(60) >= 30)).astype(np.float32)
    stepped = run(plane + 3 * step, ones, guide, FilterConfig()).sigma_px
    far = np.r_[8:20, 40:52]
    np.testing.assert_allclose(stepped[10:30, far], on_plane[10:30, far], atol=0.02)
    assert 1.2 < np.median(stepped[10:30, 28:32]) < 2.0
    # a step of any size adds at most 2 px
    large = run(plane + 30 * step, ones, guide, FilterConfig()).sigma_px
    assert large.max() < 2.1


def test_nothing_to_filter() -> None:
    nothing = np.full((4, 5), NAN)
    message = r'no pixel has a disparity within 0\.\.64 px and a confidence above 0; check'
    with pytest.raises(ImageError, match=message):
        run(nothing, np.ones_like(nothing), nothing)
    with pytest.raises(ImageError, match=message):
        run(np.ones_like(nothing), np.zeros_like(nothing), nothing)


@pytest.mark.parametrize('name', ['confidence', 'guide', 'initial'])
def test_sizes_differ(name: str) -> None:
    image = np.ones((4, 5), np.float32)
    images = {'confidence': image, 'guide': image, 'initial': image, name: image.T}
    with pytest.raises(ImageError, match=rf'disparity is \(4, 5\) and {name} \(5, 4\)'):
        run(image, images['confidence'], images['guide'], initial=images['initial'])


@pytest.mark.parametrize('shape', [(0, 5), (5,), (2, 3, 1)])
def test_not_an_image(shape: tuple[int, ...]) -> None:
    image = np.ones(shape, np.float32)
    with pytest.raises(ImageError, match='disparity must be'):
        run(image, image, image)
