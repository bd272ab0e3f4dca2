# SPDX-License-Identifier: Apache-2.0
"""Completion from the background and smoothing along planes."""

from __future__ import annotations

import numpy as np
import pytest

from binocular_recon._simd import LANES
from binocular_recon.stereo.holes.completion import (
    COMPLETED_CONFIDENCE,
    complete,
    fill_from_background,
    unexplained_holes,
)
from binocular_recon.stereo.matching.refinement._smoothing_kernels import (
    BORDER,
    MEDIAN_BORDER,
    weighted_median_strip,
)
from binocular_recon.stereo.matching.refinement.smoothing import (
    SAME_SURFACE_PX,
    _bordered,
    smooth,
)

pytestmark = pytest.mark.kernel
NAN = np.nan


def test_half_occlusion_explains_columns_at_the_border() -> None:
    for side in (1, -1):  # a negative disparity: at the right border
        disparity = np.full((1, 90), 20 * side, np.float32)
        disparity[0, :25] = NAN
        assert not unexplained_holes(disparity[:, ::side]).any()
        disparity[0, :30] = NAN
        assert unexplained_holes(disparity[:, ::side]).sum() == 30


def test_holes_take_the_smaller_end() -> None:
    disparity = np.array(
        [
            [NAN, 5, NAN, NAN, 9, NAN, 2, NAN],
            [NAN, NAN, NAN, NAN, NAN, NAN, NAN, NAN],
            [NAN, NAN, NAN, NAN, NAN, NAN, NAN, NAN],
            [1, 2, 3, 4, 5, 6, 7, NAN],
        ],
        np.float32,
    )
    expected = np.array(
        [
            [5, 5, 5, 5, 9, 2, 2, 2],
            [5, 5, 5, 5, 9, 2, 2, 2],
            [1, 2, 3, 4, 5, 6, 7, 7],
            [1, 2, 3, 4, 5, 6, 7, 7],
        ],
        np.float32,
    )
    np.testing.assert_array_equal(fill_from_background(disparity), expected)


def test_complete_keeps_what_was_measured() -> None:
    rng = np.random.default_rng(0)
    disparity = rng.uniform(3, 9, (20, 30)).astype(np.float32)
    confidence = rng.uniform(0.1, 1, (20, 30)).astype(np.float32)
    disparity[4:9, 7:15] = NAN
    confidence[12, 3] = 0
    holes = np.isnan(disparity) | (confidence == 0)
    completed, weight = complete(disparity, confidence)
    np.testing.assert_array_equal(completed[~holes], disparity[~holes])
    np.testing.assert_array_equal(weight[~holes], confidence[~holes])
    assert np.isfinite(completed).all()
    np.testing.assert_allclose(weight[holes], COMPLETED_CONFIDENCE)


def test_holes_wider_than_half_occlusion_take_the_column() -> None:
    disparity = np.full((30, 60), 9, np.float32)
    disparity[:, 30:] = 21
    occluded, wide = disparity.copy(), disparity.copy()
    occluded[10:15, 18:36] = NAN  # a step of 12 px occludes 12 columns; windows reach 6 more
    wide[10:15, 18:50] = NAN
    confidence = np.ones((30, 60), np.float32)
    completed = complete(occluded, confidence)[0]
    np.testing.assert_array_equal(completed[12, 18:36], 9)
    completed = complete(wide, confidence)[0]
    np.testing.assert_array_equal(completed[12, 18:28], 9)
    np.testing.assert_array_equal(completed[12, 32:50], 21)


def test_nothing_measured_stays_nothing() -> None:
    completed, weight = complete(np.full((6, 7), NAN, np.float32), np.zeros((6, 7), np.float32))
    assert np.isnan(completed).all()
    assert not weight.any()


def test_planes_reduce_noise_and_keep_slopes_and_steps() -> None:
    rng = np.random.default_rng(1)
    y, x = np.mgrid[:60, :90].astype(np.float32)
    truth = 20 + 0.08 * x - 0.05 * y + 15 * (x > 45)
    noisy = (truth + rng.normal(0, 0.2, truth.shape)).astype(np.float32)
    noisy[25:30, 20:24] = NAN
    guide = np.full(truth.shape, 90, np.float32)
    smoothed, sigma = smooth(noisy, guide)
    np.testing.assert_array_equal(np.isnan(smoothed), np.isnan(noisy))
    error = (smoothed - truth)[8:-8, 8:-8]
    assert np.nanstd(error) < 0.06
    assert abs(np.nanmean(error)) < 0.01
    assert np.nanmax(np.abs(error)) < SAME_SURFACE_PX
    np.testing.assert_array_equal(np.isnan(sigma), np.isnan(noisy))
    assert np.nanmin(sigma) >= 0.15
    steady, _ = smooth(truth.astype(np.float32), guide)
    assert np.abs(steady - truth)[8:-8, 8:-8].max() < 0.03  # at the step, of the median


