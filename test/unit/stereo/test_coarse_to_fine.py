# SPDX-License-Identifier: Apache-2.0
"""A match of half the resolution, refined at full resolution near what it found."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from binocular_recon._jit import limit_threads
from binocular_recon.config import ChainConfig, MatchConfig
from binocular_recon.images import FloatImage, window_range
from binocular_recon.options import OptionValue
from binocular_recon.stereo.matching import match
from binocular_recon.stereo.matching.coarse_to_fine import (
    coarse_config,
    is_noise,
    refine_coarse,
)
from binocular_recon.stereo.matching.coarse_to_fine._visibility_kernels import hidden_strip
from binocular_recon.stereo.validity import Validity
from test.unit.stereo.matching_pairs import shifted_pair, texture

NAN = np.float32(np.nan)


def fast(**options: OptionValue) -> MatchConfig:
    return ChainConfig.preset('fast', **{'disparity_range': 32, **options}).match


def naive_refinement(left: FloatImage, right: FloatImage, half: FloatImage) -> FloatImage:
    """Return the best disparity within 1 px of the guesses of each pixel, window by window."""
    height, width = left.shape
    farthest, nearest = window_range(half, 3)
    farthest[farthest > nearest] = NAN
    nearest[np.isnan(farthest)] = NAN
    known = np.where(np.isnan(half), farthest, half)
    result = np.full(left.shape, NAN)
    for y, x in np.ndindex(left.shape):
        found, best = 2 * known[y // 2, x // 2], -2.0
        at_edge = nearest[y // 2, x // 2] - farthest[y // 2, x // 2] > 1
        for guesses in (known, nearest, farthest) if at_edge else (known,):
            guess = np.rint(2 * guesses.repeat(2, 0).repeat(2, 1))
            scores, base = np.full(3, -2.0), np.nan
            window = [(y + j, x + i) for j in (-1, 0, 1) for i in (-1, 0, 1)]
            if all(0 <= j < height and 0 <= i < width for j, i in window):
                at = np.array([guess[p] for p in window])
                steps = at - guess[y, x]
                base = guess[y, x] + np.where(np.abs(steps) <= 1, steps, 0).mean()
                for k in range(3):
                    columns = np.array([i for _, i in window]) - at - (k - 1)
                    if not ((columns >= 0) & (columns < width)).all():
                        continue
                    own = np.array([left[p] for p in window])
                    other = np.array(
                        [right[j, int(i)] for (j, _), i in zip(window, columns, strict=True)]
                    )
                    if min(own.std(), other.std()) >= 0.5 and np.isfinite(other).all():
                        ncc = np.corrcoef(own, other)[0, 1]
                        scores[k] = ncc * abs(ncc)
            before, same, after = scores
            bend = 2 * same - before - after
            offset = float(np.array([0, -1, 1])[np.argmax(scores[[1, 0, 2]])])
            if before > -1 and after > -1 and bend > 1e-6:
                offset = np.clip(0.5 * (after - before) / bend, -1, 1)
            if scores.max() > best:
                best, found = scores.max(), base + offset
        if not np.isnan(half[y // 2, x // 2]) or best > 0.8:
            result[y, x] = found
    return result


@pytest.mark.kernel
def test_refinement_equals_its_naive_twin() -> None:
    rng = np.random.default_rng(0)
    left, right = rng.integers(0, 256, (2, 19, 47)).astype(np.float32)
    right[:, :41] = 0.8 * left[:, 6:] + 0.2 * right[:, :41]
    left[4:9, 20:27] = 90  # no texture
    right[12, 30] = NAN
    half = rng.choice([2.6, 3.0, 3.4], (10, 24)).astype(np.float32)
    half[:, 12:] += 5
    half[3:6, 4:7] = half[8, 20] = NAN
    options = fast(disp12_max_diff=-1.0)
    validity = np.ones(half.shape, np.uint8)
    found = refine_coarse(left, right, (half, validity), options)[0]
    expected = naive_refinement(left, right, half)
    np.testing.assert_array_equal(np.isnan(found), np.isnan(expected))
    np.testing.assert_allclose(found, expected, atol=2e-3)
    assert np.isnan(found).any()
    assert (np.abs(found - 6) < 0.2).mean() > 0.1


@pytest.mark.kernel
def test_of_two_surfaces_at_one_right_pixel_the_nearest_is_seen() -> None:
    rng = np.random.default_rng(1)
    disparity = rng.uniform(-3, 9, (6, 40)).astype(np.float32)
    disparity[rng.random(disparity.shape) < 0.2] = NAN
    kept, validity = disparity.copy(), np.ones(disparity.shape, np.uint8)
    hidden_strip(kept, 1.5, (-2.5, 8.5), validity, 0, 6)
    for y, x in np.ndindex(disparity.shape):
        there = x - np.rint(disparity[y, x])
        rivals = disparity[y, (np.arange(40) - np.rint(disparity[y])) == there]
        hidden = 0 <= there < 40 and rivals.max() - disparity[y, x] > 1.5
        assert (validity[y, x] == Validity.CONFLICT) == hidden
        outside = disparity[y, x] < -2.5 or disparity[y, x] > 8.5
        assert (validity[y, x] == Validity.AT_LIMIT) == (outside and not hidden)
        assert np.isnan(kept[y, x]) == (hidden or outside or np.isnan(disparity[y, x]))


@pytest.mark.parametrize('first', [-9, 0, 2])
@pytest.mark.parametrize('shape', [(60, 100), (61, 103)])
def test_a_shift_is_found_at_any_start_and_size(first: int, shape: tuple[int, int]) -> None:
    shift = first + 7.4
    left, right = shifted_pair(*shape, shift)
    for count in (16, 33):
        found = match(left, right, fast(min_disparity=first, disparity_range=count))
        error = found.disparity_px[6:-6, 26:-26] - shift
        assert np.isfinite(error).mean() > 0.97
        assert abs(np.nanmean(error)) < 0.03
        assert np.sqrt(np.nanmean(error**2)) < 0.08
    whole = match(left, right, fast(min_disparity=first, disparity_range=16, subpixel=False))
    assert set(np.unique(whole.disparity_px[6:-6, 26:-26])) <= {first + 7, first + 8, NAN}


def test_disparities_at_the_limits_are_no_matches() -> None:
    left, right = shifted_pair(60, 120, 20.0)
    for first, count in ((20, 20), (0, 21)):
        found = match(left, right, fast(min_disparity=first, disparity_range=count))
        assert np.isfinite(found.disparity_px[:, 30:-10]).mean() < 0.02
    at_limit = match(left, right, fast(min_disparity=20, disparity_range=20)).validity
    assert (at_limit[6:-6, 40:-10] == Validity.AT_LIMIT).mean() > 0.9
    for first, share in ((18, 0.98), (19, 0.9)):  # half a disparity is lost at each limit
        inside = match(left, right, fast(min_disparity=first, disparity_range=20)).disparity_px
        assert np.isfinite(inside[6:-6, 40:-10]).mean() > share


def test_the_coarse_range_covers_the_range() -> None:
    for first, count in ((0, 128), (-7, 2), (5, 31), (-2048, 4096), (2048, 2)):
        coarse = coarse_config(fast(min_disparity=first, disparity_range=count))
        low, high = coarse.limits_px
        assert 2 * low <= first
        assert 2 * high + 1 >= first + count - 1
        assert coarse.disparity_range <= count // 2 + 2


def test_images_too_small_to_halve_are_matched_as_they_are() -> None:
    left, right = shifted_pair(4, 60, 5.0)
    assert np.isfinite(match(left, right, fast()).disparity_px).any()
    for shape in ((1, 1), (2, 40), (40, 2)):
        tiny = match(np.full(shape, 90, np.float32), np.full(shape, 90, np.float32), fast())
        assert np.isnan(tiny.disparity_px).all()


def test_the_number_of_threads_does_not_change_a_bit() -> None:
    left, right = shifted_pair(150, 90, 6.3)
    left[40:60, 20:50] = texture(20, 30, seed=5)
    results = []
    try:
        for threads in (1, 3):
            limit_threads(threads)
            results.append(match(left, right, fast()))
    finally:
        limit_threads(0)
    for name in ('disparity_px', 'confidence', 'validity'):
        np.testing.assert_array_equal(*(getattr(one, name) for one in results))


def test_noise_and_texture_are_told_apart() -> None:
    """Neither noise level nor exposure counts, and a slope down the columns is no texture."""
    rng = np.random.default_rng(3)
    noise = rng.normal(0, 1.0, (80, 120)).astype(np.float32)
    rows = np.arange(80, dtype=np.float32)[:, None]
    textured = texture(80, 120, blur=1.5) - 128
    for gain in (0.2, 3.0):
        for image, share in ((noise + 2 * rows, 1.0), (noise + 0.05 * textured, 0.0)):
            level = (gain * image).astype(np.float32)
            inside = is_noise(level, cv2.pyrDown(level))[4:-4, 4:-4]
            assert abs(inside.mean() - share) < 0.02


def test_a_pole_before_a_wall_does_not_vanish() -> None:
    """A pole of 12 px at 22 px, before a wall at 6 px."""
    wall, pole = texture(90, 200, blur=1.5), texture(90, 60, seed=9, blur=1.5)
    left, right = wall[:, 6:186].copy(), wall[:, 12:192].copy()
    left[:, 90:102], right[:, 68:80] = pole[:, :12], pole[:, :12]
    disparity = match(left, right, fast()).disparity_px
    assert (np.abs(disparity[8:-8, 90:102] - 22) < 1).mean() > 0.5
    assert (np.abs(disparity[8:-8, 110:160] - 6) < 1).mean() > 0.95
