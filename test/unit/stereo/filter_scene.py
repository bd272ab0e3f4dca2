# SPDX-License-Identifier: Apache-2.0
"""What test_filtering and test_filter_sigma share."""

from __future__ import annotations

from typing import Any

import numpy as np

from binocular_recon.config import FilterConfig
from binocular_recon.images import FloatImage
from binocular_recon.stereo.filtering.wls_filter import (
    Filtered,
    filter_disparity,
)

LIMITS_PX = (0.0, 64.0)


# eq. 13 as it stands
PLAIN = FilterConfig(wls_complete=False, wls_disparity_steps=0.0, wls_tolerance_px=2e-4)


NAN = np.float32(np.nan)


def scene(
    seed: int, shape: tuple[int, int] = (20, 28)
) -> tuple[FloatImage, FloatImage, FloatImage]:
    """Return disparity with holes, confidence and guide of a box before a wall."""
    rng = np.random.default_rng(seed)
    disparity = np.full(shape, 12.0)
    guide = np.full(shape, 90.0)
    disparity[5:15, 8:18], guide[5:15, 8:18] = 30.0, 180.0
    disparity += rng.normal(0, 0.2, shape)
    guide += rng.normal(0, 4, shape)
    disparity[rng.random(shape) < 0.2] = np.nan
    confidence = rng.uniform(0.1, 1, shape)
    return disparity.astype(np.float32), confidence.astype(np.float32), guide.astype(np.float32)


def run(
    disparity: FloatImage,
    confidence: FloatImage,
    guide: FloatImage,
    config: FilterConfig = PLAIN,
    **options: Any,
) -> Filtered:
    return filter_disparity(
        disparity, confidence, guide, config, **{'limits_px': LIMITS_PX, **options}
    )


def difference(a: Filtered, b: Filtered) -> float:
    return float(np.abs(a.disparity_px - b.disparity_px).max())
