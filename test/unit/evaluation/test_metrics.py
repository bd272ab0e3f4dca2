# SPDX-License-Identifier: Apache-2.0
"""Metrics on examples computed by hand, on images that are not square."""

from __future__ import annotations

import math

import numpy as np
import pytest

from binocular_recon.evaluation.accuracy.metrics import (
    accuracy,
    depth_errors,
    depth_from_disparity,
    normalised_error_rms,
    sigma_against,
    sigma_bins,
    truth_step_px,
)
from binocular_recon.evaluation.accuracy.visibility import visible_from_truth
from binocular_recon.images import FloatImage

NAN = math.nan


def image(*rows: list[float]) -> FloatImage:
    return np.array(rows, np.float32)


# errors:       0    1.0   1.5  unfilled / unknown  2.5  0.5  4.0
TRUTH = image([10, 10, 10, 10], [NAN, 20, 20, 20])
ESTIMATE = image([10, 11, 8.5, NAN], [7, 22.5, 19.5, 24])


def test_accuracy_by_hand() -> None:
    result = accuracy(ESTIMATE, TRUTH)
    assert result.pixels == 7
    # an error equal to the limit is not bad; the unfilled pixel is bad at every limit
    assert result.bad_percent == pytest.approx((400 / 7, 300 / 7, 200 / 7))
    assert result.density_percent == pytest.approx(600 / 7)
    assert result.measured_error_px == pytest.approx((0 + 1 + 1.5 + 2.5 + 0.5 + 4) / 6)
    # the unfilled pixel counts as disparity 0, so with an error of 10
    assert result.mean_error_px == pytest.approx((0 + 1 + 1.5 + 10 + 2.5 + 0.5 + 4) / 7)


def test_accuracy_counts_the_mask_only() -> None:
    mask = np.array([[True, False, True, False], [True, True, False, False]])
    result = accuracy(ESTIMATE, TRUTH, mask)
    assert result.pixels == 3  # the pixel of the mask without ground truth does not count
    assert result.bad_percent == pytest.approx((200 / 3, 100 / 3, 0))
    assert result.mean_error_px == pytest.approx(4 / 3)


def test_accuracy_of_nothing_known_and_of_nothing_filled() -> None:
    nothing = np.full((2, 4), np.nan, np.float32)
    unknown = accuracy(ESTIMATE, nothing)
    assert unknown.pixels == 0
    assert np.isnan([*unknown.bad_percent, unknown.mean_error_px, unknown.density_percent]).all()
    unfilled = accuracy(nothing, TRUTH)
    assert list(unfilled.bad_percent) == [100, 100, 100]
    assert unfilled.density_percent == 0
    assert math.isnan(unfilled.measured_error_px)


def test_accuracy_treats_infinite_estimates_as_unfilled() -> None:
    result = accuracy(image([math.inf, 10]), image([10, 10]))
    assert result.density_percent == 50
    assert result.measured_error_px == 0


def test_visible_from_truth_by_hand() -> None:
    # a bar of disparity 3 at columns 4..5 before a wall of disparity 1
    truth = image([1, 1, 1, 1, 3, 3, 1, 1], [1, 1, NAN, 1, 1, 1, 1, 1])
    # wall pixels land at x - 1, bar pixels at 1 and 2, where wall pixels 2 and 3 land too;
    # column 0 leaves the right image
    expected = [
        [False, True, False, False, True, True, True, True],
        [False, True, False, True, True, True, True, True],
    ]
    assert visible_from_truth(truth).tolist() == expected


def test_visible_from_truth_keeps_slanted_surfaces() -> None:
    truth = np.tile(np.linspace(2, 8, 40, dtype=np.float32), (3, 1))
    visible = visible_from_truth(truth)
    assert visible[:, 3:].all()
    assert not visible[:, :2].any()


def test_depth_by_hand() -> None:
    # cx_left - cx_right = -2: infinity lies at disparity -2
    depth = depth_from_disparity(image([8, -2, -3, NAN]), focal_baseline=50.0, offset_px=-2.0)
    assert depth[0, 0] == 5
    assert np.isnan(depth[0, 1:]).all()


