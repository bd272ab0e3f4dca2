# SPDX-License-Identifier: Apache-2.0
"""Semi-global matching: NCC costs, aggregated along paths, become disparities."""

from __future__ import annotations

import numpy as np

from binocular_recon._jit import over_strips
from binocular_recon.config import MatchConfig
from binocular_recon.images import ByteImage, FloatImage
from binocular_recon.stereo.matching._aggregation_kernels import Decision, Penalties, match_strip
from binocular_recon.stereo.matching._cost_kernels import CostSource
from binocular_recon.stereo.matching._layout import (
    even_levels,
    exposure_gain,
    lay_out,
    padded_range,
)

# Grey levels below are `even_levels`: they do not change with the exposure.
# Standard deviation of the pictures' noise: texture below it tells little.
NOISE = 2.0
# P2 falls with the step of grey level that a change of disparity goes with: P2 up to
# `GENTLE_STEP`, then as 1 / step, down to `LEAST_P2` of it.
GENTLE_STEP = 16.0
LEAST_P2 = 1 / 3
# Rows of a pair of strips, at most.
STRIP_PAIR = 256


def select_disparities(
    left: FloatImage, right: FloatImage, config: MatchConfig
) -> tuple[FloatImage, ByteImage]:
    """Match a checked pair.

    Returns
    -------
    disparity_px : (H, W) float32
        NaN = none.
    validity : (H, W) uint8
        Measured, or why not.

    Notes
    -----
    H. Hirschmueller, "Stereo processing by semiglobal matching and mutual information", PAMI
    2008. The cost is 1 - NCC instead of mutual information, along three paths instead of eight:
    both ways along the row and from the top. So rows pass once, without a volume of costs.

    """
    height, width = left.shape
    source = _cost_source(left, right, config)
    decision = Decision(
        config.min_disparity,
        config.disp12_max_diff,
        config.uniqueness_ratio,
        config.subpixel,
        np.full((height, width), np.nan, np.float32),
        np.zeros((height, width), np.uint8),
    )
    levels = even_levels(left)
    penalties = _penalties(config)
    over_strips(
        lambda start, stop: match_strip(source, levels, penalties, decision, start, stop),
        height,
        strip=-(-height // (2 * -(-height // STRIP_PAIR))),
    )
    return decision.disparity, decision.validity


def _cost_source(left: FloatImage, right: FloatImage, config: MatchConfig) -> CostSource:
    size = config.correlation_window_size
    gain, right_gain = exposure_gain(left), exposure_gain(right)
    # the darker picture has less texture everywhere
    contrasts = min(right_gain / gain, 1.0), min(gain / right_gain, 1.0)
    big, steps = lay_out(left, right, config, size // 2, contrasts)
    small = big._replace(size=max(size - 2, 3), least_energy=(0.0, 0.0))
    noise = NOISE / gain * steps * small.size
    return CostSource(
        big,
        small,
        # a window of 3 has no smaller one inside
        noise**2 if size > small.size else np.inf,
        config.disparity_range,
        padded_range(config),
    )


def _penalties(config: MatchConfig) -> Penalties:
    # paths count in eighths of a cost, options in quarters
    P1, P2 = config.small_step_penalty // 2, config.large_step_penalty / 2
    step = np.maximum(np.arange(256) / GENTLE_STEP, 1)
    return Penalties(P1, np.maximum(P2 / step, P2 * LEAST_P2).astype(np.uint8))
