# SPDX-License-Identifier: Apache-2.0
"""Look for further marks where the board predicts them."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import cv2
import numpy as np

from binocular_recon.calibration.detection._band_check import repeated
from binocular_recon.calibration.detection._layout_kernels import BESIDE
from binocular_recon.calibration.detection._refinement import Refined, refine
from binocular_recon.calibration.detection._search_kernels import search_line
from binocular_recon.calibration.target.board_plane import (
    inside_image,
    lateral_limit_m,
    plane_marks,
    predict_marks,
)
from binocular_recon.calibration.target.mark_types import PERIOD
from binocular_recon.calibration.target.rods import RodBoard
from binocular_recon.camera import FloatArray
from binocular_recon.images import FloatImage, Mask

# Least agreement of the grey levels around a mark with those of the bands (1 = equal, 0 = no
# edge).
AGREEMENT = 0.45
# Least number of marks of a rod: a single one may be a corner of something else.
MIN_MARKS = 2
# A pattern goes on beyond a board if it shows more than this share of what would be there.
MOST_BEYOND = 0.5
# Something in front of the rod may come this near to an edge, px.
NEAR_RISE_PX = 2.0
# A rod with at most this share of its marks must stand and lean within so many standard
# deviations of where the others say. The stated ones, at least so large, m and rad, count as much
# as what so many rods show.
WEAK_SHARE, MOST_SIGMAS = 0.5, 4.0
LEAST_PLACE_M, LEAST_LEAN, STATED = 0.005, 0.005, 4


class Averaged(NamedTuple):
    """An image averaged over boxes that suit rods of one width, for the search of marks.

    ``middle``: boxes as long as 0.7 widths; ``near``: of three rows. ``rises_px`` (2,): how far
    below and above an edge the levels of each are compared.
    """

    middle: FloatImage
    near: FloatImage
    rises_px: FloatArray
    width_px: float

    @classmethod
    def of(cls, image: FloatImage, width_px: float) -> Averaged:
        """Average an image (H, W) for rods about ``width_px`` wide."""
        mid, tall = max(0, round(0.25 * width_px)), max(1, round(0.35 * width_px))
        middle = cv2.blur(image, (2 * mid + 1, 2 * tall + 1))
        near = cv2.blur(image, (2 * mid + 1, 3))
        return cls(middle, near, np.array([1.0 + tall, NEAR_RISE_PX]), width_px)


def complete(
    averaged: Averaged, board: RodBoard, marks_px: FloatArray, predicted: FloatArray
) -> FloatArray:
    """Add the marks that the image shows where the board predicts them.

    Parameters
    ----------
    averaged : Averaged
        The image.
    board : RodBoard
        Positions of rods and marks.
    marks_px : (R, M, 2) float64
        Marks found so far, px; NaN = not found.
    predicted : (R, M, 2) float64
        Where every mark should be, px; NaN = not known.

    Returns
    -------
    (R, M, 2) float64
        Those and the new ones, the new ones to about 2 px.

    """
    levels = _levels(averaged, board, marks_px, predicted)
    if levels is None:
        return marks_px
    completed = marks_px.copy()
    for rod in range(board.count):
        missing = ~np.isfinite(marks_px[rod, :, 0])
        if not missing.any() or not np.isfinite(predicted[rod]).all():
            continue
        known = int((~missing).sum())
        window = _window(board, predicted, rod, known, averaged.width_px)
        points = np.full((board.marks_per_rod, 2), np.nan)
        agreement = np.zeros(board.marks_per_rod)
        middle, near, rises, _ = averaged
        if known < 2:
            # a rod whose place is not known needs the larger boxes
            near, rises = middle, rises[[0, 0]]
        search_line(
            middle,
            near,
            predicted[rod],
            board.dark_below,
            window,
            levels,
            rises,
            points,
            agreement,
        )
        new = missing & (agreement > AGREEMENT)
        if missing.all() and new.sum() < MIN_MARKS:
            continue
        completed[rod, new] = points[new]
    return completed


def stray_rods(board: RodBoard, marks_px: FloatArray, size: tuple[int, int]) -> Mask:
    """Return which rods have a lone mark, or few marks where no rod can stand: (R,) bool.

    Of a rod that the image border cuts off, or something hides, the search may find something
    else beside it. Rods may stand, and lean, worse than stated as far as the others do.

    Parameters
    ----------
    board : RodBoard
        Positions of rods and marks.
    marks_px : (R, M, 2) float64
        Marks found, px; NaN = not found.
    size : (int, int)
        Width and height of the image, px.

    """
    found = np.isfinite(marks_px[..., 0]).sum(1)
    stray: Mask = found < MIN_MARKS
    tilt = max(board.tilt_sigma_rad, LEAST_LEAN)
    least = max(board.placement_sigma_m, LEAST_PLACE_M) + tilt * board.marks_m.mean(), tilt
    for rod in np.flatnonzero((found >= MIN_MARKS) & (found <= WEAK_SHARE * found.max())):
        others = np.flatnonzero((found > WEAK_SHARE * found.max()) & (found > MIN_MARKS))
        if len(others) < 3:
            continue
        known = np.full_like(marks_px, np.nan)
        known[others] = marks_px[others]
        plane = plane_marks(board, known, size)
        if plane is None or not np.isfinite(plane[rod]).all():
            continue
        off = np.array([_off(board, marks_px[one], plane[one]) for one in (*others, rod)])
        shown, free = np.sum(off[:-1] ** 2, axis=0), len(others) - 3
        usual = np.sqrt((shown + STATED * np.square(least)) / (free + STATED))
        # a projective map along the row is about as free as a parabola
        along = np.vander(board.row_m[:, 0] - board.row_m[others, 0].mean(), 3)
        weights = along[rod] @ np.linalg.pinv(along[others])
        sigmas = usual * np.sqrt(1 + weights @ weights)
        stray[rod] = bool(np.linalg.norm(off[-1] / sigmas) > MOST_SIGMAS)
    return stray


def _off(board: RodBoard, marks_px: FloatArray, plane_px: FloatArray) -> tuple[float, float]:
    """Return how far a rod's marks are beside their places, m, and how they lean, rad."""
    seen = np.isfinite(marks_px[:, 0])
    chord = plane_px[-1] - plane_px[0]
    scale = float(np.linalg.norm(chord)) / float(np.ptp(board.marks_m))
    across = np.array([-chord[1], chord[0]]) / np.linalg.norm(chord)
    aside = (marks_px - plane_px)[seen] @ across / scale
    lean, place = np.polyfit(board.marks_m[seen] - board.marks_m.mean(), aside, 1)
    return float(place), float(lean)


