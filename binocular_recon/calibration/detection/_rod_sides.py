# SPDX-License-Identifier: Apache-2.0
"""Fit the two sides of a board's rods to grey levels, to subpixel accuracy."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from binocular_recon.calibration.detection._edge_fit import USUAL_BLUR_PX, RodFit
from binocular_recon.calibration.detection._rod_fit_kernels import (
    C0,
    C1,
    C2,
    R0,
    R1,
    ROD_PARAMETERS,
    S1,
    S2,
    SIGMA,
    accumulate_rows,
    shading,
)
from binocular_recon.calibration.detection._search_kernels import centre_rod
from binocular_recon.camera import FloatArray
from binocular_recon.images import FloatImage, Mask

# Steps of the fit; the first ones move the lines only, the next ones keep the expected width and
# angle of view.
ROD_STEPS, LINE_STEPS, WIDTH_STEPS = 11, 3, 7
# Most that a step may change C0 and C1, as a share of the width.
LINE_STEP = 0.33
# What the rods of an image have in common: width against rod_diameter, S1 and S2 at their middle,
# blur (px), how the lens bends them, at their middle and its change over BEND_REACH_PX, in
# BEND_UNIT (1 / px), and the angle of view of an image's width (rad): expected value, standard
# deviation, and largest change in one step. A rod more to the right shows the sun more of its
# right side. SUN: a hard one is rare, but then far stronger, from FAR_SUN on: wide tails.
COMMON_START = np.array([1.0, 0.0, 0.2, USUAL_BLUR_PX, 0.0, 0.0, 1.0])
COMMON_SIGMA = np.array([0.1, 0.7, 0.7, 0.3, 1.0, 1.0, 0.3])
COMMON_STEP = np.array([0.1, 0.3, 0.3, 0.2, 0.2, 0.2, 0.1])
BEND_UNIT, BEND_REACH_PX = 1e-4, 500.0
SUN, FAR_SUN = np.array([0, 1, 1, 0, 0, 0, 0]), 1.4
# Starts of S1, tried in turn until width and blur are as expected within so many sigmas.
SUN_STARTS, MOST_STRAIN = (0.0, 1.5, -1.5), 4.5
# Number of a rod's own parameters, and of its rows that are fitted: neighbouring ones add little.
OWN, MAX_ROWS = 2, 160
# Rows this near to an edge are left out of the fit of the sides, px (and the rod's lean).
GUARD_PX = 2.5
# Rows used beyond the outermost marks, as a share of a spacing.
BEYOND = 0.3
# Mean contrast of a rod's side, over dark and light bands, against the step between these.
MIN_CONTRAST = 0.25
# The rough lines of rods with a larger half width than this, px, are first centred on this many
# rows; a contrast counts no more than this, grey levels.
WIDE_PX, CENTRE_ROWS, MAX_CONTRAST = 4.0, 40, 60.0
# Least residual above which a row is down-weighted, grey levels.
MIN_RESIDUAL = 2.0


def fit_rods(
    image: FloatImage,
    marks_px: list[FloatArray | None],
    edges_y: FloatArray,
    width_px: FloatArray,
    light_bands: Mask,
) -> list[RodFit | None]:
    """Fit the middle lines of a board's rods to their two sides.

    Each row between the marks has its own level and its own background on either side. Each rod
    has its own line. All rods share the ratio of real to expected width, the shading and the blur.
    Rows that do not fit (clutter, something in front) are down-weighted.

    Parameters
    ----------
    image : (H, W) float32
        Grey levels.
    marks_px : list of (M, 2) float64 or None
        Rough positions of each rod's marks, at least two, NaN = unknown; None = no such rod.
    edges_y : (R, M) float64
        Rows of all edges, found or not, px.
    width_px : (R, M) float64
        Expected width across each rod at its marks, px.
    light_bands : (M + 1,) bool
        Which bands are light, from the lowest up.

    Returns
    -------
    list of RodFit or None
        None for a rod that cannot be seen.

    """
    places = [np.nanmean(marks[:, 0]) for marks in marks_px if marks is not None]
    sides = [
        None
        if marks is None
        else _start(image, marks, edges, width, light_bands, float(np.mean(places)))
        for marks, edges, width in zip(marks_px, edges_y, width_px, strict=True)
    ]
    seen = [side for side in sides if side is not None]
    common = COMMON_START
    for s1 in SUN_STARTS if seen else ():
        # from the wrong side of the sun the fit ends with rods too narrow and blurred
        tried = [replace(side, line=side.line.copy(), rows=side.rows.copy()) for side in seen]
        found = _fit(image, tried, COMMON_START + s1 * np.eye(len(COMMON_START))[1])
        if s1 == SUN_STARTS[0] or _strain(found) < _strain(common):
            common = found
            for side, best in zip(seen, tried, strict=True):
                side.line, side.rows = best.line, best.rows
        if _strain(common) < MOST_STRAIN:
            break
    # the background of one rod may vary with its bands; of most rods it cannot
    flat = [side for side in seen if not side.stands_out(common)]
    lost = flat if 2 * len(flat) > len(seen) else []
    return [None if side is None or side in lost else side.result(common) for side in sides]


@dataclass(eq=False)
class _Side:
    """A rod during the fit: C0, C1 in ``line``; ``rows`` as `accumulate_rows` takes them.

    ``half_row_px``: R0 and R1 of the expected half width along a row. ``bend`` (2,): derivatives
    of C2 by the common parameters of the lens. ``aside``: how far right of the rods' middle, as a
    share of the image's width. ``light`` (n,): which rows are in light bands.
    """

    line: FloatArray
    half_row_px: FloatArray
    bend: FloatArray
    aside: float
    y_middle: float
    y_scale: float
    rows: FloatArray
    light: Mask

    def parameters(self, common: FloatArray) -> FloatArray:
        """Return the parameters of the kernels."""
        c2 = self.bend @ common[4:6]
        shade = self.turn(common) @ common[1:3]
        return np.array([*self.line, c2, *(common[0] * self.half_row_px), *shade, common[3]])

    def turn(self, common: FloatArray) -> FloatArray:
        """Return the matrix that gives S1 and S2 of this rod from those at the rods' middle."""
        cos, sin = np.cos(common[6] * self.aside), np.sin(common[6] * self.aside)
        return np.array([[cos, sin], [-sin, cos]])

    def result(self, common: FloatArray) -> RodFit | None:
        """Return the fit, None if no row of the rod could be seen."""
        if not np.isfinite(self.rows[:, 3]).any():
            return None
        return RodFit(self.parameters(common), self.y_middle, self.y_scale)

    def stands_out(self, common: FloatArray) -> bool:
        """Return whether the rod stands out from what is beside it on both sides.

        A background as dark as the dark bands is darker than the light ones, so the contrast of
        dark and light bands together averages at least half their step. Within a column of a
        chessboard's squares it is zero on at least one side.
        """
        seen = np.isfinite(self.rows[:, 3])
        _, _, weight, level, _, left, right = self.rows[seen].T
        light = self.light[seen]
        if weight[light].sum() <= 0 or weight[~light].sum() <= 0:
            return True
        dark_level, light_level = (
            np.average(level[kind], weights=weight[kind]) for kind in (~light, light)
        )
        for side, beside in ((-1.0, left), (1.0, right)):
            shade = shading(side, *self.parameters(common)[[S1, S2]])
            contrast = np.abs(shade * level - beside)
            mean = np.mean(
                [np.average(contrast[kind], weights=weight[kind]) for kind in (~light, light)]
            )
            if mean < MIN_CONTRAST * shade * (light_level - dark_level):
                return False
        return True


