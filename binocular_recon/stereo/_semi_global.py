# SPDX-License-Identifier: Apache-2.0
"""Semi-global matching: NCC costs, aggregated along paths, become disparities."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from binocular_recon._jit import over_strips
from binocular_recon.config import MatchConfig
from binocular_recon.stereo._aggregation_kernels import (
    Decision,
    Penalties,
    Volume,
    aggregate_rows,
    cost_strip,
    decide_rows,
    new_sweep,
)
from binocular_recon.stereo._layout import lay_out, padded_range

FloatImage = npt.NDArray[np.float32]

# Grey levels below are those of a left picture of this standard deviation, whatever the exposure.
CONTRAST = 50.0
# Standard deviation of the pictures' noise: texture below it tells little.
NOISE = 2.0
# P2 falls with the step of grey level that a change of disparity goes with: P2 up to
# `GENTLE_STEP`, then as 1 / step, down to `LEAST_P2` of it.
GENTLE_STEP = 16.0
LEAST_P2 = 1 / 3


def select_disparities(left: FloatImage, right: FloatImage, config: MatchConfig) -> FloatImage:
    """Match a checked pair.

    Returns
    -------
    disparity_px : (H, W) float32
        NaN = none.

    Notes
    -----
    H. Hirschmueller, "Stereo processing by semiglobal matching and mutual information", PAMI
    2008. The cost is 1 - NCC instead of mutual information, along four paths instead of eight:
    with this cost eight were no better.

    """
    height, width = left.shape
    padded = padded_range(config)
    size = config.correlation_window_size
    big, steps = lay_out(left, right, config, size // 2)
    small = big._replace(size=max(size - 2, 3), least_energy=0.0)
    # a window of 3 has no smaller one inside
    gain = _exposure_gain(left)
    noise = (NOISE / gain * steps * small.size) ** 2 if size > small.size else np.inf
    volume = Volume(
        np.empty(height * width * padded, np.uint8),
        np.zeros((height, width), np.bool_),
        padded,
        config.disparity_range,
    )
    over_strips(
        lambda start, stop: cost_strip(big, small, noise, volume, start, stop), height, strip=48
    )
    decision = Decision(
        config.min_disparity,
        config.disp12_max_diff,
        config.uniqueness_ratio,
        config.subpixel,
        np.full((height, width), np.nan, np.float32),
    )
    levels = np.nan_to_num(left * gain).clip(0, 255).astype(np.uint8)
    _sweep(volume, levels, _penalties(config), decision)
    return decision.disparity


def _exposure_gain(left: FloatImage) -> float:
    """Return the factor that brings a picture to `CONTRAST`."""
    known = left[np.isfinite(left)]
    deviation = float(known.std()) if known.size else 0.0
    return CONTRAST / deviation if deviation > 0 else 1.0


def _penalties(config: MatchConfig) -> Penalties:
    step = np.maximum(np.arange(256) / GENTLE_STEP, 1)
    return Penalties(
        config.P1, np.maximum(config.P2 / step, config.P2 * LEAST_P2).astype(np.uint8)
    )


def _sweep(
    volume: Volume, levels: npt.NDArray[np.uint8], penalties: Penalties, decision: Decision
) -> None:
    """Sweep from the top and from the bottom at the same time, to the middle and beyond."""
    height, width = levels.shape
    middle = height // 2
    halves = [(0, middle), (middle, height)]
    sweeps = [new_sweep(width, volume.padded, True), new_sweep(width, volume.padded, False)]
    partial = [
        np.empty((stop - start) * width * volume.padded, np.uint8) for start, stop in halves
    ]

    def to_the_middle(first: int, _stop: int) -> None:
        aggregate_rows(volume, levels, penalties, sweeps[first], partial[first], *halves[first])

    def beyond(first: int, _stop: int) -> None:
        other = 1 - first
        decide_rows(
            volume, levels, penalties, sweeps[first], partial[other], *halves[other], decision
        )

    over_strips(to_the_middle, 2, strip=1)
    over_strips(beyond, 2, strip=1)
