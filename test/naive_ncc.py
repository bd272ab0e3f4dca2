# SPDX-License-Identifier: Apache-2.0
"""Slow, obvious twin of the NCC scores and of winner takes all."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


def ncc(
    left: npt.ArrayLike,
    right: npt.ArrayLike,
    size: int,
    min_disparity: int,
    disparity_range: int,
    texture_threshold: float,
) -> Array:
    """Return eq. 10 for every pixel and disparity, (H, W, D); NaN = no score."""
    left, right = np.asarray(left, float), np.asarray(right, float)
    height, width = left.shape
    radius = size // 2
    scores = np.full((height, width, disparity_range), np.nan)
    for y in range(radius, height - radius):
        rows = slice(y - radius, y + radius + 1)
        for x in range(radius, width - radius):
            a = left[rows, x - radius : x + radius + 1]
            for k in range(disparity_range):
                centre = x - min_disparity - k
                if radius <= centre < width - radius:
                    b = right[rows, centre - radius : centre + radius + 1]
                    scores[y, x, k] = _correlation(a, b, texture_threshold)
    return scores


def _correlation(a: Array, b: Array, texture_threshold: float) -> float:
    if not (np.isfinite(a).all() and np.isfinite(b).all()):
        return np.nan
    if min(np.ptp(a), np.ptp(b)) == 0 or min(a.std(), b.std()) < texture_threshold:
        return np.nan
    return float(((a - a.mean()) * (b - b.mean())).mean() / (a.std() * b.std()))


def winners(scores: Array) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Return the index of the best score of each left pixel, and of each right pixel; -1 = none.

    A right pixel x' competes for the left pixels x' + k (for a search that starts at 0).
    """
    height, width, disparity_range = scores.shape
    known = np.where(np.isnan(scores), -np.inf, scores)
    left = np.where(np.isfinite(known.max(axis=2)), known.argmax(axis=2), -1)
    right = np.full((height, width), -1)
    for y in range(height):
        for x in range(width):
            curve = [
                known[y, x + k, k] if x + k < width else -np.inf for k in range(disparity_range)
            ]
            if max(curve) > -np.inf:
                right[y, x] = int(np.argmax(curve))
    return left, right
