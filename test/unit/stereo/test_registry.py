# SPDX-License-Identifier: Apache-2.0
"""Matchers by name: a registered one is reached by the option, in the chain and on the command."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import cv2
import numpy as np
import pytest

from binocular_recon.camera import Camera, StereoRig
from binocular_recon.cli.main import main
from binocular_recon.config import MATCHER_NAMES, ChainConfig, MatchConfig
from binocular_recon.errors import ConfigError, ImageError
from binocular_recon.images import FloatImage
from binocular_recon.io.pfm import read_pfm
from binocular_recon.stereo import Chain
from binocular_recon.stereo.matching import Match, match, register_matcher, registry
from binocular_recon.stereo.validity import Validity

pytestmark = pytest.mark.usefixtures('built_in_matchers')

HEIGHT, WIDTH = 24, 32
BLANK = np.full((HEIGHT, WIDTH), 90, np.uint8)


def constant(left: FloatImage, right: FloatImage, config: MatchConfig) -> Match:
    """Match every pixel at the middle of the range."""
    assert left.dtype == right.dtype == np.float32
    disparity = np.full(left.shape, config.min_disparity + config.disparity_range // 2, np.float32)
    validity = np.full(left.shape, Validity.MEASURED, np.uint8)
    return Match(disparity, np.ones_like(disparity), validity)


def make_rig() -> StereoRig:
    cameras = []
    for tx in (0.0, -100.0):
        P = np.array([[200.0, 0, WIDTH / 2, tx], [0, 200, HEIGHT / 2, 0], [0, 0, 1, 0]])
        cameras.append(Camera(WIDTH, HEIGHT, P[:, :3], np.zeros(5), np.eye(3), P))
    return StereoRig(*cameras)


def test_the_documented_names_are_the_built_in_matchers() -> None:
    assert list(registry._MATCHERS) == MATCHER_NAMES == ['ncc', 'onnx']
    assert MatchConfig().matcher == 'ncc'


def test_the_chain_uses_a_registered_matcher() -> None:
    register_matcher('constant', constant)
    config = ChainConfig.preset('fast', matcher='constant', disparity_range=16)
    result = Chain(make_rig(), config, rectify=False)(BLANK, BLANK)
    np.testing.assert_array_equal(result.matched.disparity_px, 8)
    np.testing.assert_allclose(result.filtered.disparity_px, 8, atol=0.01)
    np.testing.assert_allclose(result.cloud.depth_m, 200 * 0.5 / 8, rtol=1e-3)


def test_a_matcher_of_colour_gets_colour() -> None:
    def blue(left: FloatImage, right: FloatImage, config: MatchConfig) -> Match:
        found = constant(left[..., 0], right[..., 0], config)
        # the blue channel is the disparity
        return dataclasses.replace(found, disparity_px=left[..., 0])

    register_matcher('blue', blue, colour=True)
    random = np.random.default_rng(1)
    image = random.integers(3, 12, (HEIGHT, WIDTH, 3)).astype(np.uint8)
    config = ChainConfig.preset('fast', matcher='blue', disparity_range=16)
    result = Chain(make_rig(), config, rectify=False)(image, image)
    np.testing.assert_array_equal(result.matched.disparity_px, image[..., 0])
    # without colour it gets the grey levels in each channel
    grey = np.full((HEIGHT, WIDTH), 11, np.float32)
    np.testing.assert_array_equal(match(grey, grey, config.match).disparity_px, 11)


def test_a_command_uses_a_registered_matcher(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    register_matcher('constant', constant)
    image, output = tmp_path / 'image.png', tmp_path / 'disparity.pfm'
    cv2.imwrite(str(image), BLANK)
    words = ['match', str(image), str(image), '--max-disparity', '15', '--output', str(output)]
    assert main([*words, '--matcher', 'constant']) == 0
    np.testing.assert_allclose(read_pfm(output), 8, atol=0.01)
    with pytest.raises(SystemExit):
        main([*words, '--matcher', 'census'])
    assert "matcher must be one of ncc, onnx, constant, got 'census'" in capsys.readouterr().err


def test_an_unknown_matcher_is_refused() -> None:
    with pytest.raises(ConfigError, match="matcher must be one of ncc, onnx, got 'census'"):
        ChainConfig.preset('default', matcher='census')


@pytest.mark.parametrize('name', ['ncc', 'constant'])
def test_a_name_is_registered_once(name: str) -> None:
    register_matcher('constant', constant)
    message = f"matcher '{name}' is registered already; choose a name that is not one of ncc, onnx"
    with pytest.raises(ConfigError, match=message):
        register_matcher(name, constant)


def test_options_from_a_process_with_more_matchers_are_refused() -> None:
    register_matcher('constant', constant)
    config = MatchConfig(matcher='constant', disparity_range=16)
    del registry._MATCHERS['constant']
    left = BLANK.astype(np.float32)
    with pytest.raises(
        ConfigError, match=r"one of ncc, onnx, got 'constant'; call register_matcher"
    ):
        match(left, left, config)


def test_disparities_of_another_size_are_refused() -> None:
    def half(left: FloatImage, right: FloatImage, config: MatchConfig) -> Match:
        return constant(left[::2], right[::2], config)

    register_matcher('half', half)
    left = BLANK.astype(np.float32)
    message = r"matcher 'half' returned disparity_px of shape \(12, 32\) for images of \(24, 32\)"
    with pytest.raises(ImageError, match=message):
        match(left, left, MatchConfig(matcher='half', disparity_range=16))


def test_a_range_that_is_yet_to_be_found_is_refused() -> None:
    left = BLANK.astype(np.float32)
    with pytest.raises(
        ConfigError, match=r'disparity_range is 0, .*; set it, or call search_range'
    ):
        match(left, left, MatchConfig())
