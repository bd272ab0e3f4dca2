# SPDX-License-Identifier: Apache-2.0
"""The search range: found from the images, checked where it is given, kept over frames."""

from __future__ import annotations

import functools
import math
from pathlib import Path

import numpy as np
import pytest

from binocular_recon.camera import Camera, StereoRig
from binocular_recon.config import ChainConfig, MatchConfig
from binocular_recon.errors import ConfigError
from binocular_recon.evaluation.accuracy.scenes import read_scene
from binocular_recon.evaluation.speed.synthetic import synthetic_pair
from binocular_recon.images import FloatImage, to_grey
from binocular_recon.stereo.pipeline import estimate_disparity
from binocular_recon.stereo.range_tracker import EXAMINE_EVERY_S, SHRINK_AFTER, RangeTracker
from binocular_recon.stereo.search_range import (
    SearchRange,
    choose_range,
    find_range,
    overview,
    range_of_depths,
)

WIDTH, HEIGHT = 640, 480


@functools.cache
def pair(disparities: int, shift: int = 0, seed: int = 0) -> tuple[FloatImage, FloatImage, float]:
    """Return grey images whose disparities are within shift..shift + disparities, and the largest.

    ``shift`` moves the right image, as cameras that look at each other do.
    """
    made = synthetic_pair(WIDTH + abs(shift), HEIGHT, disparities, seed)
    left, right = to_grey(made.left), to_grey(made.right)
    if shift < 0:
        left, right = left[:, -shift:], right[:, :shift]
        largest = made.disparity_px[:, -shift:].max() + shift
    else:
        left, right = left[:, : left.shape[1] - shift], right[:, shift:]
        largest = made.disparity_px[:, :WIDTH].max() - shift if shift else made.disparity_px.max()
    return np.ascontiguousarray(left), np.ascontiguousarray(right), float(largest)


def rig(offset_px: float = 0.0, focal_px: float = 500.0, baseline_m: float = 0.6) -> StereoRig:
    cameras = []
    for cx, tx in ((320.0 + offset_px, 0.0), (320.0, -focal_px * baseline_m)):
        P = np.array([[focal_px, 0, cx, tx], [0, focal_px, 240, 0], [0, 0, 1, 0.0]])
        cameras.append(Camera(WIDTH, HEIGHT, P[:, :3], np.zeros(5), np.eye(3), P))
    return StereoRig(*cameras)


@pytest.mark.parametrize('disparities', [16, 48, 96, 200])
@pytest.mark.parametrize('known', [True, False])
def test_the_range_holds_all_disparities_and_little_more(disparities: int, known: bool) -> None:
    left, right, largest = pair(disparities)
    infinity_px = 0.0 if known else None
    found = find_range(overview(left, right, MatchConfig(), infinity_px), WIDTH, infinity_px)
    assert found.min_disparity <= 0
    assert largest <= found.last <= 1.5 * largest + 8
    if known:
        assert found.min_disparity == -1  # just behind infinity


def test_cameras_that_look_at_each_other() -> None:
    """All disparities are negative: at 0..127 nothing would be right."""
    left, right, largest = pair(60, shift=-80)
    found, warning, _ = choose_range(left, right, MatchConfig(), -80.0)
    assert warning == ''
    assert found.min_disparity == -81
    assert largest <= found.last < 0
    made = synthetic_pair(WIDTH + 80, HEIGHT, 60)
    images = made.left[:, 80:], made.right[:, :-80]
    estimate = estimate_disparity(*images, ChainConfig(), infinity_px=-80.0)
    error_px = np.abs(estimate.filtered.disparity_px - (made.disparity_px[:, 80:] - 80))
    assert 100 * np.mean(error_px > 2) < 8


def test_a_range_that_is_too_small_is_noticed() -> None:
    left, right, largest = pair(96)
    config = MatchConfig(disparity_range=32)
    _, warning, outside = choose_range(left, right, config, 0.0)
    assert 0.2 < outside < 0.8
    assert 'the search range 0..31 px is too small' in warning
    assert 'above 31 px (nearer)' in warning
    words = warning.replace(',', '').split()
    advised = int(words[words.index('disparity_range') + 1])
    assert largest < advised < 1.5 * largest + 16
    better = MatchConfig(
        min_disparity=int(words[words.index('min_disparity') + 1]), disparity_range=advised
    )
    assert choose_range(left, right, better, 0.0)[1] == ''
    # and one that begins too near
    _, warning, _ = choose_range(
        left, right, MatchConfig(min_disparity=40, disparity_range=80), 0.0
    )
    assert 'below 40 px' in warning


def test_a_range_that_fits_is_not_complained_about() -> None:
    left, right, _ = pair(96)
    given, warning, outside = choose_range(left, right, MatchConfig(disparity_range=96), 0.0)
    assert (given, warning, outside) == (SearchRange(0, 96), '', 0.0)


def test_images_without_texture_get_half_of_the_width() -> None:
    flat = np.full((HEIGHT, WIDTH), 90, np.float32)
    found, warning, _ = choose_range(flat, flat, MatchConfig(), 5.5)
    assert (found.min_disparity, found.last, warning) == (5, 326, '')
    assert choose_range(flat, flat, MatchConfig(disparity_range=16), 5.5)[1] == ''


