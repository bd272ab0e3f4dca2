# SPDX-License-Identifier: Apache-2.0
"""Check the grey levels at edges: reject odd ones, and distinguish edges from ends of a rod.

A dark foot on light ground looks like an edge with a light band below. But the ground differs
from the rod's light bands, and not from what is beside it.
"""

from __future__ import annotations

import numpy as np

from binocular_recon.calibration.detection._edge_fit import MAX_RESIDUAL, EdgeFit, RodFit
from binocular_recon.calibration.target.board_plane import inside_image, marks_along
from binocular_recon.calibration.target.rods import RodBoard
from binocular_recon.camera import FloatArray
from binocular_recon.images import FloatImage, Mask

# Distances from the edge, along the rod, of the samples, px.
ALONG_PX = np.linspace(2.0, 6.0, 5)
# Samples across: on the rod, as shares of its half width; beside it, px from its sides.
ACROSS = np.array([-0.4, 0.0, 0.4])
BESIDE_PX = np.array([2.0, 3.0])
# A band's level may differ from that of the other dark or light bands by this share of the step.
LEVEL_SPREAD = 0.06
# A rod visibly goes on where its level is right within the first of these shares of the step and
# differs from what is beside it by the second.
SAME_LEVEL, MIN_CONTRAST = 0.2, 0.1
# Something else looks like one of the rods if this share of the marks in view, and so many at
# least, have levels on both sides within so much of the bands', as a share of their step. It may
# be a little higher or lower, px. Several are a pattern; so many steps are from rod to rod.
SAME_SHARE, SAME_LEAST, SAME_BANDS = 0.6, 3, 0.35
SHIFTS_PX, PATTERN, STEPS = np.linspace(-3.0, 3.0, 5), 2, 40
# An edge's step against the median of the board; levels of a band, as a share of the step.
MIN_STEP, MAX_STEP, LEVEL_RANGE = 0.4, 2.0, 0.45


def reject_odd_looking(table: list[list[EdgeFit | None]], dark_below: Mask) -> None:
    """Drop edges whose step, levels or residual differ from those of the board's others."""
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


def rod_ends(
    image: FloatImage,
    rods: list[RodFit | None],
    table: list[list[EdgeFit | None]],
    light_bands: Mask,
    usual: FloatArray | None,
) -> tuple[Mask, FloatArray, Mask]:
    """Return which edges are ends of a rod, and on which sides of each the rod visibly goes on.

    Parameters
    ----------
    image : (H, W) float32
        Grey levels.
    rods : list of RodFit or None
        Middle lines and widths of the rods.
    table : list of list of EdgeFit or None
        Edges of each rod, None = not found.
    light_bands : (M + 1,) bool
        Which bands are light, from the lowest up.
    usual : (2,) float64 or None
        Levels of dark and light bands; None = measure them at these edges.

    Returns
    -------
    ends : (R, M) bool
    usual : (2,) float64
        Levels of dark and light bands, NaN = unknown.
    goes_on : (R, M, 2) bool
        Whether the rod visibly goes on below and above each edge.

    """
    found = np.array([[fit is not None for fit in row] for row in table])
    # on the rod and beside it, below and above each edge
    levels = np.full((*found.shape, 2, 2), np.nan)
    for r, (rod, row) in enumerate(zip(rods, table, strict=True)):
        for m, fit in enumerate(row):
            if rod is not None and fit is not None:
                levels[r, m] = _levels(image, rod, fit)
    on, beside = levels[..., 0], levels[..., 1]
    light = np.stack([light_bands[:-1], light_bands[1:]], -1)
    if usual is None:
        kinds = (on[:, kind] for kind in (~light, light))
        usual = np.array([np.nanmedian(k) if np.isfinite(k).any() else np.nan for k in kinds])
    dark, bright = usual
    odd = np.abs(on - np.where(light, bright, dark))
    with np.errstate(invalid='ignore'):
        contrast, step = np.abs(on - beside), bright - dark
        absent = (odd > LEVEL_SPREAD * step) & (contrast < 0.5 * odd)
        goes_on = (odd < SAME_LEVEL * step) & (contrast > MIN_CONTRAST * step)
    lower = _outermost(found, absent[..., 0])
    upper = _outermost(found[:, ::-1], absent[:, ::-1, 1])[:, ::-1]
    return lower | upper, usual, goes_on


