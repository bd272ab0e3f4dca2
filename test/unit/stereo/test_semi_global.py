# SPDX-License-Identifier: Apache-2.0
"""Semi-global matching against its naive twin."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from binocular_recon.config import MatchConfig
from binocular_recon.images import FloatImage
from binocular_recon.stereo.matching import _semi_global
from binocular_recon.stereo.matching._cost_kernels import new_cost_rows, next_cost_row
from binocular_recon.stereo.matching._preparation import CONTRAST, exposure_gain, normalised_levels
from binocular_recon.stereo.validity import Validity
from test import naive_sgm

pytestmark = pytest.mark.kernel


def pair(height: int, width: int, seed: int = 0) -> tuple[FloatImage, FloatImage]:
    """Return a textured pair of disparity 3, with flat patches and pixels without data."""
    noise = np.random.default_rng(seed).normal(size=(height, width + 3))
    smooth = cv2.GaussianBlur(noise, (0, 0), 1.0)
    levels = np.rint(128 + 40 * smooth / smooth.std()).clip(0, 255).astype(np.float32)
    left, right = levels[:, :-3].copy(), levels[:, 3:].copy()
    left[2:8, 4:11] = 90
    left[9, 13] = np.nan
    right[6:13, 14:22] = 200
    right[3, 15] = np.nan
    return left, right


def volume(
    left: FloatImage, right: FloatImage, config: MatchConfig
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.bool_]]:
    """Return the costs (H, W, D) and which pixels have any, as the matcher computes them."""
    source = _semi_global._cost_source(left, right, config)
    height, width = left.shape
    costs = np.empty((height, width * source.padded), np.uint8)
    scored = np.zeros((height, width), np.bool_)
    for first in range(0, height, 5):
        rows = new_cost_rows(source)
        for y in range(first, min(first + 5, height)):
            scored[y] = next_cost_row(source, rows, y, first, costs[y])[:width]
    whole = costs.reshape(height, width, source.padded)
    assert (whole[:, :, config.disparity_range :] == 252).all()
    return whole[:, :, : config.disparity_range].astype(np.int64), scored


@pytest.mark.parametrize(
    ('size', 'first', 'count'), [(5, 0, 9), (3, -4, 12), (7, 2, 33), (5, 40, 3)]
)
@pytest.mark.parametrize('fine', [False, True])
def test_costs_equal_the_naive_twin(size: int, first: int, count: int, fine: bool) -> None:
    left, right = pair(13, 24)
    if fine:
        left, right = left + np.float32(0.25), right + np.float32(0.5)
    config = MatchConfig(
        correlation_window_size=size,
        min_disparity=first,
        disparity_range=count,
        texture_threshold=0.0,
    )
    noise = _semi_global.NOISE / exposure_gain(left)
    expected, scored = naive_sgm.costs(left, right, size, first, count, noise)
    found, has = volume(left, right, config)
    np.testing.assert_array_equal(has, scored[0])
    assert np.abs(found - expected).max() < 0.6  # 0.5 of it rounding


@pytest.mark.parametrize(
    ('first', 'count', 'tolerance'), [(0, 9, 1.0), (-3, 12, 0.0), (1, 40, 2.0), (-2, 20, -1.0)]
)
def test_disparities_equal_the_naive_twin(first: int, count: int, tolerance: float) -> None:
    left, right = pair(13, 24, seed=1)
    config = MatchConfig(
        min_disparity=first,
        disparity_range=count,
        disp12_max_diff=tolerance,
        uniqueness_ratio=0.0,
        texture_threshold=0.0,
        subpixel=False,
    )
    costs, _ = volume(left, right, config)
    _, scored = naive_sgm.costs(
        left, right, config.correlation_window_size, first, count, noise=1.0
    )
    levels = normalised_levels(left).astype(np.int64)
    penalties = _semi_global._penalties(config)
    total = naive_sgm.aggregate(costs >> 3, levels, penalties.P1, penalties.P2.astype(np.int64))
    expected = naive_sgm.choose(total, costs, scored, first, tolerance)
    disparity, validity = _semi_global.choose_disparities(left, right, config)
    np.testing.assert_array_equal(disparity, expected)
    np.testing.assert_array_equal(validity == Validity.MEASURED, np.isfinite(expected))
    assert 0.3 < np.isfinite(expected).mean() < 1


def test_levels_do_not_change_with_the_exposure() -> None:
    left = np.random.default_rng(6).uniform(0, 255, (20, 30)).astype(np.float32)
    left[3, 4:9] = np.nan
    levels = normalised_levels(left)
    assert abs(levels[~np.isnan(left)].mean() - 128) < 1
    assert abs(levels[~np.isnan(left)].std() - CONTRAST) < 1
    np.testing.assert_array_equal(levels[3, 4:9], 0)
    darker = normalised_levels(left * np.float32(0.6) + 20)
    assert np.abs(darker.astype(int) - levels).max() <= 1  # rounding
