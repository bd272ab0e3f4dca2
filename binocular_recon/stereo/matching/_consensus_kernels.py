# SPDX-License-Identifier: Apache-2.0
"""Kernel that transfers disparities from the right image to the left one."""

from __future__ import annotations

import numpy as np

from binocular_recon._jit import Array, kernel


@kernel
def transfer_strip(
    disparity: Array, sigma: Array, left_disparity: Array, left_sigma: Array, start: int, stop: int
) -> None:
    """Write each disparity to the left pixel that it refers to; the nearest surface wins."""
    width = disparity.shape[1]
    for y in range(start, stop):
        left_disparity[y] = np.nan
        left_sigma[y] = np.nan
        for x in range(width):
            value = disparity[y, x]
            if np.isnan(value):
                continue
            column = x + int(np.rint(value))
            if 0 <= column < width and not left_disparity[y, column] >= value:
                left_disparity[y, column] = value
                left_sigma[y, column] = sigma[y, x]
