# SPDX-License-Identifier: Apache-2.0
"""From a picked pixel to a point: the surface around the pixel, fitted robustly."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from binocular_recon.camera import FloatArray
from binocular_recon.errors import MeasurementError
from binocular_recon.measurement.frame import MeasuredFrame
from binocular_recon.measurement.picks import Pick
from binocular_recon.measurement.robust_fits import refined_fit
from binocular_recon.measurement.uncertain import Uncertain
from binocular_recon.number_text import significant
from binocular_recon.stereo.filtering.wls_filter import sigma_if_right
from binocular_recon.stereo.row_check import MOST_ROWS_PX
from binocular_recon.stereo.validity import Validity

# One standard deviation of a pick by hand on each axis, px.
PICK_SIGMA_PX = 0.3
# Half the side of the window around a pick, and the standard deviation of its weights, px.
HALF_PX, WEIGHT_PX = 3, 1.5
# Where less of the window was measured, by weight, is a hole: what matched there is often wrong.
LEAST_MEASURED = 0.5
# A surface has at least so many pixels.
LEAST_PIXELS = 6
# Disparities that differ by more from the next are of another surface, px.
STEP_PX = 1.0
# The nearest surface with this share of the weight is meant: people measure things, not what
# shows beside them.
LEAST_SHARE = 0.35
# A point agrees with the surface within about this, px of disparity.
SCATTER_PX = 0.3
# Half the side of the surroundings that a surface should go on into, px; disparities that differ
# by more from it are of another thing; about how far the others scatter, px of disparity.
AROUND_PX, OTHER_THING_PX, AROUND_SCATTER_PX = 10, 3.0, 0.5
# The rows of picks in both images agree within this.
MOST_PICKED_ROWS_PX = 2 * MOST_ROWS_PX
_REASONS = (
    (Validity.NO_DATA, 'one image has no data there'),
    (Validity.LOW_TEXTURE, 'there is too little texture'),
    (Validity.AT_LIMIT, 'it is at the limit of the search range'),
    (Validity.AMBIGUOUS, 'the match is ambiguous'),
    (Validity.CONFLICT, 'the two images contradict each other'),
)


class Surface(NamedTuple):
    """The surface that a pixel sees: disparity there, its slope (2,) px/px and its sigma, px."""

    disparity_px: float
    slope: FloatArray
    sigma_px: float


def locate(frame: MeasuredFrame, pick: Pick, pick_sigma_px: float = PICK_SIGMA_PX) -> Uncertain:
    """Return the point that a pick shows.

    Parameters
    ----------
    frame : MeasuredFrame
    pick : Pick
        With a pixel in the right image the two give the point, else the cloud around the pixel.
    pick_sigma_px : float
        One standard deviation of picks, on each axis.

    Returns
    -------
    Uncertain
        Point in the left rectified frame, (3,) m, with the effects of the pick, of matching and,
        where its covariance is known, of the calibration.

    Raises
    ------
    MeasurementError
        If the pixel is outside the image or on a hole, or the two picks contradict each other.

    """
    check_inside(frame, pick, pick.pixel, 'left')
    if pick.right is not None:
        return _intersection(frame, pick, pick.right, pick_sigma_px)
    surface = surface_at(frame, pick)

    def point(step: FloatArray, error_px: float = 0.0) -> FloatArray:
        disparity = surface.disparity_px + surface.slope @ step + error_px
        return frame.point(pick.pixel + step, disparity)

    here = point(np.zeros(2))
    per_pixel = [(point(step) - point(-step)) / 2 for step in np.eye(2)]
    per_error = (point(np.zeros(2), 0.01) - point(np.zeros(2), -0.01)) / 0.02
    effects = {
        ('pick', pick.name): pick_sigma_px * np.stack(per_pixel, axis=-1),
        ('matching', pick.name): surface.sigma_px * per_error[:, None],
    }
    return frame.calibrated(Uncertain(here, effects))


def window_around(pixel: FloatArray, half_px: int) -> tuple[slice, slice]:
    """Return the rows and columns within ``half_px`` of a pixel."""
    x, y = np.rint(pixel).astype(int)
    rows, columns = (slice(max(0, at - half_px), at + half_px + 1) for at in (y, x))
    return rows, columns


def surface_at(frame: MeasuredFrame, pick: Pick) -> Surface:
    """Return the surface around a pick; raises a MeasurementError where nothing was measured."""
    window = rows, columns = window_around(pick.pixel, HALF_PX)
    used = frame.measured[window]
    down, across = np.nonzero(np.ones_like(used))
    offsets = np.column_stack([across + columns.start, down + rows.start]) - pick.pixel
    weight = np.exp(-0.5 * np.sum(offsets**2, axis=1) / WEIGHT_PX**2)
    measured = used.ravel()
    if weight[measured].sum() < LEAST_MEASURED * weight.sum() or measured.sum() < LEAST_PIXELS:
        raise MeasurementError(_hole(pick, frame, window))
    offsets, weight = offsets[measured], weight[measured]
    disparity = frame.disparity_px[window][used].astype(np.float64)
    sigma = frame.sigma_px[window][used].astype(np.float64)
    order = np.argsort(-disparity)
    steps = np.flatnonzero(-np.diff(disparity[order]) > STEP_PX) + 1
    groups = [one for one in np.split(order, steps) if len(one) >= LEAST_PIXELS // 2]
    heavy = [one for one in groups if weight[one].sum() > LEAST_SHARE * weight.sum()]
    if not heavy:
        raise MeasurementError(
            f'pick {pick.name} at ({_px(pick.pixel)}) of frame {frame.name} is on no surface: the'
            f' disparities around it range from {disparity.min():.1f} to {disparity.max():.1f} px;'
            ' pick a pixel away from the outline, or give u_right and v_right too'
        )
    chosen = heavy[0]
    offsets, disparity, sigma, weight = (
        values[chosen] for values in (offsets, disparity, sigma, weight)
    )
    design = np.column_stack([np.ones(len(offsets)), offsets])
    plane = np.zeros(3)
    plane[0] = np.average(disparity, weights=weight)
    if np.linalg.matrix_rank(design * weight[:, None]) == 3 and len(chosen) > LEAST_PIXELS:
        root = np.sqrt(weight)
        start = np.linalg.lstsq(design * root[:, None], disparity * root, rcond=None)[0]
        plane = refined_fit(design, disparity, weight, SCATTER_PX, start)
    # odd pixels count as little here as in the plane: what they are off is not its error
    off = disparity - design @ plane
    misfit = np.sqrt(np.average(off**2, weights=weight / (1 + (off / SCATTER_PX) ** 2) ** 2))
    # Windows of matching overlap: errors of the pixels are common to them, and do not average out.
    # But these pixels agree, so that they are not wrong altogether.
    own_px = np.hypot(np.average(sigma_if_right(sigma), weights=weight), misfit)
    surface = Surface(float(plane[0]), plane[1:], float(own_px))
    error_px = np.hypot(own_px, _off_around(frame, pick, surface))
    return surface._replace(sigma_px=float(error_px))


def _off_around(frame: MeasuredFrame, pick: Pick, surface: Surface) -> float:
    """Return how far a surface is off the plane of its surroundings at the pick, px of disparity.

    Wrong matches of neighbours agree with each other, but where they end is a step. What differs
    so much that it is another thing says nothing about this one.
    """
    rows, columns = window_around(pick.pixel, AROUND_PX)
    down, across = np.nonzero(frame.measured[rows, columns])
    disparity = frame.disparity_px[rows, columns][down, across].astype(np.float64)
    offsets = np.column_stack([across + columns.start, down + rows.start]) - pick.pixel
    design = np.column_stack([np.ones(len(offsets)), offsets])
    off = disparity - design @ [surface.disparity_px, *surface.slope]
    near = np.abs(off) < OTHER_THING_PX
    if np.linalg.matrix_rank(design[near]) < 3:
        return 0.0
    start = np.linalg.lstsq(design[near], off[near], rcond=None)[0]
    around = refined_fit(design, off, np.ones(len(off)), AROUND_SCATTER_PX, start)
    return float(around[0])


def _intersection(
    frame: MeasuredFrame, pick: Pick, right: FloatArray, pick_sigma_px: float
) -> Uncertain:
    """Return the point of a pick in both images."""
    check_inside(frame, pick, right, 'right')
    if frame.rig.turns:
        raise MeasurementError(
            f'pick {pick.name}: picks in both images need cameras side by side; pick in the left'
            ' image only'
        )
    # P of the right camera has the same row of the principal point, or rows would not correspond
    rows_px = float(pick.pixel[1] - right[1])
    limit_px = max(MOST_PICKED_ROWS_PX, 4 * pick_sigma_px)
    if abs(rows_px) > limit_px:
        raise MeasurementError(
            f'pick {pick.name}: the rows of the two pixels differ by {rows_px:.1f} px, at most'
            f' {limit_px:.1f}; pick the same point in both rectified images'
        )
    disparity = float(pick.pixel[0] - right[0])
    if disparity <= frame.rig.disparity_offset_px:
        raise MeasurementError(
            f'pick {pick.name}: its disparity of {disparity:.1f} px means no point before the'
            ' cameras; check that left and right are not exchanged'
        )

    def point(step: FloatArray) -> FloatArray:
        return frame.point(pick.pixel + step[:2], np.asarray(disparity + step[0] - step[2]))

    steps = [(point(step) - point(-step)) / 2 for step in np.eye(3) * 0.1]
    effect = 10 * pick_sigma_px * np.stack(steps, axis=-1)
    return frame.calibrated(Uncertain(point(np.zeros(3)), {('pick', pick.name): effect}))


def check_inside(frame: MeasuredFrame, pick: Pick, pixel: FloatArray, side: str) -> None:
    """Raise a MeasurementError unless a pixel lies inside the image."""
    width, height = frame.size
    if not (0 <= pixel[0] <= width - 1 and 0 <= pixel[1] <= height - 1):
        raise MeasurementError(
            f'pick {pick.name} at ({_px(pixel)}) is outside of the {side} image of'
            f' {width}x{height} px; give column and row of the rectified {side} image'
        )


def _hole(pick: Pick, frame: MeasuredFrame, window: tuple[slice, slice]) -> str:
    bits = frame.validity[window]
    counts = {text: int(np.count_nonzero(bits & bit)) for bit, text in _REASONS}
    reason = max(counts, key=lambda text: counts[text])
    why = f': {reason}' if counts[reason] else ''
    return (
        f'pick {pick.name} at ({_px(pick.pixel)}) of frame {frame.name} is on a hole: only'
        f' {np.count_nonzero(frame.measured[window])} of {bits.size} pixels around it were'
        f' measured{why}; pick a pixel that was measured, or give u_right and v_right too'
    )


def _px(pixel: FloatArray) -> str:
    return ', '.join(significant(value, 5) for value in pixel.tolist())
