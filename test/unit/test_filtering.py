# SPDX-License-Identifier: Apache-2.0
"""Filter: against the reference values, a dense solution and bad input."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from binocular_recon.config import ChainConfig, FilterConfig
from binocular_recon.errors import ImageError
from binocular_recon.stereo.filtering import filter_disparity

REFERENCE = np.load(Path(__file__).parents[1] / 'data' / 'wls.npz')
LIMITS_PX = (0.0, 64.0)


@pytest.mark.parametrize(('name', 'preset'), [('paper', 'paper'), ('weighted', 'default')])
def test_reference(name: str, preset: str) -> None:
    options = {
        'wls_lambda': 0.02,
        'wls_alpha': 1.2,
        'wls_epsilon': 1e-4,
        'wls_complete': False,
        'wls_disparity_steps': 0.0,
    }
    config = ChainConfig.preset(
        preset, wls_tolerance_px=2e-4, **(options if preset == 'default' else {})
    ).filter
    filtered = filter_disparity(
        REFERENCE['disparity'].astype(np.float32),
        REFERENCE['confidence'].astype(np.float32)
        if preset == 'default'
        else np.full_like(REFERENCE['confidence'], 0.3, np.float32),
        REFERENCE['guide'].astype(np.float32),
        config,
        limits_px=LIMITS_PX,
    )
    assert filtered.disparity_px.dtype == np.float32
    assert np.abs(filtered.disparity_px - REFERENCE[name]).max() <= 1e-3


def test_nothing_to_filter() -> None:
    nothing = np.full((4, 5), np.nan, np.float32)
    with pytest.raises(ImageError, match=r'no pixel has a disparity within 0\.\.64 px'):
        filter_disparity(nothing, nothing, nothing, FilterConfig(), limits_px=LIMITS_PX)


def test_sizes_differ() -> None:
    image = np.ones((4, 5), np.float32)
    with pytest.raises(ImageError, match=r'confidence \(5, 4\)'):
        filter_disparity(image, image.T, image, FilterConfig(), limits_px=LIMITS_PX)
