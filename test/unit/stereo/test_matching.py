# SPDX-License-Identifier: Apache-2.0
"""Matching against reference values, a naive twin and images of known disparity."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from binocular_recon.config import ChainConfig
from binocular_recon.errors import ImageError
from binocular_recon.stereo.confidence import confidence_from_sigma, sigma_from_confidence
from binocular_recon.stereo.matching import match, ncc_scores
from binocular_recon.stereo.matching._preparation_kernels import level_range
from binocular_recon.stereo.matching.refinement import drop_speckles
from test import naive_ncc
from test.unit.stereo.matching_pairs import both_ways, config, shifted_pair, texture

pytestmark = pytest.mark.kernel
REFERENCE = Path(__file__).parents[2] / 'data' / 'ncc.npz'


def test_scores_equal_the_reference() -> None:
    reference = np.load(REFERENCE)
    options = config(correlation_window_size=7, texture_threshold=0.0)
    scores = ncc_scores(
        reference['left'].astype(np.float32), reference['right'].astype(np.float32), options
    )
    expected = reference['score']
    np.testing.assert_array_equal(np.isnan(scores), np.isnan(expected))
    assert np.nanmax(np.abs(scores - expected)) < 1e-6


@pytest.mark.parametrize(
    ('height', 'width', 'size', 'first', 'count', 'threshold'),
    [
        (12, 21, 3, 0, 9, 0.0),
        (13, 24, 5, -7, 15, 10.0),
        (11, 40, 9, 4, 3, 1.0),
        (31, 33, 31, -2, 5, 0.0),
        (9, 14, 3, 20, 4, 0.0),  # no partner inside the image
        (9, 14, 3, -30, 4, 0.0),
    ],
)
@pytest.mark.parametrize('fine', [False, True])
def test_scores_equal_the_naive_twin(
    height: int, width: int, size: int, first: int, count: int, threshold: float, fine: bool
) -> None:
    left, right = texture(height, width, 1), texture(height, width, 2)
    left[3:5, 2:6] = 255  # flat, as where saturated
    left[7, 9], right[2, 8] = np.nan, np.nan
    if fine:
        left, right = (
            left / np.float32(257) + 100,
            right / np.float32(257) + 20,
        )  # all 16 bits matter
    options = config(
        correlation_window_size=size,
        min_disparity=first,
        disparity_range=count,
        texture_threshold=threshold / (257 if fine else 1),
    )
    steps = 257 if fine else 1
    expected = naive_ncc.ncc(
        np.rint(left * steps), np.rint(right * steps), size, first, count, threshold
    )
    scores = ncc_scores(left, right, options)
    np.testing.assert_array_equal(np.isnan(scores), np.isnan(expected))
    if np.isfinite(expected).any():
        assert np.nanmax(np.abs(scores - expected)) < 2e-6


@pytest.mark.parametrize('width', [5, 32, 71])
def test_levels_of_another_unit_are_found_wherever_they_are(width: int) -> None:
    rng = np.random.default_rng(7)
    for image in (texture(3, width, 1), np.full((3, width), np.nan, np.float32)):
        low, high = rng.permutation(image.size)[:2]
        image.flat[low], image.flat[high] = -300, 700
        image.flat[(low + 1) % image.size if (low + 1) % image.size != high else low - 1] = np.nan
        assert level_range(image) == (-300, 700)
    assert level_range(np.full((3, width), np.nan, np.float32)) == (np.inf, -np.inf)


def test_winners_equal_the_naive_twin() -> None:
    left, right = texture(14, 40, 3), texture(14, 40, 4)
    scores = naive_ncc.ncc(left, right, 5, 0, 13, 0.0)
    best, back = naive_ncc.winners(scores)
    options = ChainConfig.preset('paper', disparity_range=13, correlation_window_size=5).match
    disparity = match(left, right, options).disparity_px
    np.testing.assert_array_equal(disparity, np.where(best < 0, np.nan, best))

    checked = match(
        left,
        right,
        ChainConfig.preset(
            'paper', disparity_range=13, correlation_window_size=5, disp12_max_diff=1.0
        ).match,
    ).disparity_px
    y, x = np.nonzero(best >= 0)
    agree = np.abs(back[y, x - best[y, x]] - best[y, x]) <= 1
    assert 0 < agree.sum() < agree.size
    # nor at the limits of the range, nor where the images do not correlate
    agree &= (best[y, x] > 0) & (best[y, x] < 12) & (scores[y, x, best[y, x]] > 0)
    np.testing.assert_array_equal(np.isfinite(checked[y, x]), agree)


def test_confidence_carries_sigma() -> None:
    sigma = np.array([0.0, 0.02, 0.25, 1.0, 8.0, np.inf, np.nan], np.float32)
    confidence = confidence_from_sigma(sigma)
    assert confidence.dtype == np.float32
    np.testing.assert_allclose(confidence[[0, 2, 5, 6]], [1.0, 0.5, 0.0, 0.0])
    back = sigma_from_confidence(confidence)
    np.testing.assert_allclose(back[:6], sigma[:6], rtol=2e-3)
    assert back[6] == np.inf


@pytest.mark.large
@both_ways
@pytest.mark.parametrize('disparity', [0.0, 5.0, 9.3, -3.75])
def test_constant_disparity_is_found_to_a_fraction_of_a_pixel(
    disparity: float, semi_global: bool
) -> None:
    left, right = shifted_pair(60, 100, disparity)
    options = config(
        min_disparity=-8,
        disparity_range=24,
        correlation_window_size=5 if semi_global else 9,
        semi_global=semi_global,
    )
    found = match(left, right, options)
    inside = found.disparity_px[20:40, 30:70]
    assert np.isfinite(inside).mean() > 0.98
    assert np.nanmedian(np.abs(inside - disparity)) < 0.05
    assert np.all(found.confidence[np.isnan(found.disparity_px)] == 0)
    assert np.all(found.confidence[np.isfinite(found.disparity_px)] > 0)


@both_ways
@pytest.mark.parametrize(('height', 'width'), [(40, 1), (1, 40), (3, 3), (23, 57)])
def test_any_size_works(height: int, width: int, semi_global: bool) -> None:
    left = texture(height, width)
    options = config(correlation_window_size=3, semi_global=semi_global)
    found = match(left, left, options)
    assert found.disparity_px.shape == (height, width)
    if min(height, width) < 3:
        assert np.isnan(found.disparity_px).all()
        assert not found.confidence.any()
        assert np.isnan(ncc_scores(left, left, options)).all()


@both_ways
@pytest.mark.parametrize(
    ('size', 'first', 'count'),
    [(3, -11, 9), (5, -9, 100), (7, -45, 90), (31, -8, 13)],
)
def test_any_window_and_range_work(size: int, first: int, count: int, semi_global: bool) -> None:
    left, right = shifted_pair(45, 71, -5.0)
    options = config(
        correlation_window_size=size,
        min_disparity=first,
        disparity_range=count,
        semi_global=semi_global,
        speckle_size=0,
    )
    disparity = match(left, right, options).disparity_px
    inside = disparity[16:-16, 20:-20]
    assert np.mean(np.abs(inside + 5) < 0.25) > 0.95
    found = disparity[np.isfinite(disparity)]
    low, high = options.limits_px
    assert low <= found.min() <= found.max() <= high


@both_ways
@pytest.mark.filterwarnings('error')
@pytest.mark.parametrize('level', [0.0, 255.0, 77.0, np.nan])
def test_images_without_texture_have_no_match(level: float, semi_global: bool) -> None:
    blank = np.full((30, 40), level, np.float32)
    found = match(blank, blank, config(semi_global=semi_global))
    assert np.isnan(found.disparity_px).all()
    assert not found.confidence.any()


@both_ways
@pytest.mark.parametrize('side', [0, 1])
def test_pixels_without_data_or_saturated_are_invalid(semi_global: bool, side: int) -> None:
    pair = shifted_pair(50, 90, 4.0)
    pair[side][10:22, 40:60] = np.nan
    pair[side][30:44, 40:60] = 255.0
    # windows of half resolution would reach over these regions
    options = config(semi_global=semi_global, half_resolution=False)
    disparity = match(*pair, options).disparity_px
    shift = 4 * side
    assert np.isnan(disparity[10:22, 40 + shift : 60 + shift]).all()
    assert np.isnan(disparity[34:40, 44 + shift : 56 + shift]).all()


def test_errors_say_what_and_why() -> None:
    good = texture(20, 30)
    with pytest.raises(ImageError, match=r'left is \(20, 30\) and right \(20, 31\)'):
        match(good, texture(20, 31), config())
    with pytest.raises(ImageError, match='grey images'):
        match(good[None], good[None], config())
    with pytest.raises(
        ImageError,
        match=r'right has grey levels from .* to 65[0-9]*.* floating-point images within 0\.\.1',
    ):
        match(good, good * 257, config())


def test_speckles_are_removed() -> None:
    disparity = np.full((40, 60), 6.25, np.float32)
    disparity[5:10, 5:10] = 12.0
    disparity[20:32, 20:32] = 8.0
    disparity[20:32, 40:] = np.nan
    expected = disparity.copy()
    expected[5:10, 5:10] = np.nan
    drop_speckles(disparity, config(speckle_size=60))
    np.testing.assert_array_equal(disparity, expected)


@pytest.mark.large
def test_sigma_is_calibrated_and_not_constant() -> None:
    left, right = shifted_pair(120, 200, 7.3)
    rng = np.random.default_rng(5)
    noise = np.linspace(0.5, 25, 120)[:, None] * rng.normal(size=left.shape)
    found = match(left + noise.clip(-100, 100), right, config(speckle_size=0))
    error = found.disparity_px - 7.3
    inside = np.isfinite(error) & (np.abs(error) < 1)
    inside[:, :30] = False
    sigma = sigma_from_confidence(found.confidence)
    calm, loud = (inside & (np.arange(120)[:, None] // 60 == half) for half in (0, 1))
    for part in (calm, loud):
        assert 0.3 < np.sqrt(np.mean((error[part] / sigma[part]) ** 2)) < 1.6
    assert sigma[loud].mean() > 1.2 * sigma[calm].mean()


def test_whole_pixels_have_unit_confidence() -> None:
    left, right = shifted_pair(40, 60, 4.0)
    found = match(left, right, ChainConfig.preset('paper', disparity_range=16).match)
    measured = np.isfinite(found.disparity_px)
    np.testing.assert_array_equal(found.confidence, measured.astype(np.float32))
