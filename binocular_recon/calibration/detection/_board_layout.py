# SPDX-License-Identifier: Apache-2.0
"""Decide which track is which rod and which edge is which mark, from the board as a whole."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import combinations
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from binocular_recon.calibration.detection._layout_kernels import NONE, score_layout
from binocular_recon.calibration.detection._rod_search import Track
from binocular_recon.calibration.target.board_plane import lateral_limit_m
from binocular_recon.calibration.target.mark_types import PERIOD
from binocular_recon.calibration.target.rods import RodBoard
from binocular_recon.camera import FloatArray

IntArray = npt.NDArray[np.int64]

# So many of the best tracks are tried as the two rods that place the board.
ANCHORS = 14
# So many are tried as its other rods.
CANDIDATES = 80
# Largest deviation of a track's edges from the marks' spacing, as a share of a spacing.
MAX_CROOKED = 0.12
# Apparent distance of two rods against the true one, at the rods' own scale.
MIN_APART, MAX_APART = 0.2, 1.3
# Largest cosine between rods and row in an image: they are square in space.
MAX_SKEW = 0.7


class Anchor(NamedTuple):
    """A track taken for a rod, with its lowest edge at a certain mark."""

    track: int
    ends: FloatArray  # bottom and top x, y, px per metre: (5,)


class Hypothesis(NamedTuple):
    """Two tracks taken for two rods, which place the whole board.

    ``ends`` (2, 5) of the two anchors; ``rods``: which rods they are; ``tracks``: which tracks may
    be rods; ``limits`` (6,) of `score_layout`. A board's only rod is entered twice.
    """

    ends: FloatArray
    rods: tuple[int, int]
    tracks: slice
    limits: FloatArray


class Layout(NamedTuple):
    """Tracks that together look like the board.

    ``marks_px`` (R, M, 2): rough positions of the marks found, NaN = not found; ``width_px``:
    median width of the rods; ``tracks``: indices of the tracks.
    """

    marks_px: FloatArray
    width_px: float
    tracks: frozenset[int]


def identify(tracks: list[Track], board: RodBoard, size: tuple[int, int]) -> Layout | None:
    """Choose the tracks that together look most like the board.

    Parameters
    ----------
    tracks : list of Track
        Candidates, the best first.
    board : RodBoard
        Places of the rods and heights of the marks.
    size : tuple of int
        Width and height of the image, px.

    Returns
    -------
    Layout or None
        None if no arrangement of the tracks looks like the board.

    """
    marks = np.full((board.count, board.marks_per_rod, 2), np.nan)
    anchors = [
        anchor for i, track in enumerate(tracks[:ANCHORS]) for anchor in _anchors(i, track, board)
    ]
    tracks = tracks[:CANDIDATES]
    table = _edge_table(tracks, board)
    looks = np.array([_appearance(track) for track in tracks])
    best = _best(_hypotheses(anchors, looks, board, size), table, looks, board)
    if best is None:
        return None
    chosen, indices = best
    widths = []
    for rod, t in enumerate(chosen):
        if t != NONE:
            known = indices[rod] != NONE
            marks[rod, indices[rod][known]] = tracks[t].points_px[known]
            widths.append(tracks[t].width_px)
    return Layout(marks, float(np.median(widths)), frozenset(chosen.tolist()) - {NONE})


def _edge_table(tracks: list[Track], board: RodBoard) -> FloatArray:
    """Return x, y and sign of the tracks' edges: (T, M, 3), NaN = none; positive: dark below."""
    table = np.full((len(tracks), board.marks_per_rod if tracks else 0, 3), np.nan)
    for t, track in enumerate(tracks):
        table[t, :, :2] = track.points_px
        table[t, :, 2] = np.where(board.dark_below, 1, -1)
    return table


