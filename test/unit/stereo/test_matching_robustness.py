# SPDX-License-Identifier: Apache-2.0
"""Matching does not depend on exposure, crops, threads or the depth of grey levels."""

from __future__ import annotations

import numpy as np
import pytest

from binocular_recon import _jit
from binocular_recon.config import ChainConfig
from binocular_recon.stereo.matching import match, ncc_scores
from binocular_recon.stereo.matching import matcher as matching
from test.unit.stereo.matching_pairs import both_ways, config, shifted_pair


@pytest.mark.large
@both_ways
def test_results_do_not_depend_on_threads(
    monkeypatch: pytest.MonkeyPatch, semi_global: bool
) -> None:
    left, right = shifted_pair(130, 90, 3.4)
    options = config(semi_global=semi_global)
    monkeypatch.setattr(_jit, 'thread_count', lambda: 3)
    many = match(left, right, options)
    monkeypatch.setattr(_jit, 'thread_count', lambda: 1)
    one = match(left, right, options)
    np.testing.assert_array_equal(many.disparity_px, one.disparity_px)
    np.testing.assert_array_equal(many.confidence, one.confidence)


@pytest.mark.large
@both_ways
def test_exposure_does_not_matter(semi_global: bool) -> None:
    left, right = shifted_pair(60, 100, 6.5)
    options = config(semi_global=semi_global)
    plain = match(left, right, options)
    darker = match(left, right * np.float32(0.6) + 20, options)
    both = np.isfinite(plain.disparity_px) & np.isfinite(darker.disparity_px)
    assert both.mean() > 0.6
    change = np.abs(plain.disparity_px - darker.disparity_px)[both]
    assert np.quantile(change, 0.99) < 0.04  # levels are rounded to a quarter


@pytest.mark.large
@pytest.mark.parametrize('side', [0, 1])
def test_less_contrast_of_one_image_loses_no_texture(side: int) -> None:
    # just above the threshold
    pair = [image / np.float32(45) + 100 for image in shifted_pair(60, 100, 6.5)]
    seen = []
    for share in (1.0, 0.6):
        pair[side] = pair[side] * np.float32(share)
        options = config(semi_global=True, half_resolution=False, speckle_size=0)
        seen.append(np.isfinite(match(pair[0], pair[1], options).disparity_px).mean())
    assert 0.3 < seen[0] < 0.9
    assert abs(seen[1] - seen[0]) < 0.03


def test_crops_do_not_change_the_local_match() -> None:
    left, right = shifted_pair(90, 120, 5.4)  # not whole levels: scores of 16-bit images
    options = config(semi_global=False, correlation_window_size=7)
    whole = matching._winner_takes_all(left, right, options)[0]
    part = matching._winner_takes_all(left[13:71, 17:97], right[13:71, 17:97], options)[0]
    # the radius of a window from each border, and the whole search range from both sides
    np.testing.assert_array_equal(part[3:-3, 19:-19], whole[16:68, 36:78])
    scores = ncc_scores(left, right, options)[16:68, 36:78]
    np.testing.assert_array_equal(
        ncc_scores(left[13:71, 17:97], right[13:71, 17:97], options)[3:-3, 19:-19], scores
    )


@pytest.mark.parametrize(
    # grey levels of texture
    ('threshold', 'contrast', 'limit_px'),
    [(0.0, 0.1, 0.1), (0.5, 1.0, 0.025)],
)
@pytest.mark.parametrize('preset', ['fast', 'default'])
def test_16_bits_are_kept(preset: str, threshold: float, contrast: float, limit_px: float) -> None:
    left, right = shifted_pair(60, 100, 6.3)
    options = ChainConfig.preset(
        preset, disparity_range=16, correlation_window_size=9, texture_threshold=threshold
    ).match
    scale = np.float32(contrast / left.std())
    left, right = (
        (np.rint((level * scale + 100) * 257) / 257).astype(np.float32) for level in (left, right)
    )
    error = match(left, right, options).disparity_px[10:-10, 30:-10] - 6.3
    # 'fast' scores windows of 5x5 at full resolution, whatever the option says
    limit_px = max(limit_px, 0.08) if preset == 'fast' else limit_px
    assert np.sqrt(np.nanmean(error**2)) < limit_px
    assert np.isfinite(error).mean() > 0.95


def test_step_is_one_pixel_without_subpixel() -> None:
    assert matching.disparity_step_px(config()) == matching.SUBPIXEL_STEP_PX
    assert matching.disparity_step_px(config(subpixel=False)) == 1.0
