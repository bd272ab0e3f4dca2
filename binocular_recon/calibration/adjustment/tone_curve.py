# SPDX-License-Identifier: Apache-2.0
"""Edges that a tone curve shifts: from dark to light one way, from light to dark the other way.

A camera that encodes its levels (gamma) or clips its highlights moves the middle grey of a blurred
edge towards one side. Along a rod the marks then alternate by the same number of pixels at every
distance. Bands that are painted too long alternate by the same number of millimetres instead.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from binocular_recon.calibration.adjustment.estimation import Estimate
from binocular_recon.calibration.adjustment.linearisation import predict
from binocular_recon.camera import FloatArray
from binocular_recon.images import Mask

# An alternation is pointed out from here on, px and standard deviations.
LEAST_PX, LEAST_SIGMAS = 0.05, 5.0
# Of pixels and millimetres, the one that fits better by this much (chi-square) is the cause.
CLEAR_MARGIN = 10.0


@dataclass(frozen=True, eq=False)
class ToneCurve:
    """How far edges are shifted along the rods.

    Attributes
    ----------
    shift_px : (2,) float64
        By how much the first, third, ... mark of a rod is shifted upwards in the left and the
        right image, and the others downwards, px.
    cause : str
        ``tone`` if the shift is the same in pixels at all distances, ``bands`` if it is the same
        in millimetres, ``either`` if the boards do not tell, '' if there is no shift.

    """

    shift_px: FloatArray
    cause: str = ''

    @property
    def warning(self) -> str:
        """What the user should know, '' if there is nothing."""
        shifts = ' and '.join(
            f'{abs(shift):.2f} px in the {side} image'
            for shift, side in zip(self.shift_px, ('left', 'right'), strict=True)
        )
        what = (
            f'edges from dark to light and from light to dark are shifted oppositely, by {shifts}'
        )
        if self.cause == 'tone':
            return (
                f'{what}, alike at all distances: the images have a tone curve (gamma) or'
                ' overexposed bands; this was taken out of the marks, rods.yaml is not to blame;'
                ' set gamma to 1 and expose less'
            )
        if self.cause == 'either':
            return (
                f'{what}: the images have a tone curve (gamma), or all dark bands differ in length'
                ' from the light ones; set gamma to 1, or capture boards nearer and farther away'
                ' to tell which, before you correct rods.yaml'
            )
        return ''

    def corrected(self, observed_px: FloatArray) -> FloatArray:
        """Return marks (B, R, M, 4) px without the shift."""
        up, _ = _along(observed_px)
        signs = _signs(observed_px.shape[2])[:, None, None]
        # a rod with one mark has no direction; that mark stays
        moved = signs * self.shift_px[:, None] * np.nan_to_num(up)[:, :, None]
        corrected: FloatArray = observed_px - moved.reshape(observed_px.shape)
        return corrected


NO_SHIFT = ToneCurve(np.zeros(2))


def find_tone_curve(found: Estimate) -> ToneCurve:
    """Look for edges that are shifted alternately in a finished adjustment."""
    problem = found.problem
    if not problem.target.has_rods or len(problem.target.heights_m) < 3:
        return NO_SHIFT
    observed = problem.observed_px
    up, length_px = _along(observed)
    heights = problem.target.heights_m
    residuals = (observed - predict(found.state, problem.target)).reshape(
        *observed.shape[:-1], 2, 2
    )
    along = np.sum(residuals * up[:, :, None], axis=-1)  # (B, R, M, 2)
    signs = _signs(len(heights))
    # what the place of a rod and the distance of its board take up is not seen in the residuals
    line = np.stack([np.ones_like(heights), heights - heights.mean()], axis=-1)
    shifts, squares, chi_m, chi_px = np.zeros(2), np.zeros(2), 0.0, 0.0
    for side in range(2):
        values, pixels, metres = [], [], []
        for board in range(len(observed)):
            for rod in range(observed.shape[1]):
                seen = np.isfinite(along[board, rod, :, side])
                if seen.sum() < 3:
                    continue
                pattern = signs[seen]
                pattern = (
                    pattern - line[seen] @ np.linalg.lstsq(line[seen], pattern, rcond=None)[0]
                )
                values.append(along[board, rod, seen, side])
                pixels.append(pattern)
                metres.append(pattern * length_px[board, rod, side])
        if not values:
            continue
        value, pixel, metre = (np.concatenate(parts) for parts in (values, pixels, metres))
        shifts[side] = pixel @ value / (pixel @ pixel)
        off = value - shifts[side] * pixel
        variance = float(off @ off) / max(len(value) - 1, 1)
        squares[side] = variance / (pixel @ pixel)
        chi_px += float(off @ off) / variance
        off = value - metre @ value / (metre @ metre) * metre
        chi_m += float(off @ off) / variance
    certain = np.abs(shifts) > np.maximum(LEAST_PX, LEAST_SIGMAS * np.sqrt(squares))
    if not certain.any():
        return NO_SHIFT
    if abs(chi_m - chi_px) < CLEAR_MARGIN:
        return ToneCurve(shifts, 'either')
    return ToneCurve(shifts, 'tone' if chi_px < chi_m else 'bands')


def _signs(marks: int) -> FloatArray:
    """Return 1 and -1 in turn, (M,): neighbouring edges change in opposite directions."""
    signs: FloatArray = np.where(np.arange(marks) % 2, -1.0, 1.0)
    return signs


def _along(observed_px: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the upward direction of each rod in each image and its length between marks.

    Returns
    -------
    (B, R, 2, 2) float64
        Unit vector of each rod in the left and the right image; NaN with fewer than two marks.
    (B, R, 2) float64
        Mean distance of neighbouring marks, px.

    """
    marks = observed_px.reshape(*observed_px.shape[:-1], 2, 2)
    seen: Mask = np.all(np.isfinite(marks), axis=-1)
    first = np.argmax(seen, axis=2)
    last = marks.shape[2] - 1 - np.argmax(seen[:, :, ::-1], axis=2)
    ends = [
        np.take_along_axis(marks, end[:, :, None, :, None], axis=2)[:, :, 0]
        for end in (first, last)
    ]
    rods = ends[1] - ends[0]
    length = np.linalg.norm(rods, axis=-1)
    length = np.where(last > first, length, np.nan)
    return rods / length[..., None], length / np.maximum(last - first, 1)
