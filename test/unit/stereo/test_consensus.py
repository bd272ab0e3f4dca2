# SPDX-License-Identifier: Apache-2.0
"""Consensus of several matches, and the preset that uses it."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from binocular_recon import _jit
from binocular_recon.config import ChainConfig, MatchConfig
from binocular_recon.evaluation.speed.synthetic import synthetic_pair
from binocular_recon.images import FloatImage, to_grey
from binocular_recon.stereo.matching import match
from binocular_recon.stereo.matching.consensus import (
    AGREEMENT_PX,
    to_left_image,
    vote,
    voter_configs,
)
from binocular_recon.stereo.pipeline import estimate_disparity

SLANTED = ChainConfig.preset('accurate', disparity_range=32)


def slanted_pair() -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.uint8], FloatImage]:
    """Return images of a plane with noise, 100 x 160, and its disparity."""
    rng = np.random.default_rng(3)
    whole = cv2.GaussianBlur(rng.normal(size=(100, 220)), (0, 0), 1.5).astype(np.float32)
    whole = 128 + 40 * whole / whole.std()
    y, x = np.mgrid[:100, :160].astype(np.float32)
    truth = 16 - 0.08 * x + 0.05 * y
    # the right image shows at x what lies at left column c: c - truth(c) = x
    c = (x + 16 + 0.05 * y) / 1.08
    right = cv2.remap(whole, c + 30, y, cv2.INTER_CUBIC)
    left, right = (
        np.rint(image + rng.normal(0, 4, truth.shape)).clip(0, 255).astype(np.uint8)
        for image in (whole[:, 30:190], right)
    )
    return left, right, truth


@pytest.mark.parametrize(
    ('size', 'expected'), [(5, [3, 5, 7]), (3, [3, 5]), (31, [29, 31]), (9, [7, 9, 11])]
)
def test_neighbouring_windows_vote(size: int, expected: list[int]) -> None:
    config = MatchConfig(correlation_window_size=size, small_step_penalty=20, consensus=True)
    voters = voter_configs(config)
    assert [voter.correlation_window_size for voter in voters] == expected
    assert all(voter.small_step_penalty == 20 and not voter.consensus for voter in voters)


def test_votes_equal_the_naive_twin() -> None:
    rng = np.random.default_rng(0)
    disparities = (7 + rng.normal(0, 0.5, (4, 37, 23))).astype(np.float32)
    disparities[rng.uniform(size=disparities.shape) < 0.4] = np.nan
    sigmas = rng.uniform(0.1, 0.9, disparities.shape).astype(np.float32)
    disparity, sigma = vote(list(disparities), list(sigmas))
    expected, spread = np.full((2, 37, 23), np.nan)
    for y, x in np.ndindex(37, 23):
        known = ~np.isnan(disparities[:, y, x])
        if not known.any():
            continue
        votes = np.abs(disparities[:, y, x] - np.median(disparities[known, y, x])) <= AGREEMENT_PX
        if votes.sum() >= 2:
            expected[y, x] = disparities[votes, y, x].mean()
            spread[y, x] = np.sqrt(np.mean(sigmas[votes, y, x] ** 2))
    assert 0.2 < np.isnan(expected).mean() < 0.8
    np.testing.assert_allclose(disparity, expected, rtol=1e-6)
    np.testing.assert_allclose(sigma, spread, rtol=1e-6)


@pytest.mark.kernel
def test_disparities_move_to_the_left_image() -> None:
    rng = np.random.default_rng(4)
    disparity = rng.uniform(-6, 9, (35, 24)).astype(np.float32)
    disparity[rng.uniform(size=disparity.shape) < 0.3] = np.nan
    sigma = rng.uniform(0.1, 1, disparity.shape).astype(np.float32)
    expected, spread = np.full((2, *disparity.shape), np.nan, np.float32)
    for y, x in np.argwhere(np.isfinite(disparity)):
        column = x + round(float(disparity[y, x]))
        if 0 <= column < 24 and not expected[y, column] > disparity[y, x]:
            expected[y, column], spread[y, column] = disparity[y, x], sigma[y, x]
    assert 0.3 < np.isnan(expected).mean() < 0.7
    moved = to_left_image(disparity, sigma)
    np.testing.assert_array_equal(moved[0], expected)
    np.testing.assert_array_equal(moved[1], spread)


@pytest.mark.kernel
@pytest.mark.parametrize(('height', 'width'), [(1, 1), (40, 1), (1, 40), (6, 9), (11, 23)])
def test_any_size_works(height: int, width: int) -> None:
    left = np.random.default_rng(1).uniform(0, 255, (height, width)).astype(np.float32)
    for image in (left, np.full_like(left, np.nan)):
        found = match(image, image, SLANTED.match)
        assert found.disparity_px.shape == found.confidence.shape == (height, width)
        assert not found.confidence[np.isnan(found.disparity_px)].any()
        assert np.isnan(found.disparity_px).all() or np.isfinite(image).all()


@pytest.mark.large
@pytest.mark.kernel
def test_whole_pixels_stay_whole() -> None:
    left, right, _ = slanted_pair()
    config = ChainConfig.preset('accurate', disparity_range=32, subpixel=False).match
    disparity = match(to_grey(left[:40, :80]), to_grey(right[:40, :80]), config).disparity_px
    known = disparity[np.isfinite(disparity)]
    assert known.size > 1000
    np.testing.assert_array_equal(known, np.rint(known))


@pytest.mark.large
@pytest.mark.kernel
def test_results_do_not_depend_on_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    left, right, _ = slanted_pair()
    monkeypatch.setattr(_jit, 'thread_count', lambda: 3)
    many = estimate_disparity(left, right, SLANTED)
    monkeypatch.setattr(_jit, 'thread_count', lambda: 1)
    one = estimate_disparity(left, right, SLANTED)
    np.testing.assert_array_equal(many.matched.disparity_px, one.matched.disparity_px)
    np.testing.assert_array_equal(many.matched.confidence, one.matched.confidence)
    np.testing.assert_array_equal(many.filtered.disparity_px, one.filtered.disparity_px)
    np.testing.assert_array_equal(many.filtered.sigma_px, one.filtered.sigma_px)


@pytest.mark.large
@pytest.mark.kernel
def test_a_slanted_plane_is_continued_where_the_right_camera_does_not_see() -> None:
    left, right, truth = slanted_pair()
    error = {}
    for extrapolates in (False, True):
        config = ChainConfig.preset('default', disparity_range=32, wls_extrapolate=extrapolates)
        disparity = estimate_disparity(left, right, config).filtered.disparity_px
        error[extrapolates] = np.abs(disparity - truth)
    unseen = np.mgrid[:100, :160][1] < truth
    assert error[True][unseen].mean() < 0.65 * error[False][unseen].mean()
    assert error[True][unseen].mean() < 0.9
    np.testing.assert_allclose(error[True][~unseen].mean(), error[False][~unseen].mean(), 0.02)


@pytest.mark.large
@pytest.mark.kernel
@pytest.mark.long
def test_accurate_is_as_accurate_as_default_on_easy_pairs() -> None:
    bad = {}
    for preset in ('default', 'accurate'):
        config = ChainConfig.preset(preset, disparity_range=48)
        errors = []
        for seed in (1, 2, 3):
            pair = synthetic_pair(320, 240, 48, seed)
            disparity = estimate_disparity(pair.left, pair.right, config).filtered.disparity_px
            errors.append(np.abs(disparity - pair.disparity_px)[pair.visible])
        bad[preset] = 100 * np.mean(np.concatenate(errors) > 1)
    assert bad['default'] < 1.2
    assert bad['accurate'] < 1.05 * bad['default']
