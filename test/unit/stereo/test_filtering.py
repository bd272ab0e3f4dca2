# SPDX-License-Identifier: Apache-2.0
"""Filter: against the reference values and naive twins, its uncertainty, and bad input."""

from __future__ import annotations

import dataclasses
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from binocular_recon.config import ChainConfig, FilterConfig
from binocular_recon.images import FloatImage
from binocular_recon.stereo.filtering.wls_filter import (
    LIMIT_MARGIN_PX,
    DisparityFilter,
)
from binocular_recon.stereo.holes.completion import complete
from test import naive_wls
from test.unit.stereo.filter_scene import LIMITS_PX, NAN, PLAIN, difference, run, scene

pytestmark = pytest.mark.kernel

REFERENCE = np.load(Path(__file__).parents[2] / 'data' / 'wls.npz')


def reference(name: str) -> FloatImage:
    return np.asarray(REFERENCE[name], np.float32)


def test_reference_with_confidence() -> None:
    images = reference('disparity'), reference('confidence'), reference('guide')
    filtered = run(*images)
    assert filtered.disparity_px.dtype == filtered.sigma_px.dtype == np.float32
    assert np.abs(filtered.disparity_px - REFERENCE['weighted']).max() <= 1e-3


def test_reference_of_the_paper() -> None:
    """Unit weights whatever the confidence says."""
    config = ChainConfig.preset('paper', wls_tolerance_px=2e-4).filter
    confidence = np.full((48, 64), 0.3, np.float32)
    filtered = run(reference('disparity'), confidence, reference('guide'), config)
    assert np.abs(filtered.disparity_px - REFERENCE['paper']).max() <= 1e-3


def test_disparity_as_guide() -> None:
    """Y = (b - min) / (max - min); without a match, b is the nearest in the row."""
    disparity, confidence, guide = scene(0)
    config = ChainConfig.preset('paper', wls_guide='disparity', wls_tolerance_px=2e-4).filter
    data = disparity.copy()
    for row in data:
        valid = np.flatnonzero(np.isfinite(row))
        for x in np.flatnonzero(np.isnan(row)):
            row[x] = row[valid[np.abs(valid - x).argmin()]]
    luminance = (data - data.min()) / (data.max() - data.min())
    expected = naive_wls.minimiser(
        data.astype(float),
        np.ones(data.shape),
        naive_wls.log_luminance(luminance.astype(float) * 255),
        0.35,
        1.8,
        1e-4,
    )
    filtered = run(disparity, confidence, np.full_like(guide, NAN), config)
    assert np.abs(filtered.disparity_px - expected).max() <= 1e-3


def test_rows_without_a_match_take_the_nearest_row() -> None:
    disparity, confidence, guide = scene(1)
    disparity[:3] = np.nan
    config = ChainConfig.preset('paper').filter
    filled = disparity.copy()
    filled[:3] = filled[3]
    assert (
        difference(
            run(disparity, confidence, guide, config), run(filled, confidence, guide, config)
        )
        < 0.03
    )


def test_completion_and_steps() -> None:
    """Both departures from eq. 12-13 against the naive twin."""
    disparity, confidence, guide = scene(2)
    config = FilterConfig(wls_tolerance_px=2e-4)
    known = np.where(np.isfinite(disparity), confidence, 0)
    data, weight = complete(disparity, known, guide, extrapolate=True)
    links = naive_wls.links(naive_wls.log_luminance(guide), 0.02, 1.2, 1e-4)
    for axis, link in zip((1, 0), links, strict=True):
        step = np.diff(data.astype(float), axis=axis)
        link[:] = 0.02 / (0.02 / link + config.wls_disparity_steps * step**2)
    expected = naive_wls.solution(data, weight, *links)
    filtered = run(disparity, confidence, guide, config)
    assert np.abs(filtered.disparity_px - expected).max() <= 1e-3


