# SPDX-License-Identifier: Apache-2.0
"""Measure the marks of a board to subpixel accuracy and reject those that contradict the rest."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from binocular_recon.calibration.detection._band_check import reject_odd_looking, rod_ends
from binocular_recon.calibration.detection._edge_fit import (
    MAX_RESIDUAL,
    EdgeFit,
    RodFit,
    curve_model,
    fit_edge,
)
from binocular_recon.calibration.detection._rod_sides import fit_rods
from binocular_recon.calibration.target.board_plane import plane_marks
from binocular_recon.calibration.target.rods import RodBoard
from binocular_recon.camera import FloatArray
from binocular_recon.images import FloatImage, Mask

# Reach of an edge's fit along the rod: shares of the rod's width and of the spacing; at least, px.
REACH_WIDTHS, REACH_SPACING, MIN_REACH_PX = 1.2, 0.45, 3.5
# Reach where something in front of the rod is near, px.
SHORT_REACH_PX = 2.5
# Marks of one rod fit their exact spacing within this, px, and this share of the rod's length
# (distortion); the usual error of a mark, px.
OUTLIER_PX, OUTLIER_SHARE, MARK_SIGMA_PX = 0.4, 0.001, 0.15
# Error of a perfect fit of an edge: shading, pixels, blur that is not Gaussian, px.
MODEL_SIGMA_PX = 0.022


class Refined(NamedTuple):
    """Measured marks: positions (R, M, 2) and standard deviations (R, M), NaN = rejected.

    ``ends_px`` (N, 2): ends of rods that looked like marks. ``levels`` (2,): of dark and light
    bands. ``goes_on`` (R, M, 2): whether the rod visibly goes on below and above each mark.
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
        Where the plane of the whole board predicts the marks; None = not known.
    levels : (2,) float64 or None
        Levels of dark and light bands; None = measure them.

    """
    # rough marks give the scale of a rod, but not how it changes along the rod
    scale = [np.mean(_px_per_m(board, rod)) for rod in predicted_px]
    widths = board.rod_diameter_m * np.repeat(np.array(scale)[:, None], board.marks_per_rod, 1)
    rods = _fit_sides(image, board, marks_px, predicted_px, widths)
    first = _fit_edges(image, board, rods, marks_px, None, None)
    fits = [fit for row in first for fit in row if fit is not None]
    if not fits:
        empty = np.full(marks_px.shape, np.nan)
        return Refined(empty, empty[..., 0], empty[:0, 0], levels, np.isfinite(empty))
    blur = float(np.median([fit.blur_px for fit in fits]))
    curve = curve_model(fits)
    again = np.stack([_positions(row) for row in first])
    exact = plane_marks(board, again, (image.shape[1], image.shape[0]))
    if exact is not None:
        widths = board.rod_diameter_m * np.stack([_px_per_m(board, rod) for rod in exact])
    rods = _fit_sides(image, board, again, predicted_px, widths)
    second = _fit_edges(image, board, rods, again, blur, curve)
    reject_odd_looking(second, board.dark_below)
    marks = np.stack([_positions(row) for row in second])
    ends, levels, goes_on = rod_ends(image, rods, second, board.light_bands, levels)
    ends_px, marks[ends] = marks[ends], np.nan
    sigma = np.array([[np.nan if f is None else f.sigma_px for f in row] for row in second])
    sigma = np.hypot(sigma, MODEL_SIGMA_PX)
    sigma[ends | _outliers(board, marks, plane_px)] = np.nan
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
    """Fit every rod between its marks; a single mark is helped by its predicted neighbours."""
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
    """Fit every edge, with a shorter reach along the rod where the full one does not fit."""
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
    """Return the scale along a rod at its marks, px per m, from their positions (M, 2)."""
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
    """Return the reach of the fit below and above a mark, px."""
    gaps = np.diff(board.marks_m, prepend=0.0, append=2 * board.marks_m[-1] - board.marks_m[-2])
    wanted = max(MIN_REACH_PX, REACH_WIDTHS * width_px)
    limits: FloatArray = np.minimum(wanted, REACH_SPACING * px_per_m * gaps[mark : mark + 2])
    return limits


def _outliers(
    board: RodBoard, marks: FloatArray, plane: FloatArray | None
) -> npt.NDArray[np.bool_]:
    """Return which marks contradict their rod's exact spacing and the board: (R, M) bool.

    ``plane`` (R, M, 2) is where the board's plane predicts the marks; None = not known. A rod may
    stand too high or low, nearer or farther, and the lens bends it a little; the rest of the
    deviation is the mark's own.
    """
    outlier = np.zeros(marks.shape[:2], np.bool_)
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
        limit = OUTLIER_PX + OUTLIER_SHARE * length
        while True:
            deviation = _deviation(board.marks_m, off, sigma)
            if not np.nanmax(deviation, initial=0.0) > limit:
                break
            worst = np.argsort(-np.nan_to_num(deviation))[:2]
            # two that contradict each other: both go
            tie = deviation[worst[1]] > 0.7 * deviation[worst[0]] and np.isfinite(off).sum() <= 3
            drop = worst if tie else worst[:1]
            outlier[r, drop] = True
            off[drop] = np.nan
    return outlier


def _deviation(heights: FloatArray, off: FloatArray, sigma: FloatArray) -> FloatArray:
    """Fit a parabola with priors to the deviations of a rod's marks; return the residuals.

    Each residual is divided by the square root of its redundancy: the largest is then the one
    whose removal reduces the squared error most. (M,), NaN = not found.
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
