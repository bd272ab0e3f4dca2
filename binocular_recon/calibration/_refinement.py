# SPDX-License-Identifier: Apache-2.0
"""Measure the marks of a board below a pixel and reject those that contradict the rest."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from binocular_recon.calibration._rod_fit import (
    USUAL_BLUR_PX,
    BorderFit,
    RodFit,
    fit_border,
    fit_rod,
)
from binocular_recon.calibration.rods import RodBoard
from binocular_recon.camera import FloatArray

FloatImage = npt.NDArray[np.float32]

# How far along the rod a border's fit looks: shares of the rod's width and of the spacing, px.
REACH_WIDTHS, REACH_SPACING, LEAST_REACH_PX = 1.2, 0.45, 3.5
# With something in front of the rod nearby it looks only this far, px.
SHORT_REACH_PX = 2.5
# Largest root mean square residual of a border, as a share of its step.
LARGEST_RESIDUAL = 0.12
# A border's step against the typical one of the board.
LEAST_STEP, LARGEST_STEP = 0.4, 2.0
# Marks of one rod fit their exact spacing to this, px, and to this share of the rod's length
# (distortion).
STRAY_PX, STRAY_LENGTH = 0.4, 0.002


class Refined(NamedTuple):
    """Marks below a pixel: positions (R, M, 2) and standard deviations (R, M), NaN = rejected."""

    marks_px: FloatArray
    sigma_px: FloatArray


def refine(
    image: FloatImage,
    board: RodBoard,
    marks_px: FloatArray,
    predicted_px: FloatArray,
) -> Refined:
    """Measure the marks found.

    Parameters
    ----------
    image : (H, W) float32
        Grey levels.
    board : RodBoard
        Heights of the marks.
    marks_px, predicted_px : (R, M, 2) float64
        Rough positions of the marks found, and where every mark should be; NaN = none.

    """
    rods = [
        _fit_sides(image, board, marks_px[r], predicted_px[r], USUAL_BLUR_PX)
        for r in range(board.count)
    ]
    first = _fit_borders(image, board, rods, marks_px, None, None)
    fits = [fit for row in first for fit in row if fit is not None]
    if not fits:
        empty = np.full(marks_px.shape, np.nan)
        return Refined(empty, empty[..., 0])
    blur = float(np.median([fit.blur_px for fit in fits]))
    curve = _curve_model(fits)
    rods = [
        _fit_sides(image, board, _positions(first[r]), predicted_px[r], blur)
        for r in range(board.count)
    ]
    again = np.stack([_positions(row) for row in first])
    second = _fit_borders(image, board, rods, again, blur, curve)
    _reject_odd_looking(second)
    marks = np.stack([_positions(row) for row in second])
    sigma = np.array([[np.nan if f is None else f.sigma_px for f in row] for row in second])
    sigma[_strays(board, marks)] = np.nan
    marks[~np.isfinite(sigma)] = np.nan
    return Refined(marks, sigma)


def _positions(row: list[BorderFit | None]) -> FloatArray:
    return np.array([(np.nan, np.nan) if fit is None else fit.point_px for fit in row])


def _fit_sides(
    image: FloatImage,
    board: RodBoard,
    marks: FloatArray,
    predicted: FloatArray,
    blur_px: float,
) -> RodFit | None:
    """Fit a rod between its marks; a single mark borrows its neighbours' predicted places."""
    found = np.isfinite(marks[:, 0])
    if not found.any():
        return None
    if found.sum() == 1:
        index = int(np.nonzero(found)[0][0])
        marks = marks.copy()
        near = [k for k in (index - 1, index + 1) if 0 <= k < len(marks)]
        marks[near] = marks[index] + 0.6 * (predicted[near] - predicted[index])
        if not np.isfinite(marks[near]).all():
            return None
    return fit_rod(image, marks, board.rod_diameter_m * _px_per_m(board, marks), blur_px)


def _fit_borders(
    image: FloatImage,
    board: RodBoard,
    rods: list[RodFit | None],
    marks_px: FloatArray,
    blur_px: float | None,
    curve: FloatArray | None,
) -> list[list[BorderFit | None]]:
    """Fit every border, looking less far along the rod where the far look does not fit."""
    table: list[list[BorderFit | None]] = []
    for rod, marks in zip(rods, marks_px, strict=True):
        table.append([None] * len(marks))
        found = np.nonzero(np.isfinite(marks[:, 0]))[0]
        if rod is None:
            continue
        scale = 2 * rod.place(marks[found[0], 1])[2] / board.rod_diameter_m
        for m in found:
            bend = None if curve is None else float(curve @ [1.0, *marks[m]])
            width = 2 * rod.place(marks[m, 1])[2]
            table[-1][m] = _best_border(
                image, rod, marks[m, 1], _reach(board, m, scale, width), blur_px, bend
            )
    return table


def _best_border(
    image: FloatImage,
    rod: RodFit,
    y: float,
    reach: FloatArray,
    blur_px: float | None,
    curve: float | None,
) -> BorderFit | None:
    """Fit a border with its full reach, or with less below, above or on both sides."""
    best = None
    short = np.minimum(reach, SHORT_REACH_PX)
    for below, above in (
        (reach[0], reach[1]),
        (short[0], reach[1]),
        (reach[0], short[1]),
        (short[0], short[1]),
    ):
        fit = fit_border(image, rod, y, (below, above), blur_px, curve)
        if fit is None:
            continue
        if fit.residual < LARGEST_RESIDUAL * abs(fit.above - fit.below):
            return fit
        best = best or fit
    return best


