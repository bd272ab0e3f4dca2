# SPDX-License-Identifier: Apache-2.0
"""The last kernel of matching: disparities as they are handed on."""

from __future__ import annotations

import numpy as np

from binocular_recon._jit import Array, exact_kernel
from binocular_recon.stereo import _validity_kernels as reason


@exact_kernel
def finish_strip(
    measured: tuple[Array, Array, Array],
    step: float,
    unit: float,
    limits: tuple[float, float],
    confidence: Array,
    start: int,
    stop: int,
) -> None:
    """Round disparities to multiples of ``step``, drop those outside ``limits``, add confidence.

    ``measured`` (H, W): disparities, their standard deviations and validity, which follows what
    earlier steps added and dropped. ``confidence`` is `confidence_from_sigma`, with ``unit``.
    """
    low, high = np.float32(limits[0]), np.float32(limits[1])
    size, per_step, width = np.float32(step), np.float32(1 / step), np.float32(unit)
    one, zero, none = np.float32(1), np.float32(0), np.float32(np.nan)
    yes, doubtful = np.uint8(reason.MEASURED), np.uint8(reason.AMBIGUOUS)
    for y in range(start, stop):
        row, sigma = measured[0][y], measured[1][y]
        why, levels = measured[2][y], confidence[y]
        for x in range(row.size):
            value = np.rint(row[x] * per_step) * size
            ratio = sigma[x] / width
            level = one / (one + ratio * ratio)
            level = level if level == level else zero
            inside = (value >= low) & (value <= high)
            row[x] = value if inside else none
            levels[x] = level if inside else zero
            was = doubtful if why[x] & yes else why[x]
            why[x] = yes if inside else was
