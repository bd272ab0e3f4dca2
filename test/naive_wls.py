# SPDX-License-Identifier: Apache-2.0
"""Slow, obvious twin of the weighted least squares filter."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


def log_luminance(guide: npt.ArrayLike) -> Array:
    """Return ln(Y + 1/255) of a picture in grey levels of 255."""
    return np.log(np.asarray(guide, float) / 255 + 1 / 255)


def minimiser(
    data: Array, weight: Array, guide_log: Array, strength: float, alpha: float, epsilon: float
) -> Array:
    """Minimise eq. 11 by solving its normal equations with a dense matrix."""
    height, width = data.shape
    system = np.zeros((data.size, data.size))
    right_side = np.zeros(data.size)
    for y in range(height):
        for x in range(width):
            here = y * width + x
            if weight[y, x] > 0:
                system[here, here] += weight[y, x]
                right_side[here] += weight[y, x] * data[y, x]
            for other_y, other_x in ((y, x + 1), (y + 1, x)):
                if other_y < height and other_x < width:
                    there = other_y * width + other_x
                    step = abs(guide_log[y, x] - guide_log[other_y, other_x])
                    link = strength / (math.pow(step, alpha) + epsilon)
                    system[here, here] += link
                    system[there, there] += link
                    system[here, there] -= link
                    system[there, here] -= link
    return np.asarray(np.linalg.solve(system, right_side), np.float64).reshape(height, width)
