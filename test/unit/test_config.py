# SPDX-License-Identifier: Apache-2.0
"""Options: presets, overrides and what is refused."""

from __future__ import annotations

import dataclasses

import pytest

from binocular_recon.config import PRESETS, ChainConfig, MatchConfig
from binocular_recon.errors import ConfigError
from binocular_recon.options import OptionValue


def test_explicit_value_wins_over_the_preset() -> None:
    config = ChainConfig.preset('paper', wls_lambda=0.1, max_depth=50)
    assert config.filter.wls_lambda == 0.1
    assert config.filter.wls_alpha == 1.8
    assert config.cloud.max_depth == 50.0


@pytest.mark.parametrize('name', PRESETS)
def test_each_preset_is_valid(name: str) -> None:
    ChainConfig.preset(name)


def test_every_option_is_described_and_named_once() -> None:
    names: list[str] = []
    for group in dataclasses.fields(ChainConfig):
        for spec in dataclasses.fields(getattr(ChainConfig(), group.name)):
            assert spec.metadata['description']
            names.append(spec.name)
    assert len(names) == len(set(names))


@pytest.mark.parametrize(
    ('overrides', 'message'),
    [
        ({'wls_lamda': 1.0}, 'unknown options: wls_lamda'),
        ({'correlation_window_size': 8}, 'must be 3 plus a multiple of 2 px, got 8'),
        ({'correlation_window_size': 33}, r'must be within 3..31 px, got 33'),
        ({'wls_lambda': float('nan')}, r'wls_lambda must be within .* got nan'),
        ({'wls_guide': 'right'}, "wls_guide must be one of left, disparity, got 'right'"),
        (
            {'small_step_penalty': 100, 'large_step_penalty': 60},
            'penalty must be at most large_step_penalty, got 100 and 60',
        ),
        ({'min_disparity': 1.5}, 'min_disparity must be a whole number, got 1.5'),
        ({'disparity_range': True}, 'disparity_range must be a whole number, got True'),
    ],
)
def test_bad_option_is_refused(overrides: dict[str, OptionValue], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        ChainConfig.preset('default', **overrides)


def test_unknown_preset_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"preset must be one of paper, .*got 'best'"):
        ChainConfig.preset('best')


def test_limits_are_the_searched_disparities() -> None:
    assert MatchConfig(min_disparity=-5, disparity_range=20).limits_px == (-5.0, 14.0)
