# SPDX-License-Identifier: Apache-2.0
"""Decide which rods and heights the marks are: a wrong identity is worse than a missing mark.

With even spacing, a part of a board looks the same shifted by a rod or by two marks, and every
other rod looks like a board turned farther. Each possible reading predicts further marks, which
are in the image or not.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from binocular_recon.calibration.detection._board_layout import MAX_CROOKED
from binocular_recon.calibration.detection._guided_search import Averaged, complete
from binocular_recon.calibration.detection._refinement import Refined, refine
from binocular_recon.calibration.target.board_plane import (
    inside_image,
    lateral_limit_m,
    plane_marks,
    predict_marks,
    slant,
)
from binocular_recon.calibration.target.mark_types import PERIOD
from binocular_recon.calibration.target.rods import RodBoard
from binocular_recon.camera import FloatArray
from binocular_recon.images import FloatImage

IntArray = npt.NDArray[np.int64]

# An identity must beat every other one by this many marks (missing ones count half).
CLEAR_MARGIN = 2.0
# The same, with feet that another identity takes for marks counted as explained.
FEET_MARGIN = 1.0
# Marks nearer to the image border than this may be missed, px.
BORDER_MARGIN_PX = 4.0
# Share of the marks found that another identity must have too.
MIN_KEPT = 0.6
# Rods are put up square to their row, on ground that slopes by less than 17 degrees.
MAX_SLANT = 0.3
# What a slant of 1 costs an identity, in marks.
SLANT_COST = 10.0
# An edge is a foot if it is this near to where the foot must be, as a share of the lowest spacing.
AT_FOOT = 0.15
# Marks are those of a board if they are this share of all between the lowest and the highest one
# of their rods, and this share of all that the image must show from the first to the last rod.
LEAST_ALONG, LEAST_BETWEEN = 0.6, 1 / 3
# Up to this share of a board's marks, they must lie in stretches of so many next to each other.
FEW_SHARE, LEAST_STRETCH = 0.5, 1.75
# Index of no rod, even after adding any shift.
NOWHERE = -1000


class Reading(NamedTuple):
    """One identity of the marks, with the further marks that it predicts.

    ``score``: number of marks explained less half the number missing; ``edges_px`` (R, M, 2): all
    marks it finds, NaN = none; ``feet_px`` (R, 2): where rods must end, within ``reach_px``;
    ``ends_px`` (N, 2): edges that turned out to be ends of rods.
    """

    marks_px: FloatArray
    score: float
    edges_px: FloatArray
    feet_px: FloatArray
    reach_px: float
    ends_px: FloatArray


def settle_identity(
    image: FloatImage, averaged: Averaged, board: RodBoard, refined: Refined
) -> FloatArray | None:
    """Return the marks with the identity that the image supports best; None if that is a tie.

    Parameters
    ----------
    image : (H, W) float32
        Grey levels.
    averaged : Averaged
        The same, averaged for the search of marks.
    board : RodBoard
        Positions of rods and marks.
    refined : Refined
        Marks under one identity. Its ``marks_px`` is returned itself if that is the best.
    """
    size, marks_px = (image.shape[1], image.shape[0]), refined.marks_px
    if np.isfinite(marks_px).all():
        return marks_px  # no other identity has a place for all of them
    identities = [marks_px, *other_identities(board, marks_px, size)]
    identities = [marks for marks in identities if slant(board, marks, size) < MAX_SLANT]
    if not identities:
        return None
    most = int(np.isfinite(marks_px[..., 0]).sum())
    readings: list[Reading] = []
    for marks in identities:
        # feet can add one mark per rod, not more
        least = max((r.score for r in readings), default=-np.inf) - board.count - CLEAR_MARGIN
        reading = _read(image, averaged, board, refined._replace(marks_px=marks), most, least)
        readings += [reading] if reading else []
    # where a rod ends, an identity should have its foot
    ends = np.concatenate([refined.ends_px, *(reading.ends_px for reading in readings)])
    scores = np.array([reading.score + _count_feet(reading, ends) for reading in readings])
    best = int(np.argmax(scores))
    # on light ground, what others take for marks may be the feet of the rods
    edges = np.concatenate([ends, *(reading.edges_px.reshape(-1, 2) for reading in readings)])
    with_feet = np.array([reading.score + _count_feet(reading, edges) for reading in readings])
    clear = all(
        (values[best] - np.delete(values, best) >= margin).all()
        for values, margin in ((scores, CLEAR_MARGIN), (with_feet, FEET_MARGIN))
    )
    return readings[best].marks_px if clear and scores[best] > 0 else None


def scattered(board: RodBoard, marks_px: FloatArray, size: tuple[int, int]) -> bool:
    """Return whether marks lie scattered, as in trees: with gaps, or with no rods in between.

    Few marks are it too if hardly any two are next to each other.

    Things that hide a board leave whole stretches of it.
    """
    found = np.isfinite(marks_px[..., 0])
    rods = np.flatnonzero(found.any(axis=1))
    above = np.logical_or.accumulate(found, axis=1)
    below = np.logical_or.accumulate(found[:, ::-1], axis=1)[:, ::-1]
    predicted = predict_marks(board, marks_px, plane_marks(board, marks_px, size))
    between = inside_image(predicted, size, BORDER_MARGIN_PX)[rods[0] : rods[-1] + 1]
    stretches = found[:, 0].sum() + (found[:, 1:] & ~found[:, :-1]).sum()
    return bool(
        (found.mean() <= FEW_SHARE and found.sum() < LEAST_STRETCH * stretches)
        or found.sum() < LEAST_ALONG * (above & below).sum()
        or found.sum() < LEAST_BETWEEN * between.sum()
    )


def other_identities(
    board: RodBoard, marks_px: FloatArray, size: tuple[int, int]
) -> Iterator[FloatArray]:
    """Yield the same marks as other rods or at other heights, where the spacing allows it.

    Some marks may fall off: feet on light ground that were taken for marks.
    """
    rods, marks = np.nonzero(np.isfinite(marks_px[..., 0]))
    if plane_marks(board, marks_px, size) is None and board.count > 1:
        return
    seen = np.unique(rods)
    moves = [
        np.stack([numbers[rods] - rods, np.full_like(rods, m)], -1)
        for numbers in _renumbered(board, seen)
        for m in (-PERIOD, 0, PERIOD)
        if m or (numbers[seen] != seen).any()
    ]
    if len(seen) == 2:
        # no third rod fixes the relative height of the two
        moves += [
            np.stack([0 * rods, m * (rods == r)], -1) for r in seen for m in (-PERIOD, PERIOD)
        ]
    for move in moves:
        r, m = rods + move[:, 0], marks + move[:, 1]
        exists = (r >= 0) & (r < board.count) & (m >= 0) & (m < board.marks_per_rod)
        if exists.mean() < MIN_KEPT:
            continue
        moved = np.full_like(marks_px, np.nan)
        moved[r[exists], m[exists]] = marks_px[rods[exists], marks[exists]]
        if _plausible(board, moved, size):
            yield moved


def _renumbered(board: RodBoard, seen: IntArray) -> Iterator[IntArray]:
    """Yield which rods the rods seen may be: (R,) int64 each, `NOWHERE` = none of the board's.

    Marks keep their heights, so the board can only be shifted and stretched along its row: every
    other rod of an even row looks like a row seen more from the side.
    """
    x, off = board.row_m.T
    if len(seen) < 2:
        yield np.arange(board.count)
        return
    # seen from the side, rods off the row appear elsewhere along it
    limit = lateral_limit_m(board) + float(np.ptp(off))
    # the rod at either end may be something else, or have no place
    ends = {(seen[0], seen[-1]), (seen[0], seen[-2]), (seen[1], seen[-1])}
    known: set[bytes] = set()
    for first, last in sorted(pair for pair in ends if pair[0] < pair[1]):
        for one, other in combinations(range(board.count), 2):
            places = x[one] + (x - x[first]) * (x[other] - x[one]) / (x[last] - x[first])
            gaps = np.abs(places[:, None] - x)
            numbers = np.where(gaps.min(1) < limit, gaps.argmin(1), NOWHERE)
            if numbers[seen].tobytes() not in known:
                known.add(numbers[seen].tobytes())
                yield numbers


def _plausible(board: RodBoard, marks_px: FloatArray, size: tuple[int, int]) -> bool:
    """Return whether the marks fit the board's spacing."""
    found = np.isfinite(marks_px[..., 0])
    plane = plane_marks(board, marks_px, size)
    if plane is None:
        if board.count > 1 or found.sum() < 2:
            return False
        points, h = marks_px[found], board.marks_m[np.nonzero(found)[1]]
        fit = np.stack([np.polyval(np.polyfit(h, v, 1), h) for v in points.T], -1)
        scale = np.linalg.norm(points[-1] - points[0]) / (h[-1] - h[0])
        off = points - fit
    else:
        if not np.isfinite(plane).all():
            return False
        scale = np.median(np.linalg.norm(plane[:, -1] - plane[:, 0], axis=1))
        scale /= np.ptp(board.marks_m)
        off = marks_px[found] - plane[found]
    return bool(np.abs(off).max() < 2 * MAX_CROOKED * scale * np.diff(board.marks_m).min() + 2)