def _outermost(found: Mask, absent: Mask) -> Mask:
    """Return the first edges of rods with nothing beyond, where most rods agree on the mark.

    On a single rod the band beyond may be hidden, or its background may be just as even.
    """
    first = found & (np.cumsum(found, axis=1) == 1)
    bare = first & absent
    agreed = bare.sum(0) > 0.6 * first.sum(0)
    if len(found) > 1:
        agreed &= bare.sum(0) > 1
    ends: Mask = bare & agreed
    return ends


def _levels(image: FloatImage, rod: RodFit, fit: EdgeFit) -> FloatArray:
    """Return the levels on the rod and beside it, below and above an edge: (2, 2)."""
    _, up, half = rod.place(fit.point_px[1])
    right = np.array([-up[1], up[0]])
    beside = np.concatenate([-half - BESIDE_PX, half + BESIDE_PX])
    levels = np.empty((2, 2))
    for side, sign in enumerate((-1, 1)):
        along = fit.point_px + sign * ALONG_PX[:, None] * up
        for kind, across in enumerate((ACROSS * half, beside)):
            points = along[:, None] + across[:, None] * right
            x, y = np.rint(points).astype(int).reshape(-1, 2).T
            height, width = image.shape
            inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
            seen = image[y[inside], x[inside]]
            levels[side, kind] = np.median(seen) if seen.size else np.nan
    return levels


def _dark_and_light(fit: EdgeFit, dark_below: bool) -> tuple[float, float]:
    """Return the levels of the bands that should be dark and light at an edge."""
    return (fit.below, fit.above) if dark_below else (fit.above, fit.below)


def repeated(
    middle: FloatImage,
    rise_px: float,
    width_px: float,
    board: RodBoard,
    marks_px: FloatArray,
    levels: FloatArray | None,
) -> bool:
    """Return whether other things in the row look like its rods, as in lattices and facades.

    Rods stand out from what is between and beside them. One thing more may be a rod that
    ``rods.yaml`` does not list, or chance.

    Parameters
    ----------
    middle : (H, W) float32
        Grey levels, averaged over most of a rod's width.
    rise_px, width_px : float
        How far below and above an edge levels are compared; the width of the rods.
    board : RodBoard
        Positions of rods and marks.
    marks_px : (R, M, 2) float64
        The marks found; NaN = not found.
    levels : (2,) float64 or None
        Levels of dark and light bands; NaN or None = unknown.

    """
    size = middle.shape[1], middle.shape[0]
    row = board.row_m[:, 0]
    apart = float(np.ptp(row)) / (board.count - 1)
    step = max(0.5 * board.rod_diameter_m, apart / STEPS)
    places = marks_along(
        board, marks_px, size, np.arange(row[0] - apart, row[-1] + apart + step, step)
    )
    if levels is None or not levels[1] > levels[0] or places is None:
        return False
    seen = inside_image(places, size, width_px)
    for rod in marks_px[np.isfinite(marks_px[..., 0]).any(axis=1)]:
        beside = np.abs(places - np.where(np.isfinite(rod), rod, np.inf)).min(
            axis=1, initial=np.inf
        )
        seen[beside[:, 0] < 2 * width_px + 2] = False
    up = places[:, -1] - places[:, 0]
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    most = np.zeros(len(places), int)
    for shift in SHIFTS_PX:
        below, above = (
            _sampled(middle, places + (shift + side * rise_px) * up[:, None]) for side in (-1, 1)
        )
        for dark_below in (board.dark_below, ~board.dark_below):
            kinds = np.where(dark_below, 0, 1)
            off = np.maximum(abs(below - levels[kinds]), abs(above - levels[1 - kinds]))
            same = seen & (off < SAME_BANDS * (levels[1] - levels[0]))
            most = np.maximum(most, same.sum(axis=1))
    alike = most >= np.maximum(SAME_LEAST, SAME_SHARE * seen.sum(axis=1))
    return int(alike[0]) + int((alike[1:] & ~alike[:-1]).sum()) >= PATTERN


def _sampled(image: FloatImage, points: FloatArray) -> FloatArray:
    """Return the level at the pixel nearest to each point (..., 2), if it is in the image."""
    limit = np.array(image.shape[::-1]) - 1
    x, y = np.moveaxis(np.clip(np.rint(np.nan_to_num(points)), 0, limit).astype(int), -1, 0)
    levels: FloatArray = image[y, x].astype(np.float64)
    return levels