def test_a_given_start_is_kept() -> None:
    left, right, largest = pair(96)
    found = choose_range(left, right, MatchConfig(min_disparity=7), 0.0).search
    assert found.min_disparity == 7
    assert found.last >= largest


@pytest.mark.parametrize('shape', [(1, 1), (3, 40), (40, 3), (12, 900)])
def test_small_images_have_a_range_too(shape: tuple[int, int]) -> None:
    noise = np.random.default_rng(0).uniform(0, 255, shape).astype(np.float32)
    found = choose_range(noise, noise, MatchConfig(), 0.0).search
    assert found.disparity_range >= 16


def test_depths_become_disparities() -> None:
    # f B = 300 px m
    assert range_of_depths(5.0, 20.0, rig()) == SearchRange(14, 61 - 14 + 1)
    assert range_of_depths(5.0, math.inf, rig(-3.0)) == SearchRange(-4, 58 + 4 + 1)
    near, far = range_of_depths(5.0, 20.0, rig(2.0)).depths_m(rig(2.0))
    assert near < 5.0 < 20.0 < far
    search = SearchRange(0, 64)
    near, far = search.depths_m(rig())
    assert near == pytest.approx(300 / 63)
    assert far == math.inf
    assert search.describe(rig()) == '0 to 63 px, depths of 4.76 m to infinity'
    assert (
        range_of_depths(5.0, 20.0, rig()).describe(rig())
        == '14 to 61 px, depths of 4.92 m to 21.4 m'
    )
    assert SearchRange(-9, 8).describe(rig()) == '-9 to -2 px, no depth'


@pytest.mark.parametrize(('near', 'far'), [(0.0, 5.0), (6.0, 5.0), (5.0, 5.0), (-1.0, 2.0)])
def test_depths_out_of_order_are_refused(near: float, far: float) -> None:
    with pytest.raises(ConfigError, match='near must be above 0 and below far, got'):
        range_of_depths(near, far, rig())


def test_depths_that_need_too_many_disparities_are_refused() -> None:
    with pytest.raises(ConfigError, match=r'0\.05 to inf m are disparities of -1 to 6001 px'):
        range_of_depths(0.05, math.inf, rig())


def test_a_range_to_be_found_has_no_limits_yet() -> None:
    with pytest.raises(ConfigError, match=r'disparity_range is 0, to be found'):
        _ = MatchConfig().limits_px
    with pytest.raises(ConfigError, match=r'within 2\.\.4096 px, or 0 to find it'):
        MatchConfig(disparity_range=1)


class Live:
    """A tracker, and the images that it is shown."""

    def __init__(self) -> None:
        self.tracker = RangeTracker()
        self.small, self.large = pair(32)[:2], pair(128)[:2]
        self.now_s = 0.0

    def show(self, images: tuple[FloatImage, FloatImage]) -> SearchRange:
        self.now_s += EXAMINE_EVERY_S
        return self.tracker.update(*images, MatchConfig(), 0.0, self.now_s).search


def test_a_live_range_grows_at_once_and_shrinks_after_a_while() -> None:
    live = Live()
    first = live.show(live.small)
    wide = live.show(live.large)
    assert wide.last > 108 > first.last
    # a car that passes does not change it back and forth
    for _ in range(SHRINK_AFTER - 1):
        assert live.show(live.small) == wide
    assert live.show(live.large) == wide
    seen = [live.show(live.small) for _ in range(SHRINK_AFTER)]
    assert seen[:-1] == [wide] * (SHRINK_AFTER - 1)
    assert seen[-1] == first


def test_between_examinations_a_live_range_stays() -> None:
    live = Live()
    for _ in range(3):
        found = live.show(live.small)
    between = live.tracker.update(*live.large, MatchConfig(), 0.0, live.now_s + 0.1)
    assert between == (found, False, '')


def test_a_live_range_that_is_given_is_checked() -> None:
    live = Live()
    config = MatchConfig(disparity_range=32)
    found = live.tracker.update(*live.large, config, 0.0, 0.0)
    assert found.search == SearchRange(0, 32)
    assert 'too small' in found.warning
    assert live.tracker.update(*live.large, MatchConfig(), 0.0, 0.1).search.last > 108


@pytest.mark.parametrize(
    'scene',
    [
        'aloe',
        'cloth3',
        'cones',
        'kitti12_000027',
        'kitti12_000174',
        'motorcycle',
        'playground',
        'teddy',
    ],
)
def test_real_scenes_are_no_worse_than_with_the_range_known(shared_data: Path, scene: str) -> None:
    """Bad-2.0 is at most 2 points above that with the range known (0.5 on the mean of all)."""
    data = read_scene(shared_data / 'stereo' / scene)
    known = np.isfinite(data.truth_px)
    bad = []
    for disparity_range in (data.max_disparity_px, 0):
        config = ChainConfig.preset('default', disparity_range=disparity_range)
        found = estimate_disparity(data.left, data.right, config, infinity_px=data.offset_px)
        error_px = np.abs(found.filtered.disparity_px - data.truth_px)[known]
        bad.append(100 * np.mean(error_px > 2))
    assert bad[1] < bad[0] + 1.0
