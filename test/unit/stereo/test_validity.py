# SPDX-License-Identifier: Apache-2.0
"""Measured, filled or extrapolated, why not measured, and how uncertain what was filled is."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from binocular_recon.config import ChainConfig, MatchConfig
from binocular_recon.evaluation.speed.synthetic import synthetic_pair
from binocular_recon.images import ByteImage, FloatImage, mark_empty, to_grey
from binocular_recon.stereo.holes.uncertainty import WEIGHTS, assess_holes
from binocular_recon.stereo.matching import match
from binocular_recon.stereo.pipeline import DisparityEstimate, estimate_disparity
from binocular_recon.stereo.validity import Validity

WALL_PX = 30


def estimate(
    left: ByteImage, right: ByteImage, *, preset: str = 'default', **options: float
) -> DisparityEstimate:
    config = ChainConfig.preset(preset, **{'disparity_range': 64, **options})
    return estimate_disparity(left, right, config)


def has(validity: ByteImage, bit: Validity) -> npt.NDArray[np.bool_]:
    return (validity & bit) > 0


def wall(height: int = 240, width: int = 400, seed: int = 0) -> tuple[FloatImage, FloatImage]:
    """Return a textured wall at 30 px, without noise."""
    rng = np.random.default_rng(seed)
    texture = rng.standard_normal((height, width + WALL_PX)).astype(np.float32)
    texture = cv2.GaussianBlur(texture, (0, 0), 1.5)
    texture = 128 + 30 * texture / texture.std()
    return texture[:, :width].copy(), texture[:, WALL_PX:].copy()


def exposed(
    left: FloatImage, right: FloatImage, noise: float = 1.5
) -> tuple[ByteImage, ByteImage]:
    rng = np.random.default_rng(7)
    first, second = (
        np.clip(np.rint(image + rng.normal(0, noise, image.shape)), 0, 255).astype(np.uint8)
        for image in (left, right)
    )
    return first, second


@pytest.mark.parametrize('preset', ['fast', 'default', 'accurate'])
def test_each_pixel_has_one_origin_and_a_reason_unless_it_is_measured(preset: str) -> None:
    made = synthetic_pair(320, 240, 48)
    found = estimate(made.left, made.right, preset=preset)
    validity = found.filtered.validity
    origin = validity & (Validity.MEASURED | Validity.FILLED | Validity.EXTRAPOLATED)
    assert set(np.unique(origin)) <= {1, 2, 4}
    measured = has(validity, Validity.MEASURED)
    np.testing.assert_array_equal(measured, np.isfinite(found.matched.disparity_px))
    np.testing.assert_array_equal(validity[measured], Validity.MEASURED)
    assert (validity[~measured] >= Validity.LOW_TEXTURE).all()


def test_half_occluded_pixels_are_conflicts_and_out_of_view_extrapolated() -> None:
    made = synthetic_pair(320, 240, 48)
    validity = estimate(made.left, made.right).filtered.validity
    half_occluded = ~made.visible
    assert has(validity, Validity.MEASURED)[half_occluded].mean() < 0.25
    assert (
        has(validity, Validity.CONFLICT)[half_occluded & ~has(validity, Validity.MEASURED)].mean()
        > 0.5
    )
    # the columns that only the left camera sees
    assert has(validity, Validity.EXTRAPOLATED)[:, :3].mean() > 0.8


@pytest.mark.parametrize('kind', ['flat', 'down', 'across'])
@pytest.mark.parametrize('preset', ['fast', 'default'])
def test_there_is_no_point_in_the_sky(kind: str, preset: str) -> None:
    left, right = wall()
    rows, columns = np.mgrid[:100, : left.shape[1]].astype(np.float32)
    sky = {'flat': 200 + 0 * rows, 'down': 160 + 0.6 * rows, 'across': 150 + 0.2 * columns}[kind]
    left[:100] = right[:100] = sky
    validity = estimate(*exposed(left, right), preset=preset).filtered.validity
    # but for a window, of half resolution in 'fast', and what is smoothed with it
    clear = 80 if preset == 'fast' else 92
    assert not has(validity[:clear], Validity.MEASURED | Validity.FILLED).any()
    assert has(validity[104:-4, 36:-4], Validity.MEASURED).mean() > 0.95


def test_sky_between_two_towers_is_extrapolated_too() -> None:
    left, right = wall()
    left[:160, 150:300] = right[:160, 120:270] = 210  # down to the ground between them
    left[:60] = right[:60] = 210
    validity = estimate(*exposed(left, right)).filtered.validity
    assert has(validity[5:150, 156:264], Validity.EXTRAPOLATED).mean() > 0.99


@pytest.mark.parametrize('rows', [slice(0, 5), slice(235, 240), slice(100, 105)])
@pytest.mark.parametrize('both', [False, True])
@pytest.mark.parametrize('preset', ['fast', 'default'])
def test_rows_without_data_are_not_matched(rows: slice, both: bool, preset: str) -> None:
    left, right = exposed(*wall())
    right[rows] = 0
    if both:
        left[rows] = 0
    found = estimate(left, right, preset=preset)
    validity = found.filtered.validity
    assert not has(validity[rows], Validity.MEASURED).any()
    assert has(validity[rows], Validity.NO_DATA).all()
    # and what borders on them is right
    error_px = np.abs(found.matched.disparity_px - WALL_PX)
    allowed = 1e-3 if preset == 'fast' else 0.0
    assert np.mean(error_px[:, 40:] > 1) <= allowed


def test_a_black_border_as_rectification_leaves_it_is_not_matched() -> None:
    """A wedge at the left border and one at the bottom, in one image only."""
    left, right = exposed(*wall())
    y, x = np.mgrid[: left.shape[0], : left.shape[1]]
    empty = (x < 40 - y // 8) | (y > 225 + x // 40)
    left[empty] = 0
    found = estimate(left, right)
    assert not has(found.filtered.validity[empty], Validity.MEASURED).any()
    assert np.nanmax(np.abs(found.matched.disparity_px - WALL_PX)[:, 40:]) < 1


def test_padding_of_any_level_is_marked_and_dark_things_are_not() -> None:
    grey = np.random.default_rng(0).integers(1, 255, (60, 90)).astype(np.float32)
    expected = np.zeros(grey.shape, np.bool_)
    for place, level in (
        ((slice(0, 12), slice(0, 20)), 128),  # grey in a corner
        ((slice(40, 60), slice(60, 90)), 0),  # black in a corner
        ((slice(20, 40), slice(0, 16)), 0),  # black at the border
        ((slice(30, 31), slice(None)), 77),  # a blank row
        ((slice(None), slice(50, 51)), 77),  # a blank column
    ):
        grey[place], expected[place] = level, True
    grey[20:30, 60:70] = 0  # inside
    grey[0:5, 70:80] = 0  # small
    marked = grey.copy()
    mark_empty(marked)
    np.testing.assert_array_equal(np.isnan(marked), expected)
    np.testing.assert_array_equal(marked[~expected], grey[~expected])


def test_a_uniform_image_is_left_to_the_texture_threshold() -> None:
    for level in (0, 90, 255):
        grey = np.full((20, 30), level, np.float32)
        mark_empty(grey)
        assert (grey == level).all()


def test_disparities_at_the_limits_of_the_range_are_no_matches() -> None:
    left, right = exposed(*wall())
    for first, count in ((30, 40), (0, 31)):
        config = MatchConfig(min_disparity=first, disparity_range=count)
        validity = match(to_grey(left), to_grey(right), config).validity[10:-10, 40:-10]
        assert has(validity, Validity.AT_LIMIT).mean() > 0.9
        assert not has(validity, Validity.MEASURED).any()


def test_a_uniform_wall_is_low_texture() -> None:
    left, right = wall()
    left[60:180, 120:320] = right[60:180, 90:290] = 140
    found = estimate(*exposed(left, right, noise=0.0))
    inside = found.matched.validity[66:174, 126:314]
    assert has(inside, Validity.LOW_TEXTURE).mean() > 0.9


@pytest.mark.parametrize('preset', ['fast', 'default', 'accurate'])
def test_repetition_is_unmatched_or_right(preset: str) -> None:
    """A patch of period 12 px at 14 px before a background at 6 px: 2 and 26 px fit as well."""
    rng = np.random.default_rng(3)
    background = cv2.GaussianBlur(rng.standard_normal((200, 520)).astype(np.float32), (0, 0), 1.2)
    background = 128 + 35 * background / background.std()
    x = np.arange(520)
    pattern = 128 + 60 * np.sin(2 * np.pi * x / 12) + 18 * np.sin(4 * np.pi * x / 12 + 1)
    views = []
    for own, patch in ((40, 0), (46, 14)):
        view = background[:, own : own + 440].copy()
        view[40:160, 100 - patch : 340 - patch] = pattern[100:340]
        views.append(view)
    found = estimate(*exposed(views[0], views[1]), preset=preset, min_disparity=-1)
    inside = (slice(48, 152), slice(116, 324))
    wrong = np.abs(found.matched.disparity_px[inside] - 14) > 2  # NaN is not
    assert wrong.mean() < 0.06
    assert has(found.matched.validity[inside], Validity.AMBIGUOUS).mean() > 0.2


def naive(measured: FloatImage, filled: FloatImage) -> npt.NDArray[np.float64]:
    """Return the mean squared difference from the nearest measured pixels in four directions."""
    height, width = measured.shape
    result = np.zeros(measured.shape)
    for y in range(height):
        for x in range(width):
            squares = []
            for dy, dx in ((0, -1), (0, 1), (-1, 0), (1, 0)):
                j, i = y, x
                while 0 <= j < height and 0 <= i < width and np.isnan(measured[j, i]):
                    j, i = j + dy, i + dx
                if 0 <= j < height and 0 <= i < width:
                    squares.append((float(measured[j, i]) - float(filled[y, x])) ** 2)
            result[y, x] = np.mean(squares) if squares else 0.0
    return result


@pytest.mark.kernel
def test_candidates_of_holes_equal_the_naive_twin(monkeypatch: pytest.MonkeyPatch) -> None:
    room = 'binocular_recon.stereo.holes.uncertainty'
    weights = WEIGHTS._replace(rows=0.0, unexplained=1.0, distance_beyond=WEIGHTS.distance)
    monkeypatch.setattr(f'{room}.WEIGHTS', weights)
    most = np.full((23, 31), 1e6, np.float32)
    monkeypatch.setattr(f'{room}._row_variance', lambda _: most)
    rng = np.random.default_rng(5)
    measured = rng.uniform(0, 40, (23, 31)).astype(np.float32)
    measured[rng.uniform(size=measured.shape) < 0.6] = np.nan
    measured[5:12, 8:25] = np.nan
    filled = np.where(np.isnan(measured), rng.uniform(0, 40, measured.shape), measured)
    filled = filled.astype(np.float32)
    variance, validity = assess_holes(measured, filled, np.isnan(measured))
    hole = np.isnan(measured)
    distance = cv2.distanceTransform(hole.astype(np.uint8), cv2.DIST_L2, 3)
    expected = WEIGHTS.candidates * naive(measured, filled) + WEIGHTS.distance**2 * distance**2
    np.testing.assert_allclose(variance[hole], expected[hole], rtol=1e-4)
    np.testing.assert_array_equal(validity == Validity.MEASURED, ~hole)


@pytest.mark.kernel
def test_nothing_measured_around_is_extrapolated() -> None:
    measured = np.full((40, 60), np.nan, np.float32)
    measured[10:30, 20:40] = 12.0
    measured[15:20, 25:30] = np.nan
    variance, validity = assess_holes(measured, np.full_like(measured, 12.0))
    assert np.isfinite(variance).all()
    inside = np.zeros(measured.shape, np.bool_)
    inside[15:20, 25:30] = True
    np.testing.assert_array_equal(validity == Validity.FILLED, inside)
    np.testing.assert_array_equal(validity == Validity.EXTRAPOLATED, np.isnan(measured) & ~inside)


def test_deviation_of_filled_pixels_is_calibrated() -> None:
    """Outliers included: the RMS of error / sigma is about 1, and few are beyond 3 sigma."""
    rms = []
    for seed in range(4):
        made = synthetic_pair(320, 240, 48, seed)
        found = estimate(made.left, made.right, disparity_range=48)
        filled = has(found.filtered.validity, Validity.FILLED)
        error = np.abs(found.filtered.disparity_px - made.disparity_px)[filled]
        ratio = error / found.filtered.sigma_px[filled]
        rms.append(np.sqrt(np.mean(ratio**2)))
        assert np.mean(ratio > 3) < 0.1
    assert 0.7 < np.median(rms) < 2.0


def test_empty_borders_do_not_reach_the_grey_levels_of_others() -> None:
    image = np.random.default_rng(1).integers(1, 255, (50, 60, 3), np.uint8)
    grey = to_grey(image)
    marked = grey.copy()
    mark_empty(marked)
    np.testing.assert_array_equal(marked, grey)