def _px_per_m(board: RodBoard, marks: FloatArray) -> float:
    """Return the scale of a rod in the picture from its outermost marks."""
    found = np.nonzero(np.isfinite(marks[:, 0]))[0]
    length = np.linalg.norm(marks[found[-1]] - marks[found[0]])
    return float(length / (board.marks_m[found[-1]] - board.marks_m[found[0]]))


def _reach(board: RodBoard, mark: int, px_per_m: float, width_px: float) -> FloatArray:
    """Return how far to look below and above a mark, px."""
    gaps = np.diff(board.marks_m, prepend=0.0, append=2 * board.marks_m[-1] - board.marks_m[-2])
    wanted = max(LEAST_REACH_PX, REACH_WIDTHS * width_px)
    limits: FloatArray = np.minimum(wanted, REACH_SPACING * px_per_m * gaps[mark : mark + 2])
    return limits


def _curve_model(fits: list[BorderFit]) -> FloatArray:
    """Return the borders' curve as a linear function (1, x, y) of the place in the picture.

    The curve is the sine of the angle at which the camera looks down on the rod: for parallel rods
    nearly linear over the picture.
    """
    points = np.array([fit.point_px for fit in fits])
    curves = np.array([fit.curve for fit in fits])
    weights = np.array([fit.curve_weight for fit in fits])
    middle, size = points.mean(0), np.maximum(np.ptp(points, axis=0).max(), 1.0)
    design = np.column_stack([np.ones(len(fits)), (points - middle) / size])
    model = np.zeros(3)
    for _ in range(5):
        off = curves - design @ model
        w = weights / (1 + weights * off**2 / 9)
        # a picture holds 60 degrees or so; the prior keeps few or narrow rods from running away
        normal = design.T @ (w[:, None] * design) + np.diag([1 / 0.5**2, 1 / 0.1**2, 1 / 0.5**2])
        model = np.linalg.solve(normal, design.T @ (w * curves))
    slope = model[1:] / size
    return np.array([model[0] - slope @ middle, *slope])


def _reject_odd_looking(table: list[list[BorderFit | None]]) -> None:
    """Drop borders whose step, levels or residuals are not like the board's other ones."""
    steps = [
        (fit.above - fit.below) * (1 if m % 2 == 0 else -1)
        for row in table
        for m, fit in enumerate(row)
        if fit is not None
    ]
    if not steps:
        return
    typical = float(np.median(steps))
    for row in table:
        for m, fit in enumerate(row):
            if fit is None:
                continue
            step = (fit.above - fit.below) * (1 if m % 2 == 0 else -1)
            if (
                not LEAST_STEP * typical < step < LARGEST_STEP * typical
                or fit.residual > LARGEST_RESIDUAL * step
            ):
                row[m] = None


def _strays(board: RodBoard, marks: FloatArray) -> npt.NDArray[np.bool_]:
    """Return which marks contradict the exact spacing of their rod: (R, M) bool.

    Along a rod the picture is a projective line, t = (a + b h) / (1 + c h). All rods of a board are
    nearly parallel, so c is nearly theirs in common.
    """
    stray = np.zeros(marks.shape[:2], np.bool_)
    fits = [_line_fit(board.marks_m, rod, 0.0, 1e-9) for rod in marks]
    bends = [fit[0] for fit, rod in zip(fits, marks, strict=True)
             if fit is not None and np.isfinite(rod[:, 0]).sum() >= 5]  # fmt: skip
    bend = float(np.median(bends)) if bends else 0.0
    for r, rod in enumerate(marks):
        current = rod.copy()
        while True:
            fit = _line_fit(board.marks_m, current, bend, 0.02 if bends else 0.1)
            if fit is None:
                break
            off, length = fit[1], fit[2]
            if not np.nanmax(off) > STRAY_PX + STRAY_LENGTH * length:
                break
            worst = int(np.nanargmax(off))
            stray[r, worst] = True
            current[worst] = np.nan
    return stray


def _line_fit(
    heights: FloatArray, rod: FloatArray, bend: float, bend_sigma: float
) -> tuple[float, FloatArray, float] | None:
    """Fit a projective line to a rod's marks; None below three marks.

    Returns the bend c, per spacing of the whole rod, each mark's deviation once it is left out of
    the fit (M,), NaN = not found, and the rod's length, px.
    """
    found = np.isfinite(rod[:, 0])
    if found.sum() < 3:
        return None
    points = rod[found]
    h = (heights[found] - heights[0]) / np.ptp(heights) - 0.5
    chord = points[-1] - points[0]
    length = float(np.linalg.norm(chord))
    t = (points - points[0]) @ chord / length
    # t = a + b h - c h t, linear in a, b, c
    design = np.column_stack([np.ones_like(h), h, -h * (t - t.mean())])
    prior = np.array([0.0, 0.0, 1.0 / bend_sigma**2]) * STRAY_PX**2
    normal = design.T @ design + np.diag(prior)
    solution = np.linalg.solve(normal, design.T @ t + prior * np.array([0, 0, bend]))
    leverage = np.einsum('ij,jk,ik->i', design, np.linalg.inv(normal), design)
    off = np.full(len(rod), np.nan)
    off[found] = np.abs(t - design @ solution) / np.maximum(1 - leverage, 0.1)
    return float(solution[2]), off, length
