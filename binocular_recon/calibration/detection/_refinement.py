# SPDX-License-Identifier: Apache-2.0
"""Measure the marks of a board below a pixel and reject those that contradict the rest."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from binocular_recon.calibration.detection._band_check import rod_ends
from binocular_recon.calibration.detection._edge_fit import EdgeFit, fit_edge
from binocular_recon.calibration.detection._rod_sides import RodFit, fit_rods
from binocular_recon.calibration.target.board_plane import plane_marks
from binocular_recon.calibration.target.rods import RodBoard
from binocular_recon.camera import FloatArray
from binocular_recon.images import FloatImage, Mask

# How far along the rod an edge's fit looks: shares of the rod's width and of the spacing, px.
REACH_WIDTHS, REACH_SPACING, MIN_REACH_PX = 1.2, 0.45, 3.5
# With something in front of the rod nearby it looks only this far, px.
SHORT_REACH_PX = 2.5
# Largest root mean square residual of an edge, as a share of its step.
MAX_RESIDUAL = 0.12
# An edge's step against the typical one of the board; levels of a band, as a share of the step.
MIN_STEP, MAX_STEP, LEVEL_RANGE = 0.4, 2.0, 0.45
# Marks of one rod fit their exact spacing to this, px, and to this share of the rod's length
# (distortion); the usual error of a mark, px.
STRAY_PX, STRAY_LENGTH, MARK_SIGMA_PX = 0.4, 0.001, 0.15
# What a perfect fit of an edge is off by: shading, pixels, blur that is no Gaussian, px.
MODEL_SIGMA_PX = 0.022


class Refined(NamedTuple):
    """Marks below a pixel: positions (R, M, 2) and standard deviations (R, M), NaN = rejected.

    ``ends_px`` (N, 2): ends of rods that looked like marks. ``levels`` (2,): dark, light bands.
    ``goes_on`` (R, M, 2): whether a rod can be seen to go on below and above each mark.
    """

    marks_px: FloatArray
    sigma_px: FloatArray
    ends_px: FloatArray
    levels: FloatArray | None
    goes_on: Mask


def refine(
    image: FloatImage,
    board: RodBoard,
    marks_px: FloatArray,
    predicted_px: FloatArray,
    plane_px: FloatArray | None,
    levels: FloatArray | None = None,
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
    plane_px : (R, M, 2) float64 or None
        Where the plane of the whole board puts the marks; None = not known.
    levels : (2,) float64 or None
        Levels of dark and light bands; None = find out.

    """
    # rough marks tell the scale of a rod but not how it changes along it
    scale = [np.mean(_px_per_m(board, rod)) for rod in predicted_px]
    widths = board.rod_diameter_m * np.repeat(np.array(scale)[:, None], board.marks_per_rod, 1)
    rods = _fit_sides(image, board, marks_px, predicted_px, widths)
    first = _fit_edges(image, board, rods, marks_px, None, None)
    fits = [fit for row in first for fit in row if fit is not None]
    if not fits:
        empty = np.full(marks_px.shape, np.nan)
        return Refined(empty, empty[..., 0], empty[:0, 0], levels, np.isfinite(empty))
    blur = float(np.median([fit.blur_px for fit in fits]))
    curve = _curve_model(fits)
    again = np.stack([_positions(row) for row in first])
    exact = plane_marks(board, again, (image.shape[1], image.shape[0]))
    if exact is not None:
        widths = board.rod_diameter_m * np.stack([_px_per_m(board, rod) for rod in exact])
    rods = _fit_sides(image, board, again, predicted_px, widths)
    second = _fit_edges(image, board, rods, again, blur, curve)
    _reject_odd_looking(second, board.dark_below)
    marks = np.stack([_positions(row) for row in second])
    ends, levels, goes_on = rod_ends(image, rods, second, board.light_bands, levels)
    ends_px, marks[ends] = marks[ends], np.nan
    sigma = np.array([[np.nan if f is None else f.sigma_px for f in row] for row in second])
    sigma = np.hypot(sigma, MODEL_SIGMA_PX)
    sigma[ends | _strays(board, marks, plane_px)] = np.nan
    marks[~np.isfinite(sigma)] = np.nan
    return Refined(marks, sigma, ends_px, levels, goes_on)


def _positions(row: list[EdgeFit | None]) -> FloatArray:
    return np.array([(np.nan, np.nan) if fit is None else fit.point_px for fit in row])