def test_depth_errors_by_hand() -> None:
    truth = image([1, 2, 3, 6, 6], [12, 12, 12, 60, NAN])
    depth = image([1.5, 2, NAN, 5, 6.5], [11, NAN, NAN, 60, 3])
    near, middle, far, empty = depth_errors(depth, truth)
    assert (near.near_m, near.far_m, near.pixels) == (0, 5, 3)
    assert near.median_m == 0.5  # of 0, 0.5 and infinite
    assert near.p90_m == math.inf
    assert near.bias_m == 0.25  # median of 0.5 and 0
    assert (middle.median_m, middle.p90_m, middle.bias_m) == (1.0, 1.0, -0.25)
    assert far.median_m == math.inf  # more than half have no depth
    assert far.bias_m == -1.0
    assert empty.pixels == 0 and math.isnan(empty.median_m) and math.isnan(empty.bias_m)


def test_sigma_of_hand_made_errors() -> None:
    truth = np.zeros((2, 4), np.float32)
    estimate = image([0.1, -0.2, 0.3, 5.0], [0.4, -0.4, NAN, 0.2])
    sigma = image([0.1, 0.1, 0.3, 0.1], [0.5, 0.5, 0.1, NAN])
    # errors over sigma: 1, -2, 1, 0.8, -0.8; a mismatch, a hole and a pixel without sigma drop out
    expected = math.sqrt((1 + 4 + 1 + 0.64 + 0.64) / 5)
    assert normalised_error_rms(estimate, sigma, truth) == pytest.approx(expected, rel=1e-6)
    mask = np.array([[True, False, False, False], [False, True, True, False]])
    expected = math.sqrt((1 + 0.64) / 2)
    assert normalised_error_rms(estimate, sigma, truth, mask) == pytest.approx(expected, rel=1e-6)
    assert math.isnan(normalised_error_rms(estimate, sigma, truth, ~mask & (estimate > 4)))


@pytest.mark.parametrize(
    ('rounded_to', 'offset', 'found'), [(1.0, 0, 1.0), (0.25, 0.1, 0.25), (0.3, 0, 0.3)]
)
def test_the_rounding_of_the_truth_is_found_and_covered(
    rounded_to: float, offset: float, found: float
) -> None:
    random = np.random.default_rng(4)
    exact = random.uniform(20, 60, (80, 90))
    truth = (np.rint(exact / rounded_to) * rounded_to + offset).astype(np.float32)
    truth[0, :5] = NAN
    assert truth_step_px(truth) == pytest.approx(found, abs=1e-4)
    sigma = np.full(truth.shape, 0.15, np.float32)
    estimate = (exact + offset + random.normal(0, 0.15, exact.shape)).astype(np.float32)
    rms = normalised_error_rms(estimate, sigma_against(sigma, truth_step_px(truth)), truth)
    assert rms == pytest.approx(1, abs=0.03)


def test_truth_that_is_not_rounded_has_no_step() -> None:
    exact = np.random.default_rng(4).uniform(20, 60, (80, 90)).astype(np.float32)
    assert truth_step_px(exact) == 0
    assert truth_step_px(TRUTH) == 0  # too few values to tell
    assert truth_step_px(np.arange(20, dtype=np.float32)[None] * 3) == 0  # of the scene
    assert truth_step_px(np.full((2, 4), NAN, np.float32)) == 0


def test_sigma_bins_by_hand() -> None:
    truth = np.zeros((2, 3), np.float32)
    estimate = image([0.3, -0.4, 5.0], [0.2, NAN, 0.6])
    sigma = image([0.1, 0.1, 0.1], [0.5, 0.1, 0.7])
    low, high, empty = sigma_bins(estimate, sigma, truth, edges_px=(0.0, 0.25, 1.0, 2.0))
    assert low.pixels == 3
    assert low.mismatched_percent == pytest.approx(100 / 3)
    assert low.predicted_px == pytest.approx(0.1)
    assert low.measured_px == pytest.approx(math.sqrt((0.09 + 0.16) / 2))
    assert high.pixels == 2
    assert high.predicted_px == pytest.approx(math.sqrt((0.25 + 0.49) / 2))
    assert high.measured_px == pytest.approx(math.sqrt((0.04 + 0.36) / 2))
    assert empty.pixels == 0 and math.isnan(empty.predicted_px)


def test_an_honest_sigma_has_rms_one() -> None:
    random = np.random.default_rng(3)
    sigma = random.uniform(0.02, 0.2, (120, 170)).astype(np.float32)
    error = (random.standard_normal(sigma.shape) * sigma).astype(np.float32)
    assert normalised_error_rms(error, sigma, np.zeros_like(sigma)) == pytest.approx(1, abs=0.02)