def _anchors(index: int, track: Track, board: RodBoard) -> list[Anchor]:
    """Return the track as a rod, with its edges at the marks or shifted by whole periods.

    One edge may fall off: a foot on light ground, or a top against the sky, looks like one.
    """
    heights, edges = board.marks_m, np.nonzero(track.found)[0]
    anchors = []
    for shift in range(-(len(heights) // PERIOD) * PERIOD, len(heights), PERIOD):
        found = edges[(edges + shift >= 0) & (edges + shift < len(heights))]
        if len(found) < max(2, len(edges) - 1):
            continue
        points = track.points_px[found]
        h = heights[found + shift]
        spread = h - h.mean()
        slope = spread @ points / (spread @ spread)
        middle = points.mean(0)
        crooked = np.linalg.norm(points - middle - spread[:, None] * slope, axis=1).max()
        scale = float(np.linalg.norm(slope))
        if crooked > MAX_CROOKED * scale * np.diff(heights).min() + 1:
            continue
        ends = [middle + (heights[k] - h.mean()) * slope for k in (0, -1)]
        anchors.append(Anchor(index, np.array([*ends[0], *ends[1], scale])))
    return anchors


def _appearance(track: Track) -> tuple[float, float, float]:
    """Return how much a track looks like a rod, and the logarithms of its step and width."""
    step = float(np.nanmean(track.steps))
    return track.score / track.found.sum(), float(np.log(step)), float(np.log(track.width_px))


def _limits(board: RodBoard, size: tuple[int, int]) -> FloatArray:
    """Return the limits of `score_layout`; 0 in place of the rods' usual step."""
    margin, lateral_px = 4.0, 2.0
    return np.array(
        [
            size[0] - margin,
            size[1] - margin,
            lateral_limit_m(board),
            lateral_px,
            0.0,
            np.log(board.rod_diameter_m),
        ]
    )


def _hypotheses(
    anchors: list[Anchor], looks: FloatArray, board: RodBoard, size: tuple[int, int]
) -> Iterator[Hypothesis]:
    """Yield each pair of tracks as each pair of rods; for a board with one rod, each track."""
    limits = _limits(board, size)
    if board.count == 1:
        for anchor in anchors:
            ends = np.stack([anchor.ends, anchor.ends])
            only = slice(anchor.track, anchor.track + 1)
            yield Hypothesis(ends, (0, 0), only, _with_step(limits, looks[anchor.track, 1]))
        return
    row = board.row_m
    pairs = [
        (rods, np.hypot(*(row[rods[1]] - row[rods[0]])))
        for rods in combinations(range(board.count), 2)
    ]
    for one, other in combinations(anchors, 2):
        left, right = (one, other) if one.ends[0] < other.ends[0] else (other, one)
        if one.track == other.track or not 0.5 < left.ends[4] / right.ends[4] < 2:
            continue
        sides = left.ends[:4].reshape(2, 2), right.ends[:4].reshape(2, 2)
        if _skew(*sides) > MAX_SKEW:
            continue
        scale = np.sqrt(left.ends[4] * right.ends[4])
        apart_m = np.hypot(*(right.ends[:2] - left.ends[:2])) / scale
        ends = np.stack([left.ends, right.ends])
        stepped = _with_step(limits, 0.5 * (looks[left.track, 1] + looks[right.track, 1]))
        for rods, gap_m in pairs:
            if MIN_APART < apart_m / gap_m < MAX_APART:
                yield Hypothesis(ends, rods, slice(0, len(looks)), stepped)


def _with_step(limits: FloatArray, step: float) -> FloatArray:
    """Return limits with the logarithm of the rods' step."""
    limits = limits.copy()
    limits[4] = step
    return limits


def _best(
    hypotheses: Iterable[Hypothesis], table: FloatArray, looks: FloatArray, board: RodBoard
) -> tuple[IntArray, IntArray] | None:
    """Return the track of each rod, (R,), and the mark of each of its edges, (R, M)."""
    row, marks, dark_below = board.row_m, board.marks_m, board.dark_below
    best, best_score = None, 0.0
    chosen = np.empty(board.count, np.int64)
    indices = np.empty((board.count, table.shape[1]), np.int64)
    for ends, rods, tracks, limits in hypotheses:
        score = score_layout(
            table[tracks], looks[tracks], ends, rods, row, marks, dark_below, limits, chosen,
            indices,
        )  # fmt: skip
        if score > best_score:
            known = np.where(chosen == NONE, NONE, chosen + tracks.start)
            best, best_score = (known, indices.copy()), score
    return best


def _skew(first: FloatArray, last: FloatArray) -> float:
    """Return the cosine between two rods (lowest and highest mark) and the line through them."""
    row = 0.5 * (last[0] + last[-1]) - 0.5 * (first[0] + first[-1])
    up = last[-1] - last[0] + first[-1] - first[0]
    return float(abs(row @ up) / max(np.linalg.norm(row) * np.linalg.norm(up), 1e-9))