def _fit_sides(
    image: FloatImage,
    board: RodBoard,
    marks_px: FloatArray,
    predicted_px: FloatArray,
    width_px: FloatArray,
) -> list[RodFit | None]:
    """Fit every rod between its marks; a single mark borrows its neighbours' predicted places."""
    lines: list[FloatArray | None] = []
    found = np.isfinite(marks_px[..., 0])
    everywhere = np.where(found[..., None], marks_px, predicted_px)
    for rod, seen in enumerate(found):
        near = seen.copy()
        if seen.sum() == 1:
            near[1:] |= seen[:-1]
            near[:-1] |= seen[1:]
        visible = np.where(near[:, None], everywhere[rod], np.nan)
        known = seen.any() and np.isfinite(everywhere[rod]).all()
        known = known and np.isfinite(width_px[rod]).all()
        lines.append(visible if known else None)
    return fit_rods(image, lines, everywhere[..., 1], width_px, board.light_bands)


def _fit_edges(
    image: FloatImage,
    board: RodBoard,
    rods: list[RodFit | None],
    marks_px: FloatArray,
    blur_px: float | None,
    curve: FloatArray | None,
) -> list[list[EdgeFit | None]]:
    """Fit every edge, looking less far along the rod where the far look does not fit."""
    table: list[list[EdgeFit | None]] = []
    for rod, marks in zip(rods, marks_px, strict=True):
        table.append([None] * len(marks))
        found = np.nonzero(np.isfinite(marks[:, 0]))[0].tolist()
        if rod is None:
            continue
        scale = 2 * rod.place(marks[found[0], 1])[2] / board.rod_diameter_m
        for m in found:
            bend = None if curve is None else float(curve @ [1.0, *marks[m]])
            middle, _, half = rod.place(marks[m, 1])
            if not half <= middle[0] <= image.shape[1] - 1 - half:
                continue  # cut lengthwise by the image border: one side does not give the middle
            width = 2 * half
            table[-1][m] = _best_edge(
                image, rod, marks[m, 1], _reach(board, m, scale, width), blur_px, bend
            )
    return table


def _best_edge(
    image: FloatImage,
    rod: RodFit,
    y: float,
    reach: FloatArray,
    blur_px: float | None,
    curve: float | None,
) -> EdgeFit | None:
    """Fit an edge with its full reach, or with less below, above or on both sides."""
    best = None
    short = np.minimum(reach, SHORT_REACH_PX)
    for below, above in (
        (reach[0], reach[1]),
        (short[0], reach[1]),
        (reach[0], short[1]),
        (short[0], short[1]),
    ):
        fit = fit_edge(image, rod, y, (below, above), blur_px, curve)
        if fit is None:
            continue
        if fit.residual < MAX_RESIDUAL * abs(fit.above - fit.below):
            return fit
        best = best or fit
    return best


def _px_per_m(board: RodBoard, rod: FloatArray) -> FloatArray:
    """Return the scale of the image along a rod at its marks, from their places (M, 2)."""
    if not np.isfinite(rod).all():
        return np.full(len(rod), np.nan)
    chord = rod[-1] - rod[0]
    along = (rod - rod[0]) @ chord / np.linalg.norm(chord)
    degree = min(2, len(along) - 1)
    scale: FloatArray = np.polyval(
        np.polyder(np.polyfit(board.marks_m, along, degree)), board.marks_m
    )
    return scale


def _reach(board: RodBoard, mark: int, px_per_m: float, width_px: float) -> FloatArray:
    """Return how far to look below and above a mark, px."""
    gaps = np.diff(board.marks_m, prepend=0.0, append=2 * board.marks_m[-1] - board.marks_m[-2])
    wanted = max(MIN_REACH_PX, REACH_WIDTHS * width_px)
    limits: FloatArray = np.minimum(wanted, REACH_SPACING * px_per_m * gaps[mark : mark + 2])
    return limits