def test_an_edge_without_contrast_stays() -> None:
    """A box of the wall's own grey: eq. 12 alone smooths over its edge."""
    disparity, confidence, guide = scene(3, (40, 48))
    guide[:] = 120
    box = np.zeros(guide.shape, bool)
    box[5:15, 8:18] = True

    def error(config: FilterConfig) -> float:
        filtered = run(disparity, confidence, guide, config)
        return float(np.abs(filtered.disparity_px - np.where(box, 30, 12)).mean())

    assert error(FilterConfig()) < 0.3
    assert error(PLAIN) > 1.0


def test_what_is_not_a_measurement() -> None:
    """NaN, infinite, outside the limits, confidence 0 or NaN: all the same."""
    disparity, confidence, guide = scene(4)
    ways: list[tuple[Any, Any]] = [
        (np.nan, 0.5),
        (np.inf, 0.5),
        (-np.inf, 0.5),
        (70.0, 0.5),
        (-1.0, 0.5),
        (20.0, 0.0),
        (20.0, np.nan),
        (20.0, -1.0),
    ]
    results = []
    for value, level in ways:
        bad_disparity, bad_confidence = disparity.copy(), confidence.copy()
        bad_disparity[6:9, 4:20], bad_confidence[6:9, 4:20] = value, level
        results.append(run(bad_disparity, bad_confidence, guide, FilterConfig()))
    for other in results[1:]:
        np.testing.assert_array_equal(results[0].disparity_px, other.disparity_px)
        np.testing.assert_array_equal(results[0].sigma_px, other.sigma_px)


def test_confidence_above_one_counts_as_one() -> None:
    disparity, _, guide = scene(5)
    one = np.ones_like(disparity)
    assert difference(run(disparity, one, guide), run(disparity, 9 * one, guide)) == 0


@pytest.mark.parametrize('config', [PLAIN, FilterConfig(), ChainConfig.preset('paper').filter])
def test_one_measured_pixel(config: FilterConfig) -> None:
    disparity = np.full((9, 12), NAN)
    disparity[4, 7] = 17.25
    guide = np.random.default_rng(6).uniform(0, 255, (9, 12)).astype(np.float32)
    filtered = run(disparity, np.ones_like(disparity), guide, config)
    np.testing.assert_allclose(filtered.disparity_px, 17.25, atol=0.02)
    assert filtered.sigma_px[0, 0] > filtered.sigma_px[4, 7]


@pytest.mark.parametrize('shape', [(1, 1), (1, 40), (40, 1), (2, 3), (5, 5), (1, 2)])
@pytest.mark.parametrize('config', [PLAIN, FilterConfig()])
def test_thin_images(shape: tuple[int, int], config: FilterConfig) -> None:
    rng = np.random.default_rng(7)
    disparity = rng.uniform(5, 60, shape).astype(np.float32)
    guide = rng.uniform(0, 255, shape).astype(np.float32)
    filtered = run(disparity, np.full(shape, 0.7, np.float32), guide, config)
    assert np.isfinite(filtered.disparity_px).all() and np.isfinite(filtered.sigma_px).all()
    if config is PLAIN:
        links = naive_wls.links(naive_wls.log_luminance(guide), 0.02, 1.2, 1e-4)
        expected = naive_wls.solution(disparity, np.full(shape, 0.7), *links)
        assert np.abs(filtered.disparity_px - expected).max() <= 1e-3


def test_no_data_is_not_an_edge() -> None:
    """The empty border of a rectified image: smooth, not cut off."""
    disparity, confidence, guide = scene(8)
    guide[:, :4] = np.nan
    disparity[:, :4] = np.nan
    filtered = run(disparity, confidence, guide)
    np.testing.assert_allclose(filtered.disparity_px[:, 0], filtered.disparity_px[:, 4], atol=0.2)


