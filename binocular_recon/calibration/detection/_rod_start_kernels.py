# SPDX-License-Identifier: Apache-2.0
"""Kernel that brings a wide rod's rough line between its sides, for the fit to start from."""

from __future__ import annotations

from binocular_recon._jit import kernel
from binocular_recon.camera import FloatArray
from binocular_recon.images import FloatImage

# Shifts of either end that are tried, as shares of the rod's half width: -4 .. 4 of these steps.
SHIFT_STEP, SHIFTS = 0.18, 4
# How far within and beyond a side its levels are taken, as a share of the half width.
WITHIN = 0.35


@kernel
def _level(image: FloatImage, x: float, y: int) -> float:
    """Return the mean level of three pixels of a row; the frame's where it is outside."""
    last = image.shape[1] - 2
    i = min(max(int(x + 0.5), 1), last)
    return float((image[y, i - 1] + image[y, i] + image[y, i + 1]) / 3)


@kernel
def centre_rod(
    image: FloatImage, rows: FloatArray, line: FloatArray, half_px: FloatArray, most: float
) -> None:
    """Shift both ends of a line sideways until it lies between two sides.

    A rod is even across and differs from what is beside it; the shift with the largest sum over
    the rows is taken.

    Parameters
    ----------
    image : (H, W) float32
        Grey levels.
    rows : (n, k) float64
        y and z of the rows to look at, then anything.
    line : (2,) float64
        Middle at z = 0 and its slope by z; changed in place.
    half_px : (2,) float64
        Half the rod's width along a row at z = 0 and its slope by z.
    most : float
        Largest contrast that counts, grey levels.

    """
    best, best_low, best_high = -1e18, 0, 0
    for low in range(-SHIFTS, SHIFTS + 1):
        for high in range(-SHIFTS, SHIFTS + 1):
            # equal sums: the smaller shift
            total = -1e-6 * (low * low + high * high)
            for r in range(rows.shape[0]):
                y, z = int(rows[r, 0]), rows[r, 1]
                half = half_px[0] + z * half_px[1]
                shift = 0.5 * (low + high) + 0.5 * (high - low) * z
                x = line[0] + z * line[1] + SHIFT_STEP * half_px[0] * shift
                middle = _level(image, x, y)
                for side in (-1, 1):
                    inner = _level(image, x + side * (1 - WITHIN) * half, y)
                    outer = _level(image, x + side * (1 + WITHIN) * half, y)
                    total += min(abs(outer - inner), most) - min(abs(inner - middle), most)
            if total > best:
                best, best_low, best_high = total, low, high
    step = SHIFT_STEP * half_px[0]
    line[0] += 0.5 * step * (best_low + best_high)
    line[1] += 0.5 * step * (best_high - best_low)