def _curve_model(fits: list[EdgeFit]) -> FloatArray:
    """Return the edges' curve as a linear function (1, x, y) of the place in the image.

    The curve is the sine of the angle at which the camera looks down on the rod: for parallel rods
    nearly linear over the image.
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
        # an image holds 60 degrees or so; the prior keeps few or narrow rods from running away
        normal = design.T @ (w[:, None] * design) + np.diag([1 / 0.5**2, 1 / 0.1**2, 1 / 0.5**2])
        model = np.linalg.solve(normal, design.T @ (w * curves))
    slope = model[1:] / size
    return np.array([model[0] - slope @ middle, *slope])


def _reject_odd_looking(table: list[list[EdgeFit | None]], dark_below: Mask) -> None:
    """Drop edges whose step, levels or residuals are not like the board's other ones."""
    levels = [
        _dark_and_light(fit, dark)
        for row in table
        for fit, dark in zip(row, dark_below, strict=True)
        if fit
    ]
    if not levels:
        return
    dark, light = np.median(levels, axis=0)
    typical = light - dark
    for row in table:
        for m, fit in enumerate(row):
            if fit is None:
                continue
            own_dark, own_light = _dark_and_light(fit, dark_below[m])
            step = own_light - own_dark
            off = max(abs(own_dark - dark), abs(own_light - light))
            if (
                not MIN_STEP * typical < step < MAX_STEP * typical
                or off > LEVEL_RANGE * typical
                or fit.residual > MAX_RESIDUAL * step
            ):
                row[m] = None


def _dark_and_light(fit: EdgeFit, dark_below: bool) -> tuple[float, float]:
    """Return the levels of the bands that should be dark and light at an edge."""
    return (fit.below, fit.above) if dark_below else (fit.above, fit.below)


def _strays(board: RodBoard, marks: FloatArray, plane: FloatArray | None) -> npt.NDArray[np.bool_]:
    """Return which marks contradict their rod's exact spacing and the board: (R, M) bool.

    ``plane`` (R, M, 2) is where the board's plane puts the marks; None = not known. A rod may be
    too high or low and nearer or farther, the lens bends a little; what is left is the mark's.
    """
    stray = np.zeros(marks.shape[:2], np.bool_)
    for r, rod in enumerate(marks):
        reference = rod if plane is None else plane[r]
        ends = np.nonzero(np.isfinite(reference[:, 0]))[0]
        if len(ends) < 2:
            continue
        chord = reference[ends[-1]] - reference[ends[0]]
        length = float(np.linalg.norm(chord))
        along = (rod - reference[ends[0]]) @ chord / length
        if plane is None:
            expected = (board.marks_m - board.marks_m[ends[0]]) * length
            expected /= board.marks_m[ends[-1]] - board.marks_m[ends[0]]
            sigma = np.array([1e3, 1e3, 0.03 * length])
        else:
            expected = (plane[r] - reference[ends[0]]) @ chord / length
            scale = length / (board.marks_m[ends[-1]] - board.marks_m[ends[0]])
            sigma = np.array(
                [1 + 3 * board.height_sigma_m * scale, 0.012 * length, 0.004 * length]
            )
        off = along - expected
        limit = STRAY_PX + STRAY_LENGTH * length
        while True:
            deviation = _deviation(board.marks_m, off, sigma)
            if not np.nanmax(deviation, initial=0.0) > limit:
                break
            worst = np.argsort(-np.nan_to_num(deviation))[:2]
            # two that blame each other: both go
            tie = deviation[worst[1]] > 0.7 * deviation[worst[0]] and np.isfinite(off).sum() <= 3
            drop = worst if tie else worst[:1]
            stray[r, drop] = True
            off[drop] = np.nan
    return stray


def _deviation(heights: FloatArray, off: FloatArray, sigma: FloatArray) -> FloatArray:
    """Fit the deviations of a rod's marks by a parabola with priors; return the residuals.

    Each residual is divided by the square root of its redundancy, which makes the one whose
    removal helps most the largest. (M,), NaN = not found.
    """
    found = np.isfinite(off)
    h = (heights[found] - heights.mean()) / np.ptp(heights) * 2
    design = np.column_stack([np.ones_like(h), h, h**2])
    normal = design.T @ design / MARK_SIGMA_PX**2 + np.diag(1 / sigma**2)
    inverse = np.linalg.inv(normal) / MARK_SIGMA_PX**2
    residual = off[found] - design @ (inverse @ (design.T @ off[found]))
    redundancy = 1 - np.einsum('ij,jk,ik->i', design, inverse, design)
    deviation = np.full(len(off), np.nan)
    deviation[found] = np.abs(residual) / np.sqrt(np.maximum(redundancy, 1e-3))
    return deviation