def _fit(image: FloatImage, seen: list[_Side], common: FloatArray) -> FloatArray:
    """Fit rods in place, from these common parameters; return those found."""
    for step in range(ROD_STEPS):
        # a blurred model first: it converges from farther away
        systems = [_normal_equations(image, side, common, 0.25 * 0.6**step) for side in seen]
        change = np.zeros(len(common))
        if step >= LINE_STEPS:
            change = _common_change(systems, common)
            if step < WIDTH_STEPS:
                change[[0, -1]] = 0.0
        common = common + change
        for side, (normal, gradient) in zip(seen, systems, strict=True):
            own = np.linalg.solve(normal[:OWN, :OWN], gradient[:OWN] - normal[:OWN, OWN:] @ change)
            limit = 2 * side.half_row_px[0] * LINE_STEP
            side.line = side.line + np.clip(own, -limit, limit)
            _reweight_rows(side.rows, side.light)
    return common


def _strain(common: FloatArray) -> float:
    """Return by how many standard deviations width and blur differ from what is expected."""
    return float(np.linalg.norm(((common - COMMON_START) / COMMON_SIGMA)[[0, 3]]))


def _start(
    image: FloatImage,
    marks: FloatArray,
    edges_y: FloatArray,
    width_px: FloatArray,
    light_bands: Mask,
    x_middle: float,
) -> _Side:
    """Start the fit of a rod from the straight line through its marks."""
    order = np.argsort(-marks[:, 1])  # NaN last
    order = order[: np.isfinite(marks[:, 0]).sum()]
    known, width_px = marks[order], width_px[order]
    low, high = known[-1, 1], known[0, 1]
    middle, scale = 0.5 * (low + high), max(0.5 * (high - low), 1.0)
    z = (known[:, 1] - middle) / scale
    slope, x0 = np.polyfit(z, known[:, 0], 1)
    lean = float(np.hypot(slope / scale, 1))
    taper, width = np.polyfit(z, width_px, 1)
    gap = float(np.median(np.abs(np.diff(known[:, 1]))))
    first, last = max(0, int(low - BEYOND * gap)), min(len(image) - 1, int(high + BEYOND * gap))
    y = np.arange(first, last + 1)
    away = np.abs(y[:, None] - edges_y).min(1)
    y = y[away > GUARD_PX + 0.5 * width * np.sqrt(lean**2 - 1)]
    y = y[:: len(y) // MAX_ROWS + 1]
    rows = np.zeros((len(y), 7))
    rows[:, 0], rows[:, 1], rows[:, 2] = y, (y - middle) / scale, 1.0
    light = light_bands[(edges_y > y[:, None]).sum(1)]
    half = 0.5 * lean * np.array([width, taper])
    bend = BEND_UNIT * scale**2 * np.array([1.0, (x0 - x_middle) / BEND_REACH_PX])
    line = np.array([x0, slope])
    if half[0] > WIDE_PX:
        centre_rod(image, rows[:: max(1, len(rows) // CENTRE_ROWS)], line, half, MAX_CONTRAST)
    aside = (x0 - x_middle) / image.shape[1]
    return _Side(line, half, bend, aside, middle, scale, rows, light)


def _common_change(systems: list[tuple[FloatArray, FloatArray]], common: FloatArray) -> FloatArray:
    """Solve for the common parameters with each rod's own line eliminated."""
    sun = SUN * np.hypot(*common[1:3])
    prior, step = 1 / (COMMON_SIGMA**2 * (1 + (sun / FAR_SUN) ** 2)), COMMON_STEP * (1 + sun)
    total, pull = np.diag(prior), prior * (COMMON_START - common)
    for normal, gradient in systems:
        weight = np.linalg.solve(normal[:OWN, :OWN], normal[:OWN, OWN:])
        total = total + normal[OWN:, OWN:] - normal[OWN:, :OWN] @ weight
        pull = pull + gradient[OWN:] - weight.T @ gradient[:OWN]
    change: FloatArray = np.clip(np.linalg.solve(total, pull), -step, step)
    return change


def _normal_equations(
    image: FloatImage, side: _Side, common: FloatArray, soften: float
) -> tuple[FloatArray, FloatArray]:
    """Return normal matrix and gradient for C0, C1 and the common parameters.

    Both are divided by the variance of the residuals.
    """
    parameters = side.parameters(common)
    parameters[SIGMA] = max(common[3], soften * 2 * side.half_row_px[0])
    normal = np.zeros((ROD_PARAMETERS, ROD_PARAMETERS))
    gradient = np.zeros(ROD_PARAMETERS)
    accumulate_rows(image, side.rows, parameters, normal, gradient)
    # derivatives of the kernels' parameters by the rod's own and the common ones
    combine = np.zeros((ROD_PARAMETERS, OWN + len(common)))
    combine[[C0, C1, SIGMA], [0, 1, 5]] = 1.0
    combine[[R0, R1], 2] = side.half_row_px
    combine[[S1, S2], 3:5] = side.turn(common)
    combine[C2, 6:8] = side.bend
    combine[[S1, S2], 8] = side.aside * parameters[[S2, S1]] * [1, -1]
    normal, gradient = combine.T @ normal @ combine, combine.T @ gradient
    residual, weight = side.rows[:, 4], side.rows[:, 2]
    used = np.isfinite(residual) & (weight > 0)
    variance = MIN_RESIDUAL**2
    if used.any():
        variance += float(np.average(residual[used] ** 2, weights=weight[used]))
    normal[range(OWN), range(OWN)] += 1e-6 * variance
    return normal / variance, gradient / variance


def _reweight_rows(rows: FloatArray, light: Mask) -> None:
    """Down-weight rows with a large residual or a level unlike that of their kind of band."""
    level, residual = rows[:, 3], rows[:, 4]
    seen = np.isfinite(residual)
    if not seen.any():
        return
    typical = max(MIN_RESIDUAL, _median(residual[seen]))
    weight = 1 / (1 + (residual / typical) ** 2) ** 2
    for kind in (~light, light):
        same = seen & kind
        if same.any():
            off = level[same] - _median(level[same])
            spread = _median(np.abs(off)) + MIN_RESIDUAL
            weight[same] /= (1 + (off / (3 * spread)) ** 2) ** 2
    rows[:, 2] = np.where(seen, weight, 0.0)


def _median(values: FloatArray) -> float:
    """Return the median of a few numbers, in a tenth of numpy's time."""
    ordered = np.sort(values)
    return 0.5 * float(ordered[(len(ordered) - 1) // 2] + ordered[len(ordered) // 2])
