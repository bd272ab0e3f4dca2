# SPDX-License-Identifier: Apache-2.0
"""Measured and filled pixels apart: errors, flying pixels, and whether sigma covers the error."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from binocular_recon.evaluation.accuracy.metrics import Accuracy, accuracy
from binocular_recon.images import FloatImage, Mask, window_range

# Multiples of sigma, within which 68.3, 95.4 and 99.7 % of normally distributed errors lie.
SIGMAS = (1, 2, 3)
# A flying pixel is farther than this from each true surface within this reach.
FLYING_PX, FLYING_REACH_PX = 1.0, 3


@dataclass(frozen=True)
class Part:
    """The pixels of a disparity map that were measured, those that were filled, or all.

    Attributes
    ----------
    accuracy : Accuracy
        Errors of those with ground truth.
    flying_percent : float
        Share of flying pixels among those near ground truth; NaN if there is none.
    within_percent : tuple of float
        Share of errors within 1, 2, 3 sigma, mismatches included; NaN without sigma.

    """

    accuracy: Accuracy
    flying_percent: float
    within_percent: tuple[float, ...]


def parts(
    disparity_px: FloatImage,
    sigma_px: FloatImage | None,
    measured: Mask | None,
    truth_px: FloatImage,
) -> dict[str, Part]:
    """Return figures of ``all`` pixels, and of ``measured`` and ``filled`` ones if known.

    Parameters
    ----------
    disparity_px, truth_px : (H, W) float32
        Estimate and ground truth; NaN = unfilled, unknown.
    sigma_px : (H, W) float32 or None
        One standard deviation of the estimate.
    measured : (H, W) bool or None
        Pixels that were measured; the others with a disparity were filled.

    """
    found = np.isfinite(disparity_px)
    masks = {'all': np.ones(found.shape, bool)}
    if measured is not None:
        masks |= {'measured': measured & found, 'filled': ~measured & found}
    near, flying = flying_pixels(disparity_px, truth_px)
    return {
        name: Part(
            accuracy(disparity_px, truth_px, mask),
            _percent(flying[near & mask]),
            coverage(disparity_px, sigma_px, truth_px, mask),
        )
        for name, mask in masks.items()
    }


def flying_pixels(disparity_px: FloatImage, truth_px: FloatImage) -> tuple[Mask, Mask]:
    """Return which pixels can be judged, and which of them hang in the air between two surfaces.

    Parameters
    ----------
    disparity_px, truth_px : (H, W) float32
        Estimate and ground truth; NaN = unfilled, unknown.

    Returns
    -------
    near : (H, W) bool
        Pixels with a disparity and with ground truth within `FLYING_REACH_PX`.
    flying : (H, W) bool
        Those of them that lie between the nearest and the farthest of these true disparities,
        and farther than `FLYING_PX` from each.

    """
    side = 2 * FLYING_REACH_PX + 1
    smallest, largest = window_range(truth_px, side)
    near = np.isfinite(disparity_px) & (smallest <= largest)
    between = near & (disparity_px > smallest + FLYING_PX) & (disparity_px < largest - FLYING_PX)
    row, column = np.nonzero(between)
    padded = np.pad(truth_px, FLYING_REACH_PX, constant_values=np.nan)
    far = np.ones(len(row), bool)
    for j in range(side):
        for i in range(side):
            step = np.abs(padded[row + j, column + i] - disparity_px[row, column])
            far &= ~(step <= FLYING_PX)
    flying = np.zeros(near.shape, bool)
    flying[row, column] = far
    return near, flying


def coverage(
    disparity_px: FloatImage, sigma_px: FloatImage | None, truth_px: FloatImage, mask: Mask
) -> tuple[float, ...]:
    """Return the share of errors within each of `SIGMAS` times sigma, %, mismatches included."""
    if sigma_px is None:
        return (float('nan'),) * len(SIGMAS)
    ratio = np.abs(disparity_px.astype(np.float64) - truth_px) / sigma_px
    ratio = ratio[mask & np.isfinite(ratio)]
    return tuple(_percent(ratio <= limit) for limit in SIGMAS)


def _percent(hits: Mask) -> float:
    return 100.0 * float(hits.mean()) if hits.size else float('nan')
