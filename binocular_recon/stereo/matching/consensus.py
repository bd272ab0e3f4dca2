# SPDX-License-Identifier: Apache-2.0
"""Consensus: several matches of an image pair vote on each pixel."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from binocular_recon._jit import over_strips
from binocular_recon.config import MatchConfig
from binocular_recon.images import FloatImage
from binocular_recon.stereo.matching._consensus_kernels import transfer_strip

# Matches agree if they are within this of their median.
AGREEMENT_PX = 0.5


def voter_configs(config: MatchConfig) -> list[MatchConfig]:
    """Return the options of the matches that vote: three windows of neighbouring sizes."""
    limits = next(
        spec.metadata
        for spec in dataclasses.fields(config)
        if spec.name == 'correlation_window_size'
    )
    size = config.correlation_window_size
    sizes = {max(size - 2, limits['minimum']), size, min(size + 2, limits['maximum'])}
    return [
        dataclasses.replace(config, correlation_window_size=voter, consensus=False)
        for voter in sorted(sizes)
    ]


def to_left_image(disparity_px: FloatImage, sigma_px: FloatImage) -> tuple[FloatImage, FloatImage]:
    """Transfer disparities from the pixels of the right image to those of the left one.

    Parameters
    ----------
    disparity_px, sigma_px : (H, W) float32
        Disparity x_left - x_right of the pixels of the right image, and its standard deviation;
        NaN = none.

    Returns
    -------
    disparity_px, sigma_px : (H, W) float32
        The same for the pixels of the left image; where several fall on one, that of the nearest
        surface. NaN where none does.

    """
    left = np.empty_like(disparity_px), np.empty_like(sigma_px)
    over_strips(transfer_strip, len(disparity_px), disparity_px, sigma_px, *left)
    return left


def vote(
    disparities_px: Sequence[FloatImage], sigmas_px: Sequence[FloatImage]
) -> tuple[FloatImage, FloatImage]:
    """Return the disparities on which at least half of the matches agree.

    Parameters
    ----------
    disparities_px, sigmas_px : sequence of (H, W) float32
        Disparity of each match and its standard deviation; NaN = none.

    Returns
    -------
    disparity_px : (H, W) float32
        Mean of those within `AGREEMENT_PX` of the median; NaN where these are fewer than half of
        all matches.
    sigma_px : (H, W) float32
        Root mean square of their standard deviations: the errors of the matches are correlated, so
        averaging does not reduce them. NaN = none.

    """
    disparity, sigma = np.empty_like(disparities_px[0]), np.empty_like(disparities_px[0])

    def vote_on_rows(start: int, stop: int) -> None:
        values = np.stack([image[start:stop] for image in disparities_px])
        variances = np.stack([image[start:stop] for image in sigmas_px]) ** 2
        accepted = np.abs(values - _median(values)) <= AGREEMENT_PX  # False for NaN
        votes = np.count_nonzero(accepted, axis=0)
        count = np.where(2 * votes >= len(values), votes, np.float32(np.nan))
        disparity[start:stop] = np.where(accepted, values, 0).sum(axis=0) / count
        sigma[start:stop] = np.sqrt(np.where(accepted, variances, 0).sum(axis=0) / count)

    over_strips(vote_on_rows, len(disparity))
    return disparity, sigma


def _median(values: FloatImage) -> FloatImage:
    """Return the median along the first axis without NaN; NaN where all are NaN."""
    ordered = np.sort(values, axis=0)  # NaN comes last
    last = np.maximum(np.count_nonzero(~np.isnan(values), axis=0) - 1, 0)
    low, high = (np.take_along_axis(ordered, at[None], 0) for at in (last // 2, -(-last // 2)))
    median: FloatImage = (low[0] + high[0]) / 2
    return median