@pytest.mark.parametrize('spacing', [2, 3])
def test_weighted_median_equals_its_naive_twin(spacing: int) -> None:
    rng = np.random.default_rng(2)
    shape, border = (17, 37), MEDIAN_BORDER
    values = rng.choice([5.0, 6.5, 20.0], shape).astype(np.float32)
    levels = rng.choice([10.0, 60.0], shape).astype(np.float32)
    values[4, 5:9] = levels[9, 20] = NAN
    mask = np.where(rng.random(shape) < 0.1, np.float32(NAN), np.float32(1))
    mask[np.isnan(values)] = NAN
    images = _bordered(values), _bordered(levels), mask
    where = rng.integers(0, 2, (9, 19)).astype(np.uint8)
    found = []
    for pixels in (np.empty((0, 0), np.uint8), where):
        samples = np.empty((17 + 2 * BORDER, 37 + 2 * BORDER + LANES), np.float32)
        for rows in ((0, 8), (8, 17)):
            weighted_median_strip(images, pixels, spacing, 16.0, 1.0, samples, *rows)
        inside = samples[BORDER:-BORDER, BORDER : BORDER + 37]
        assert np.isfinite(samples).sum() == np.isfinite(inside).sum()
        np.testing.assert_array_equal(np.isnan(inside), np.isnan(mask))
        found.append(inside)
    median, part = found
    near = where.repeat(2, axis=0).repeat(2, axis=1)[:17, :37] > 0
    expected_part = np.where(near, median, np.where(np.isnan(mask), NAN, values))
    np.testing.assert_array_equal(part, expected_part)
    offsets = range(-border, border + 1, spacing)
    for y, x in np.ndindex(shape):
        if np.isnan([values[y, x], levels[y, x], mask[y, x]]).any():
            continue
        seen = [(y + j, x + i) for j in offsets for i in offsets]
        seen = [p for p in seen if 0 <= p[0] < 17 and 0 <= p[1] < 37]
        seen = [p for p in seen if np.isfinite(values[p]) and np.isfinite(levels[p])]
        around = np.array([values[p] for p in seen])
        steps = np.array([levels[p] for p in seen]) - levels[y, x]
        weights = 1 / (1 + (steps / 16) ** 2)
        below = {v: weights[around <= v].sum() / weights.sum() for v in np.unique(around)}
        if min(abs(share - 0.5) for share in below.values()) < 1e-3:
            continue  # either side
        expected = min(v for v, share in below.items() if share > 0.5)
        if abs(expected - values[y, x]) <= 1:
            expected = values[y, x]
        assert abs(median[y, x] - expected) < 0.05


def test_edges_move_to_where_the_image_has_them() -> None:
    guide = np.full((40, 60), 50, np.float32)
    guide[:, 30:] = 150
    disparity = np.where(np.arange(60) < 28, 4, 18) * np.ones((40, 1), np.float32)
    smoothed, _ = smooth(disparity.astype(np.float32), guide)
    np.testing.assert_allclose(smoothed[:, 28:30], 4, atol=0.05)
    np.testing.assert_allclose(smoothed[:, 30:], 18, atol=0.05)


def test_columns_that_the_right_camera_does_not_see_continue_the_slope() -> None:
    rng = np.random.default_rng(2)
    y, x = np.mgrid[:80, :100].astype(np.float32)
    truth = (20 + 0.06 * x + 0.05 * y).astype(np.float32)
    disparity = truth + rng.normal(0, 0.05, truth.shape).astype(np.float32)
    disparity[x < truth] = NAN
    disparity[:, 70:78] = NAN  # not at the border: as without extrapolation
    confidence = np.ones_like(disparity)
    constant, _ = complete(disparity, confidence)
    continued, weight = complete(disparity, confidence, extrapolate=True)
    np.testing.assert_array_equal(continued[:, 40:], constant[:, 40:])
    np.testing.assert_allclose(weight[x < truth], COMPLETED_CONFIDENCE)
    error, before = (np.abs(filled - truth)[x < truth] for filled in (continued, constant))
    assert error.mean() < 0.15 < 0.6 < before.mean()


def test_slopes_that_differ_are_not_continued() -> None:
    x = np.arange(100, dtype=np.float32)
    slopes = np.random.default_rng(3).normal(0, 0.05, (80, 1))
    disparity = (20 + slopes * (x - 20)).astype(np.float32)
    disparity[:, :20] = NAN
    confidence = np.ones_like(disparity)
    constant, _ = complete(disparity, confidence)
    continued, _ = complete(disparity, confidence, extrapolate=True)
    assert np.abs(continued - constant).max() < 0.1


@pytest.mark.filterwarnings('error')
@pytest.mark.parametrize(('height', 'width'), [(1, 1), (1, 50), (50, 1), (70, 20)])
def test_any_size_can_be_continued(height: int, width: int) -> None:
    disparity = np.full((height, width), 3, np.float32)
    confidence = np.ones_like(disparity)
    disparity[:, : width // 2] = NAN
    continued, _ = complete(disparity, confidence, extrapolate=True)
    np.testing.assert_array_equal(continued, 3)
    disparity[:] = NAN
    assert np.isnan(complete(disparity, confidence, extrapolate=True)[0]).all()
