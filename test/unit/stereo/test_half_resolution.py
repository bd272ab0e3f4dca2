# SPDX-License-Identifier: Apache-2.0
"""Half resolution: holes of low texture are filled, half-occluded ones are not."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from binocular_recon.config import MatchConfig
from binocular_recon.stereo.matching import match
from binocular_recon.stereo.matching.half_resolution import (
    fill_from_half,
    half_config,
    has_low_texture,
)

pytestmark = pytest.mark.kernel


@pytest.mark.parametrize(
    ('first', 'count', 'expected'),
    [(0, 64, (0, 33)), (-7, 16, (-4, 9)), (5, 2, (2, 2)), (4, 2, (2, 2)), (-3, 4, (-2, 3))],
)
def test_half_range_covers_the_whole_one(
    first: int, count: int, expected: tuple[int, int]
) -> None:
    half = half_config(MatchConfig(min_disparity=first, disparity_range=count))
    assert (half.min_disparity, half.disparity_range) == expected
    assert half.limits_px[0] <= first / 2
    assert half.limits_px[1] >= (first + count - 1) / 2


def test_only_holes_that_half_resolution_mostly_covers_are_filled() -> None:
    disparity, sigma = np.full((21, 41), 7, np.float32), np.full((21, 41), 0.2, np.float32)
    for columns in (
        slice(4, 10),
        slice(16, 24),
        slice(34, 36),
    ):  # low texture, half-occluded, small
        disparity[4:14, columns] = sigma[4:14, columns] = np.nan
    half, half_sigma = np.full((11, 21), 4, np.float32), np.full((11, 21), 0.3, np.float32)
    half[:, 9:12] = half[2, 2] = np.nan
    expected = disparity.copy()
    expected[4:14, 4:10] = 8
    expected[4:6, 4:6] = np.nan
    fill_from_half(disparity, sigma, half, half_sigma, least_hole=40)
    np.testing.assert_array_equal(disparity, expected)
    assert sigma[8, 7] == np.float32(0.6)
    np.testing.assert_array_equal(np.isnan(sigma), np.isnan(disparity))


@pytest.mark.parametrize(('rows', 'step', 'low'), [(20, 4, True), (4, 4, False), (20, 30, False)])
def test_texture_is_low_where_a_large_hole_is_not_half_occluded(
    rows: int, step: int, low: bool
) -> None:
    disparity = np.full((100, 200), 5, np.float32)
    disparity[:, 90:] += step  # occludes as many columns
    disparity[40 : 40 + rows, 60:90] = np.nan  # 3 % or 0.6 % of the image
    assert has_low_texture(disparity) == low


@pytest.mark.large
def test_texture_below_the_noise_is_matched() -> None:
    rng = np.random.default_rng(1)
    whole = 100 + 4 * cv2.GaussianBlur(rng.normal(size=(80, 120)), (0, 0), 3) * 10
    left, right = (
        (moved + rng.normal(scale=4, size=moved.shape)).astype(np.float32)
        for moved in (whole[:, :-6], whole[:, 6:])
    )
    share = {}
    for half_resolution in (False, True):
        config = MatchConfig(disparity_range=16, half_resolution=half_resolution)
        disparity = match(left, right, config).disparity_px[10:-10, 20:-10]
        share[half_resolution] = np.mean(np.abs(disparity - 6) < 1)
    assert share[True] > 0.8 > share[False]
