# SPDX-License-Identifier: Apache-2.0
"""Kernels that search along lines for a wide rod's two sides and for further marks of a rod."""

from __future__ import annotations

import math

from binocular_recon._jit import inline_kernel, kernel
from binocular_recon.camera import FloatArray
from binocular_recon.images import FloatImage, Mask

# Step of the shifts of either end, as a share of the rod's half width; -4 .. 4 steps are tried.
SHIFT_STEP, SHIFTS = 0.18, 4
# Distance of the samples inside and outside a side, as a share of the half width.
OFF_SIDE = 0.35
# Least distance of a mark from the image border, px.
BORDER_PX = 1.0

# Agreement of a mark outside the image.
OUTSIDE = -9.0


@inline_kernel
def _level(image: FloatImage, x: float, y: int) -> float:
    """Return the mean level of three pixels of a row; at the border for one outside."""
    last = image.shape[1] - 2
    i = min(max(int(x + 0.5), 1), last)
    return float((image[y, i - 1] + image[y, i] + image[y, i + 1]) / 3)


@kernel
def centre_rod(
    image: FloatImage, rows: FloatArray, line: FloatArray, half_px: FloatArray, most: float
) -> None:
    """Shift both ends of a line sideways until it lies between two sides.

    A rod is uniform across and differs from what is beside it. The shift with the largest sum of
    contrasts over the rows is taken.

    Parameters
    ----------
    image : (H, W) float32
        Grey levels.
    rows : (n, k) float64
        y and z of the rows used; other columns are ignored.
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
                    inner = _level(image, x + side * (1 - OFF_SIDE) * half, y)
                    outer = _level(image, x + side * (1 + OFF_SIDE) * half, y)
                    total += min(abs(outer - inner), most) - min(abs(inner - middle), most)
            if total > best:
                best, best_low, best_high = total, low, high
    step = SHIFT_STEP * half_px[0]
    line[0] += 0.5 * step * (best_low + best_high)
    line[1] += 0.5 * step * (best_high - best_low)


@inline_kernel
def _agreement(
    middle: FloatImage, x: float, y: float, up: tuple[float, float], levels: FloatArray
) -> float:
    """Return how well the levels below and above x, y agree with ``levels`` (below, above).

    ``up`` reaches from the edge to the middle of the band above. ``OUTSIDE`` if x, y is outside.
    """
    height, width = middle.shape
    xa, ya = int(x + up[0] + 0.5), int(y + up[1] + 0.5)
    xb, yb = int(x - up[0] + 0.5), int(y - up[1] + 0.5)
    # next to the image border the bands are short
    ya, yb = max(ya, 0), min(yb, height - 1)
    if not (BORDER_PX <= y <= height - 1 - BORDER_PX and BORDER_PX <= x <= width - 1 - BORDER_PX):
        return OUTSIDE
    if xa < 0 or xa >= width or xb < 0 or xb >= width:
        return OUTSIDE
    off = abs(middle[yb, xb] - levels[0]) + abs(middle[ya, xa] - levels[1])
    return float(1.0 - off / abs(levels[1] - levels[0]))


@kernel
def search_line(
    middle: FloatImage,
    near: FloatImage,
    predicted: FloatArray,
    dark_below: Mask,
    window: FloatArray,
    levels: FloatArray,
    rises: FloatArray,
    points: FloatArray,
    agreement: FloatArray,
) -> None:
    """Shift a whole rod sideways at both ends and along until its marks agree best.

    Parameters
    ----------
    middle, near : (H, W) float32
        Image averaged over the rod's width, and over a few rows only.
    predicted : (M, 2) float64
        Where the marks should be, px.
    dark_below : (M,) bool
        Which marks have a dark band below and a light one above.
    window : (4,) float64
        Largest shift sideways and along, and the steps sideways and along, px.
    levels : (2,) float64
        Grey levels of dark and light bands.
    rises : (2,) float64
        Distance from an edge at which levels of ``middle`` and ``near`` are compared, px.
    points, agreement : (M, 2), (M,) float64
        Written: the marks' positions and how well their levels agree.

    """
    count = predicted.shape[0]
    dx, dy = predicted[-1, 0] - predicted[0, 0], predicted[-1, 1] - predicted[0, 1]
    length = math.sqrt(dx * dx + dy * dy)
    dx, dy = dx / length, dy / length
    step, rise = window[2], rises[0]
    sides, alongs = math.ceil(window[0] / step), math.ceil(window[1] / window[3])
    best = -1e9
    best_low = best_high = best_along = 0.0
    flipped = levels[::-1].copy()
    for low in range(-sides, sides + 1):
        for high in range(-sides, sides + 1):
            for shift in range(-alongs, alongs + 1):
                along = shift * window[3]
                total = 0.0
                for m in range(count):
                    f = m / (count - 1)
                    side = step * (low + f * (high - low))
                    x = predicted[m, 0] - side * dy + along * dx
                    y = predicted[m, 1] + side * dx + along * dy
                    value = _agreement(
                        middle, x, y, (rise * dx, rise * dy), levels if dark_below[m] else flipped
                    )
                    # marks outside the image count neither way
                    if value != OUTSIDE:
                        total += max(-0.5, value)
                # equal scores: the smaller shift
                total -= 1e-3 * (abs(low) + abs(high) + abs(shift))
                if total > best:
                    best, best_low, best_high, best_along = total, low, high, along
    for m in range(count):
        f = m / (count - 1)
        side = step * (best_low + f * (best_high - best_low))
        # each mark may still be a little off
        agreement[m] = OUTSIDE
        expected = levels if dark_below[m] else flipped
        for extra in range(-2, 3):
            along = best_along + extra
            x = predicted[m, 0] - side * dy + along * dx
            y = predicted[m, 1] + side * dx + along * dy
            value = max(
                _agreement(middle, x, y, (rise * dx, rise * dy), expected),
                _agreement(near, x, y, (rises[1] * dx, rises[1] * dy), expected),
            )
            if value > agreement[m]:
                agreement[m], points[m, 0], points[m, 1] = value, x, y
