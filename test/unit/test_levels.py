# SPDX-License-Identifier: Apache-2.0
"""Black and white of images whose type does not say them."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from binocular_recon.config import ChainConfig
from binocular_recon.errors import ConfigError
from binocular_recon.evaluation.speed.synthetic import synthetic_pair
from binocular_recon.images import to_bgr8, to_grey
from binocular_recon.inputs.levels import SHRINK_AFTER, Levels, LevelTracker, find_levels
from binocular_recon.inputs.options import ImageConfig
from binocular_recon.io.pfm import read_pfm
from binocular_recon.stereo.pipeline import estimate_disparity

Image = npt.NDArray[Any]
Conversion = Callable[[Image], Image]


def eight_bit(seed: int = 0) -> Image:
    """Return an image that uses the whole range."""
    noise = np.random.default_rng(seed).uniform(0, 255, (120, 160)).astype(np.float32)
    smooth = cv2.GaussianBlur(noise, (0, 0), 2)
    return np.asarray(cv2.normalize(smooth, None, 0, 255, cv2.NORM_MINMAX, cv2.CV_8U))


# Other types that hold the same image, and their white.
SAME: dict[str, tuple[Conversion, float]] = {
    '8 bits in 16': (lambda image: image.astype(np.uint16), 255),
    '10 bits': (lambda image: image.astype(np.uint16) << 2, 1020),
    '12 bits': (lambda image: image.astype(np.uint16) << 4, 4080),
    '12 bits, scaled': (lambda image: np.rint(image / 255 * 4095).astype(np.uint16), 4080),
    '14 bits': (lambda image: image.astype(np.uint16) << 6, 16320),
    '16 bits': (lambda image: image.astype(np.uint16) * 257, 65535),
    '0 to 1': (lambda image: (image / 255).astype(np.float32), 1),
    '0 to 255': (lambda image: image.astype(np.float32), 255),
    '0 to 255, double': (lambda image: image.astype(np.float64), 255),
    '0 to 4095 as float': (lambda image: image.astype(np.float32) * 16, 4080),
}
# Values far from 0, and with both signs.
SHIFTED: dict[str, Conversion] = {
    'thermal counts': lambda image: (21000 + image / 255 * 3000).astype(np.uint16),
    'thermal counts of 14 bits': lambda image: (7400 + image / 255 * 900).astype(np.uint16),
    'Kelvin': lambda image: (285 + image / 255 * 20).astype(np.float32),
    'Celsius': lambda image: (-10 + image / 255 * 50).astype(np.float32),
    '-1 to 1': lambda image: (image / 127.5 - 1).astype(np.float32),
}


@pytest.mark.parametrize('kind', SAME)
def test_white_is_found(kind: str) -> None:
    convert, white = SAME[kind]
    image = eight_bit()
    levels = find_levels(convert(image))
    assert levels == (0.0, white)
    grey = to_grey(convert(image), levels)
    np.testing.assert_allclose(grey, image, atol=1.0)
    assert np.abs(to_bgr8(convert(image))[..., 0].astype(int) - image).max() <= 1


@pytest.mark.parametrize('kind', SHIFTED)
def test_levels_far_from_0_are_spread(kind: str) -> None:
    image = eight_bit()
    shifted = SHIFTED[kind](image)
    levels = find_levels(shifted)
    spread = float(shifted.max()) - float(shifted.min())
    assert levels.white - levels.black == pytest.approx(1.5 * spread, rel=0.1)
    grey = to_grey(shifted, levels)
    assert grey.min() > 20 and grey.max() < 235
    assert np.corrcoef(grey.ravel(), image.ravel())[0, 1] > 0.9999


def test_no_data_stays_no_data_when_black_is_not_0() -> None:
    counts = SHIFTED['thermal counts'](eight_bit())
    counts[:20] = 0  # as rectification leaves it
    grey = to_grey(counts)
    assert (grey[:20] == 0).all() and grey[20:].min() > 20
    kelvin = SHIFTED['Kelvin'](eight_bit())
    kelvin[:20] = np.nan
    assert np.isnan(to_grey(kelvin)[:20]).all() and np.isfinite(to_grey(kelvin)[20:]).all()


def test_what_worked_keeps_its_scale() -> None:
    """Overshoot of interpolated images from 0 to 1 is not another white."""
    image = (eight_bit() / 255 * 1.3 - 0.15).astype(np.float32)
    assert find_levels(image) == (0.0, 1.0)
    np.testing.assert_allclose(to_grey(image), 255 * image, atol=1e-4)
    foggy = ((eight_bit() / 6 + 150).astype(np.uint16)) * 257
    assert find_levels(foggy) == (0.0, 65535.0)
    assert find_levels(eight_bit() // 8) == (0.0, 255.0)
    assert find_levels(np.zeros((9, 9), np.uint16)) == (0.0, 65535.0)
    assert find_levels(np.full((9, 9), np.nan, np.float32)) == (0.0, 1.0)


def test_hot_pixels_do_not_count() -> None:
    image = eight_bit().astype(np.uint16) << 4
    image[::60, ::80] = 65535
    assert find_levels(image) == (0.0, 4080.0)
    assert to_grey(image).max() <= 255 + 127
    counts = eight_bit().astype(np.uint16) * 2 + 7000
    black, white = find_levels(counts)
    counts.flat[np.random.default_rng(2).integers(0, counts.size, counts.size // 10_000)] = 16383
    assert find_levels(counts) == pytest.approx((black, white), abs=80)


def test_both_images_of_a_pair_have_one_white() -> None:
    bright, dark = (eight_bit().astype(np.uint16) << shift for shift in (4, 1))
    assert LevelTracker().update(bright, dark) == ((0.0, 4080.0),) * 2
    assert LevelTracker().update(eight_bit(), dark) == ((0.0, 255.0), (0.0, 1020.0))


def test_levels_of_a_stream_are_stable() -> None:
    tracker = LevelTracker()
    dark, bright = (eight_bit().astype(np.uint16) << shift for shift in (2, 4))
    assert tracker.update(dark) == ((0.0, 1020.0),)
    assert tracker.update(bright) == ((0.0, 4080.0),)  # grows at once
    for _ in range(3):  # a passing cloud, shorter than it takes to shrink
        for _ in range(SHRINK_AFTER - 1):
            assert tracker.update(dark) == ((0.0, 4080.0),)
        assert tracker.update(bright) == ((0.0, 4080.0),)
    found = [tracker.update(dark)[0].white for _ in range(SHRINK_AFTER)]
    assert found == [4080.0] * (SHRINK_AFTER - 1) + [1020.0]


def test_thermal_levels_of_a_stream_change_rarely() -> None:
    tracker = LevelTracker()
    generator = np.random.default_rng(1)
    found = []
    for _ in range(60):  # the offset drifts and the span varies, as with an uncooled camera
        low, span = 21000 + generator.uniform(-150, 150), 3000 * generator.uniform(0.8, 1)
        found.append(tracker.update((low + eight_bit() / 255 * span).astype(np.uint16))[0])
    assert len(set(found)) <= 2
    spans = {levels.white - levels.black for levels in found}
    assert all(3000 < span < 6000 for span in spans)


def test_one_damaged_frame_does_not_stay() -> None:
    tracker = LevelTracker()
    image = eight_bit().astype(np.uint16) << 4
    tracker.update(image)
    assert tracker.update(np.full_like(image, 65535))[0].white == 65535
    for _ in range(SHRINK_AFTER):
        levels = tracker.update(image)[0]
    assert levels == (0.0, 4080.0)


def test_levels_can_be_fixed() -> None:
    tracker = LevelTracker(ImageConfig(white_level=4095.0, black_level=64.0))
    image = eight_bit().astype(np.uint16)
    assert tracker.update(image, eight_bit()) == (Levels(64.0, 4095.0), Levels(0.0, 255.0))
    config = ChainConfig.preset('default', white_level=1023)
    assert config.images.white_level == 1023.0
    with pytest.raises(ConfigError, match='black_level must be below white_level, got 9 and 0'):
        ImageConfig(black_level=9.0)


@pytest.mark.parametrize('kind', [*SAME, *SHIFTED])
def test_disparities_are_those_of_8_bit(kind: str) -> None:
    made = synthetic_pair(160, 120, 32, seed=1)
    convert = SHIFTED[kind] if kind in SHIFTED else SAME[kind][0]
    config = ChainConfig.preset('default', disparity_range=32)
    plain, other = (
        estimate_disparity(images[0], images[1], config).filtered.disparity_px
        for images in (
            (made.left, made.right),
            tuple(convert(to_grey(image)) for image in (made.left, made.right)),
        )
    )
    wrong, expected = (np.mean(np.abs(found - made.disparity_px) > 2) for found in (other, plain))
    assert wrong <= expected + 0.01


@pytest.mark.parametrize('kind', ['10 bits', '12 bits, scaled', '14 bits', 'thermal counts'])
def test_real_scene_in_other_bits(shared_data: Path, kind: str) -> None:
    folder = shared_data / 'stereo' / 'motorcycle'
    pair = [cv2.imread(str(folder / f'{side}.png')) for side in ('left', 'right')]
    truth = read_pfm(folder / 'disparity.pfm')
    convert = SHIFTED[kind] if kind in SHIFTED else SAME[kind][0]
    bad = []
    for images in (pair, [convert(image) for image in pair]):
        found = estimate_disparity(images[0], images[1], dataclasses.replace(ChainConfig()))
        error_px = np.abs(found.filtered.disparity_px - truth)[np.isfinite(truth)]
        bad.append(100 * np.mean(~(error_px <= 2)))
    assert abs(bad[1] - bad[0]) < 0.3