def _read(
    image: FloatImage,
    averaged: Averaged,
    board: RodBoard,
    refined: Refined,
    most: int,
    least: float,
) -> Reading | None:
    """Look for the further marks that an identity predicts.

    ``most`` is the number of marks before some fell off that this identity has no place for. None
    if the score cannot reach ``least``.
    """
    marks_px, size = refined.marks_px, (image.shape[1], image.shape[0])
    plane = plane_marks(board, marks_px, size)
    predicted = predict_marks(board, marks_px, plane)
    expected = int(inside_image(predicted, size, BORDER_MARGIN_PX).sum())
    penalty = 0.5 * (most - int(np.isfinite(marks_px[..., 0]).sum()))
    penalty += SLANT_COST * slant(board, marks_px, size)

    def score(marks: FloatArray) -> float:
        found = int(np.isfinite(marks[..., 0]).sum())
        return found - 0.5 * max(0, expected - found) - penalty

    more = complete(averaged, board, marks_px, predicted)
    if score(more) < least:
        return None
    edges, ends = marks_px.copy(), np.empty((0, 2))
    new = np.isfinite(more[..., 0]) & ~np.isfinite(marks_px[..., 0])
    if new.any():
        only_new = np.where(new[..., None], more, np.nan)
        added = refine(image, board, only_new, predicted, plane, refined.levels)
        edges = np.where(np.isfinite(added.marks_px), added.marks_px, edges)
        ends = added.ends_px
    heights = board.marks_m
    step = (predicted[:, 1] - predicted[:, 0]) / (heights[1] - heights[0])
    feet = predicted[:, 0] - heights[0] * step
    reach = AT_FOOT * float(
        np.nanmedian(np.linalg.norm(predicted[:, 1] - predicted[:, 0], axis=1))
    )
    return Reading(marks_px, score(edges), edges, feet, reach, ends)


def _count_feet(reading: Reading, edges_px: FloatArray) -> int:
    """Return how many feet of a reading lie at one of the edges (N, 2)."""
    gaps = np.linalg.norm(edges_px - reading.feet_px[:, None], axis=2)
    return int((np.nanmin(gaps, axis=1, initial=np.inf) < reading.reach_px).sum())