def goes_on(image: FloatImage, averaged: Averaged, board: RodBoard, refined: Refined) -> bool:
    """Return whether the pattern of a board goes on, as that of a facade or lattice does.

    Rods are unlike what is between them, and real rods and rows end. One more rod at the same
    distance, or two more marks on most rods, with the same levels and as sharp, are no chance.

    Parameters
    ----------
    image : (H, W) float32
        Grey levels.
    averaged : Averaged
        The same, averaged.
    board : RodBoard
        Positions of rods and marks.
    refined : Refined
        The marks of the identified board.

    """
    width, height = image.shape[1], image.shape[0]
    bands = averaged.rises_px[0], averaged.width_px
    if repeated(averaged.middle, *bands, board, refined.marks_px, refined.levels):
        return True
    extended = _extended(board)
    inner = np.s_[1:-1, PERIOD:-PERIOD]
    known = np.full((extended.count, extended.marks_per_rod, 2), np.nan)
    known[inner] = refined.marks_px
    plane = plane_marks(extended, known, (width, height))
    predicted = predict_marks(extended, known, plane)
    more = complete(averaged, extended, known, predicted)
    more[inner] = np.nan
    if not np.isfinite(more).any():
        return False
    measured = refine(image, extended, more, predicted, plane, refined.levels)
    found = np.isfinite(measured.marks_px[..., 0])
    seen = inside_image(predicted, (width, height), averaged.width_px)
    shares = [_share(seen[side, PERIOD:-PERIOD], found[side, PERIOD:-PERIOD]) for side in (0, -1)]
    rods = np.flatnonzero(np.isfinite(refined.marks_px[..., 0]).sum(1) > MIN_MARKS) + 1
    shares += [
        _share(np.atleast_1d(seen[rods, side].all(1)), np.atleast_1d(found[rods, side].all(1)))
        for side in (slice(PERIOD), slice(-PERIOD, None))
    ]
    return max(shares) > MOST_BEYOND


