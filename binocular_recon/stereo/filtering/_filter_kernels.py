# SPDX-License-Identifier: Apache-2.0
"""Kernels of the filter around its solver: links, and the standard deviation of each pixel."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from binocular_recon._jit import Array, inline_kernel, kernel
from binocular_recon.stereo.filtering._lattice_kernels import ZERO

REACH = 3  # radius of the window in which the scatter of the data is taken, px
# Where matches scatter by more, more of them are wrong altogether: 1 % at 0.25 px, 10 % at 0.5 px.
# The factor on the cube of the variance, 1/px^4, that accounts for these.
MISMATCHED = np.float32(1 / 0.45**4)
# Where the solution bends by more than noise explains, over this many pixels to either side, there
# is a step, and a match may belong to its other side. The standard deviation that accounts for it
# is half of the bend, of which no more counts than the last, px: all points near large steps would
# be left out of clouds, and most of them are right.
BEND_REACHES = (2, 4)
BEND_NOISE = np.float32(3.0**2)  # the largest bend squared that noise explains, in variances
BEND_SHARE, MOST_BEND = np.float32(0.5**2), np.float32(4.0)
_WHOLE = np.float32(1e-3)
# Least difference of two pixels, in place of 0, of which OpenCV's power takes ten times as long.
LEAST_DIFFERENCE = np.float32(1e-30)


class SigmaTerms(NamedTuple):
    """The terms of the variance of a pixel; images are (H, W) float32.

    Attributes
    ----------
    measured, filtered : disparity, px; NaN = none in the first.
    confidence : of matches, above 0.
    unit, least : variance of a match with confidence 1/2, and the part common to all pixels.
    rounding : lower limit of the variance of the scatter.
    holes : variance of pixels without a match.

    """

    measured: Array
    filtered: Array
    confidence: Array
    unit: float
    least: float
    rounding: float
    holes: Array


@kernel
def all_whole(values: Array) -> bool:
    """Return whether all values are NaN or whole numbers, to the rounding of float32."""
    for y in range(values.shape[0]):
        for value in values[y]:
            if abs(value - np.rint(value)) > _WHOLE:
                return False
    return True


@kernel
def keep_measured(
    disparity: Array,
    confidence: Array,
    limits: tuple[float, float],
    measured: Array,
    counts: Array,
    start: int,
    stop: int,
) -> None:
    """Copy disparities within limits that have a confidence, NaN for others; count them by row."""
    low, high = limits
    for y in range(start, stop):
        count = 0
        for x in range(disparity.shape[1]):
            value = disparity[y, x]
            # comparisons with NaN are false
            valid = (value >= low) & (value <= high) & (confidence[y, x] > 0)
            measured[y, x] = value if valid else np.float32(np.nan)
            count += valid
        counts[y] = count


@inline_kernel
def _absolute_difference(one: Array, other: Array, out: Array) -> None:
    for i in range(len(out)):
        difference = abs(one[i] - other[i])
        out[i] = max(LEAST_DIFFERENCE, difference)  # also if NaN


@kernel
def absolute_differences(values: Array, east: Array, south: Array, start: int, stop: int) -> None:
    """Write the absolute differences from the east and the south neighbour.

    They are at least `LEAST_DIFFERENCE`, which stands for 0, and that where a value is NaN.
    """
    for y in range(start, stop):
        _absolute_difference(values[y - start, 1:], values[y - start, :-1], east[y])
        if y < len(south):
            _absolute_difference(values[y - start + 1], values[y - start], south[y])


@inline_kernel
def _gradient_to_link(
    one: Array, other: Array, link: Array, options: tuple[float, float, float, float]
) -> None:
    factor, kappa, least = np.float32(options[0]), np.float32(options[1]), np.float32(options[2])
    flat = np.float32(options[3])
    for i in range(len(link)):
        step, gradient = one[i] - other[i], ZERO if link[i] <= flat else link[i]
        link[i] = factor / (gradient + kappa * step * step + least)


@kernel
def gradients_to_links(
    data: Array,
    east: Array,
    south: Array,
    options: tuple[float, float, float, float],
    start: int,
    stop: int,
) -> None:
    """Replace gradient terms by links: ``lambda / (gradient + kappa step^2 + epsilon)``.

    ``options`` are lambda, kappa, epsilon and the gradient up to which there is none; a step is
    that of ``data`` between two neighbours.
    """
    for y in range(start, stop):
        _gradient_to_link(data[y, 1:], data[y, :-1], east[y], options)
        if y < len(south):
            _gradient_to_link(data[y + 1], data[y], south[y], options)


@inline_kernel
def _add(out: Array, values: Array) -> None:
    for i in range(len(out)):
        out[i] += values[i]


@inline_kernel
def _add_squares(measured: Array, filtered: Array, square: Array, count: Array) -> None:
    for i in range(len(measured)):
        difference = measured[i] - filtered[i]
        valid = not np.isnan(difference)
        square[i] += difference * difference if valid else ZERO
        count[i] += np.float32(1) if valid else ZERO


@inline_kernel
def _sum_along_row(padded: Array, out: Array) -> None:
    out[:] = ZERO
    for shift in range(2 * REACH + 1):
        _add(out, padded[shift : shift + len(out)])


@inline_kernel
def _enlarge(bends: Array, before: Array, middle: Array, after: Array) -> None:
    for x in range(len(bends)):
        bends[x] = max(bends[x], abs(before[x] + after[x] - middle[x] - middle[x]))


@inline_kernel
def _find_bends(filtered: Array, y: int, bends: Array) -> None:
    """Write by how much each pixel of a row is off the middle of two others, times two.

    The largest value along the row and the column; it is 0 on planes.
    """
    height, width = filtered.shape
    row = filtered[y]
    bends[:] = ZERO
    for reach in BEND_REACHES:
        if width > 2 * reach:
            inside = slice(reach, width - reach)
            _enlarge(bends[inside], row[: width - 2 * reach], row[inside], row[2 * reach :])
        if reach <= y < height - reach:
            _enlarge(bends, filtered[y - reach], row, filtered[y + reach])


@inline_kernel
def _set_sigma(
    terms: SigmaTerms, y: int, squares: Array, counts: Array, bends: Array, out: Array
) -> None:
    measured, level, hole = terms.measured[y], terms.confidence[y], terms.holes[y]
    one, unit, least = np.float32(1), np.float32(terms.unit), np.float32(terms.least)
    rounding = np.float32(terms.rounding)
    for x in range(len(out)):
        # the inverse of confidence_from_sigma
        matched = unit * (one / min(level[x], one) - one)
        variance = least + (hole[x] if np.isnan(measured[x]) else matched)
        variance += max(squares[x] / max(counts[x], one), rounding)
        matched = variance + MISMATCHED * variance * variance * variance
        bend = min(bends[x], MOST_BEND)
        matched += BEND_SHARE * max(bend * bend - BEND_NOISE * matched, ZERO)
        out[x] = np.sqrt(variance if np.isnan(measured[x]) else matched)


@kernel
def standard_deviation(terms: SigmaTerms, sigma: Array, start: int, stop: int) -> None:
    """Write the standard deviation of each pixel.

    It is the root of the sum of a constant, the variance of the match or of the hole, the scatter
    of the data around the solution, and for matches the shares of mismatches and of steps nearby.
    """
    measured, filtered = terms.measured, terms.filtered
    height, width = measured.shape
    columns = np.zeros((2, width + 2 * REACH), np.float32)
    squares, counts = np.empty(width, np.float32), np.empty(width, np.float32)
    bends = np.empty(width, np.float32)
    for y in range(start, stop):
        columns[:] = ZERO
        for near in range(max(0, y - REACH), min(height, y + REACH + 1)):
            inside = slice(REACH, REACH + width)
            _add_squares(measured[near], filtered[near], columns[0, inside], columns[1, inside])
        _sum_along_row(columns[0], squares)
        _sum_along_row(columns[1], counts)
        _find_bends(filtered, y, bends)
        _set_sigma(terms, y, squares, counts, bends, sigma[y])
