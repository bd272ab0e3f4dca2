# SPDX-License-Identifier: Apache-2.0
"""Semi-global matching: NCC costs are aggregated along paths before the best one is chosen."""

from __future__ import annotations

import numpy as np

from binocular_recon._jit import over_strips
from binocular_recon.config import MatchConfig
from binocular_recon.images import ByteImage, FloatImage
from binocular_recon.stereo.matching._aggregation_kernels import Penalties, match_strip
from binocular_recon.stereo.matching._cost_kernels import CostSource
from binocular_recon.stereo.matching._preparation import (
    exposure_gain,
    normalised_levels,
    padded_range,
    prepare_pair,
    selection_of,
)

# Grey levels below are those of `normalised_levels`, which do not change with the exposure.
# Standard deviation of the image noise: texture below it is not reliable.
NOISE = 2.0
# The penalty P2 depends on the difference of grey levels between the two pixels: it is constant up
# to `GENTLE_STEP`, then falls as 1 / difference, down to the share `LEAST_P2`.
GENTLE_STEP = 16.0
LEAST_P2 = 1 / 3
# Largest number of rows of two strips together.
STRIP_PAIR = 256


def choose_disparities(
    left: FloatImage, right: FloatImage, config: MatchConfig, *, ends: bool = False
) -> tuple[FloatImage, ByteImage]:
    """Choose the disparities of a checked pair by semi-global matching.

    With ``ends`` the first and the last disparity are matches.

    Returns
    -------
    disparity_px : (H, W) float32
        NaN = none.
    validity : (H, W) uint8
        `Validity.MEASURED`, or why there is no disparity.

    Notes
    -----
    H. Hirschmueller, "Stereo processing by semiglobal matching and mutual information", PAMI
    2008. The cost is 1 - NCC instead of mutual information, and there are three paths instead of
    eight: both ways along the row, and down the column. Each row is thus processed once, and no
    cost volume is stored.

    """
    height, width = left.shape
    source = _cost_source(left, right, config)
    results = np.full((height, width), np.nan, np.float32), np.zeros((height, width), np.uint8)
    over_strips(
        match_strip,
        height,
        source,
        normalised_levels(left),
        _penalties(config),
        selection_of(config, ends=ends),
        results,
        strip=-(-height // (2 * -(-height // STRIP_PAIR))),
    )
    return results


def _cost_source(left: FloatImage, right: FloatImage, config: MatchConfig) -> CostSource:
    size = config.correlation_window_size
    gain, right_gain = exposure_gain(left), exposure_gain(right)
    # the darker image has less texture everywhere
    contrasts = min(right_gain / gain, 1.0), min(gain / right_gain, 1.0)
    big, steps = prepare_pair(left, right, config, size // 2, contrasts)
    small = big._replace(size=max(size - 2, 3), least_energy=(0.0, 0.0))
    noise = NOISE / gain * steps * small.size
    return CostSource(
        big,
        small,
        # no smaller window fits into one of 3
        noise**2 if size > small.size else np.inf,
        config.disparity_range,
        padded_range(config),
    )


def _penalties(config: MatchConfig) -> Penalties:
    # paths are in eighths of a cost, the options in quarters of it
    P1, P2 = config.small_step_penalty // 2, config.large_step_penalty / 2
    step = np.maximum(np.arange(256) / GENTLE_STEP, 1)
    return Penalties(P1, np.maximum(P2 / step, P2 * LEAST_P2).astype(np.uint8))
