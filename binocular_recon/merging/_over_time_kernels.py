# SPDX-License-Identifier: Apache-2.0
"""Kernel of the robust average over time: the largest group of agreeing values of each pixel."""

from __future__ import annotations

import numpy as np

from binocular_recon._jit import Array, kernel

# Values within this many standard deviations of the mean of the group belong to it.
WITHIN = np.float32(3)
# Larger ones count as this: values of two surfaces do not agree, though both are uncertain, px.
LARGEST_PX = np.float32(0.5)


@kernel
def average_pixels(values: Array, sigmas: Array, found: Array, start: int, stop: int) -> None:
    """Average the values of the pixels ``start`` to ``stop`` over the frames.

    Parameters
    ----------
    values, sigmas : (n, P) float32
        Disparities of P pixels in n frames, and their standard deviations, px; NaN = none.
    found : (5, P) float32
        Takes, of the largest group of values that agree, the mean, the variance about it (0 for
        one value), the mean variance that was stated for them, and their number; then the number
        of all values. The first three are NaN where there is none.

    """
    frames = len(values)
    ordered, variances = np.empty(frames, np.float32), np.empty(frames, np.float32)
    for p in range(start, stop):
        count, total = 0, np.float32(0)
        for t in range(frames):
            value, sigma = values[t, p], sigmas[t, p]
            if np.isfinite(value) and sigma > 0:
                k = count  # insertion: frames of a still scene hardly differ
                while k > 0 and ordered[k - 1] > value:
                    ordered[k], variances[k] = ordered[k - 1], variances[k - 1]
                    k -= 1
                ordered[k], variances[k] = value, sigma * sigma
                count += 1
                total += min(sigma, LARGEST_PX)
        found[3, p], found[4, p] = 0, count
        if count == 0:
            found[:3, p] = np.nan
            continue
        # the window that holds most values; of equal ones the farthest: what moves is in front
        width = 2 * WITHIN * total / count
        first, most, end = 0, 0, 0
        for begin in range(count):
            while end < count and ordered[end] - ordered[begin] <= width:
                end += 1
            if end - begin > most:
                first, most = begin, end - begin
        middle = ordered[first + most // 2]
        agree, weights, sums = 0, np.float32(0), np.float32(0)
        for k in range(first, first + most):
            away = ordered[k] - middle
            if away * away <= WITHIN * WITHIN * min(variances[k], LARGEST_PX * LARGEST_PX):
                agree += 1
                weights += 1 / variances[k]
                sums += away / variances[k]
        found[3, p] = agree
        mean, squares = sums / weights, np.float32(0)
        for k in range(first, first + most):
            away = ordered[k] - middle
            if away * away <= WITHIN * WITHIN * min(variances[k], LARGEST_PX * LARGEST_PX):
                squares += (away - mean) * (away - mean) / variances[k]
        found[0, p] = middle + mean
        found[1, p] = squares / weights * agree / (agree - 1) if agree > 1 else 0
        found[2, p] = agree / weights