@pytest.mark.parametrize('limits', [(0.0, 64.0), (-500.0, 1500.0), (2000.0, 4095.0)])
def test_strictly_inside_the_limits(limits: tuple[float, float]) -> None:
    low, high = (np.float32(limit) for limit in limits)
    disparity = np.where(np.indices((16, 20)).sum(axis=0) % 20 < 10, low, high).astype(np.float32)
    ones = np.ones_like(disparity)
    for guide in (disparity, 100 * ones):
        result = run(disparity, ones, guide, FilterConfig(), limits_px=limits).disparity_px
        for offset in (np.float32(-32.778), np.float32(0), np.float32(32.778)):
            assert (result - offset > low - offset).all()
            assert (result - offset < high - offset).all()


def test_limits_without_room() -> None:
    ones = np.ones((4, 4), np.float32)
    filtered = run(5 * ones, ones, ones, limits_px=(5.0, 5.0))
    np.testing.assert_array_equal(filtered.disparity_px, 5)
    narrow = (5.0, 5.0 + LIMIT_MARGIN_PX)
    middle = run(5 * ones, ones, ones, limits_px=narrow).disparity_px
    assert ((middle > narrow[0]) & (middle < narrow[1])).all()


def test_last_frames_result_as_first_guess() -> None:
    disparity, confidence, guide = scene(9, (40, 50))
    cold = run(disparity, confidence, guide)
    warm = run(disparity, confidence, guide, initial=cold.disparity_px)
    assert warm.iterations < cold.iterations
    assert difference(cold, warm) <= 1e-3
    holes = cold.disparity_px.copy()
    holes[3, 4] = np.nan  # ignored
    assert difference(cold, run(disparity, confidence, guide, initial=holes)) == 0


def test_frames_do_not_affect_later_ones() -> None:
    """Memory is reused: the result is the same after any other frame, also of another size."""
    wls = DisparityFilter(FilterConfig())
    for seed, shape in ((11, (20, 28)), (12, (20, 28)), (13, (33, 7)), (14, (20, 28))):
        frame = scene(seed, shape)
        again, fresh = wls(*frame, limits_px=LIMITS_PX), run(*frame, config=FilterConfig())
        np.testing.assert_array_equal(again.disparity_px, fresh.disparity_px)
        np.testing.assert_array_equal(again.sigma_px, fresh.sigma_px)


@pytest.mark.large
def test_video_starts_from_the_last_frame() -> None:
    """Same result within the tolerance, sooner; also after another size or scene."""
    options: dict[str, Any] = {'wls_lambda': 20.0, 'wls_tolerance_px': 1e-3}
    config = FilterConfig(wls_complete=False, wls_disparity_steps=0.0, **options)
    video = DisparityFilter(dataclasses.replace(config, wls_video=True))
    first, other = scene(15, (60, 70)), scene(16, (60, 70))
    noise = np.random.default_rng(17).normal(0, 0.002, (60, 70)).astype(np.float32)
    noisy: FloatImage = first[0] + noise
    next_frame = (noisy, first[1], first[2])
    iterations = []
    for frame in (first, next_frame, other, scene(18, (31, 20)), first):
        cold, warm = run(*frame, config=config), video(*frame, limits_px=LIMITS_PX)
        assert difference(cold, warm) <= 2 * config.wls_tolerance_px
        assert warm.iterations <= cold.iterations + 1
        iterations.append((cold.iterations, warm.iterations))
    assert iterations[1][1] < iterations[1][0]


@pytest.mark.large
def test_frames_from_two_threads() -> None:
    wls = DisparityFilter(FilterConfig())
    frames = [scene(seed, (40, 50)) for seed in range(20, 28)]
    with ThreadPoolExecutor(2) as pool:
        results = list(pool.map(lambda frame: wls(*frame, limits_px=LIMITS_PX), frames))
    for frame, result in zip(frames, results, strict=True):
        np.testing.assert_array_equal(
            result.disparity_px, run(*frame, config=FilterConfig()).disparity_px
        )