def _extended(board: RodBoard) -> RodBoard:
    """Return a board with one more rod to the left and right, `PERIOD` more marks up and down."""
    row, heights = board.rods_xz_m, board.marks_m
    apart = (row[-1] - row[0]) / max(board.count - 1, 1)
    spacing = np.ptp(heights) / (heights.size - 1)
    further = spacing * np.arange(1, PERIOD + 1)
    marks = np.concatenate([heights[0] - further[::-1], heights, heights[-1] + further])
    marks += PERIOD * spacing  # feet lower than the ground
    rods = np.concatenate([row[:1] - apart, row, row[-1:] + apart])
    return replace(board, rods_xz_m=rods, marks_m=marks)


def _share(seen: Mask, found: Mask) -> float:
    """Return the share of the places in view that show something; 0 of fewer than `MIN_MARKS`."""
    return float(found[seen].mean()) if seen.sum() >= MIN_MARKS else 0.0


def _levels(
    averaged: Averaged, board: RodBoard, marks_px: FloatArray, predicted: FloatArray
) -> FloatArray | None:
    """Return the grey levels of dark and light bands at the marks found: (2,) float64."""
    middle, rise = averaged.middle, averaged.rises_px[0]
    size = np.array(middle.shape[::-1]) - 1
    up = predicted[:, -1] - predicted[:, 0]
    up = up / np.linalg.norm(up, axis=1, keepdims=True)
    samples = []
    for mark, dark_below in enumerate(board.dark_below):
        for side in (-1, 1):
            points = marks_px[:, mark] + side * rise * up
            points = points[np.isfinite(points[:, 0])]
            x, y = np.clip(np.rint(points), 0, size).astype(int).T
            samples += [((side > 0) == dark_below, level) for level in middle[y, x]]
    dark = [level for light, level in samples if not light]
    light = [level for light, level in samples if light]
    if not dark or np.median(light) <= np.median(dark):
        return None
    return np.array([np.median(dark), np.median(light)])


def _window(
    board: RodBoard, everywhere: FloatArray, rod: int, found: int, width_px: float
) -> FloatArray:
    """Return how far to search sideways and along a rod, and the step of either, px: (4,)."""
    predicted = everywhere[rod]
    scale = float(np.linalg.norm(predicted[-1] - predicted[0])) / np.ptp(board.marks_m)
    gap = scale * float(np.diff(board.marks_m).min())
    if found == 0:
        apart = np.linalg.norm(everywhere[:, 0] - predicted[0], axis=1)
        apart[rod] = np.inf
        side = min(lateral_limit_m(board) * scale, BESIDE * float(np.nanmin(apart)))
        along = min(0.4 * gap, (4 * board.height_sigma_m + 0.02) * scale + 2)
    elif found == 1:
        side = 0.3 * width_px + 4 * board.tilt_sigma_rad * np.ptp(board.marks_m) * scale
        along = 2 + 0.05 * gap
    else:
        side, along = 0.3 * width_px, 1.5 + 0.04 * gap
    # the number of steps is limited, however far the window reaches
    return np.array([side, along, max(1.0, 0.25 * width_px, side / 10), max(1.0, along / 15)])
