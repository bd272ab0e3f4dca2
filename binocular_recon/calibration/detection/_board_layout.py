# SPDX-License-Identifier: Apache-2.0
"""Tell which track is which rod, and which edge which mark, from the board as a whole."""

from __future__ import annotations

from itertools import combinations
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from binocular_recon.calibration.detection._layout_kernels import NONE, score_layout
from binocular_recon.calibration.detection._rod_search import Track
from binocular_recon.calibration.target.board_plane import lateral_limit_m
from binocular_recon.calibration.target.rods import RodBoard
from binocular_recon.camera import FloatArray

IntArray = npt.NDArray[np.int64]

# Best tracks that may serve as the two rods a board is built on.
ANCHORS = 14
# Best tracks that may serve as its other rods.
CANDIDATES = 80
# Largest deviation of a track's edges from even heights, as a share of a spacing.
CROOKED = 0.12
# Apparent spacing of two rods against their distance at the rods' own scale.
NARROWEST, WIDEST = 0.2, 1.3
# Rods stand upright on the row: largest cosine between the two in an image (perspective).
MAX_SKEW = 0.7


class Anchor(NamedTuple):
    """A track taken as a rod with its lowest edge at a certain mark."""

    track: int
    ends: FloatArray  # bottom and top x, y, px per metre: (5,)


class Layout(NamedTuple):
    """Tracks that together look like the board.

    ``marks_px`` (R, M, 2): rough positions of the marks found, NaN = not found; ``width_px``: the
    usual width of the rods; ``tracks``: indices of the tracks.
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
    table = _edge_table(tracks)
    looks = np.array([_looks(track) for track in tracks])
    search = _best_single if board.count == 1 else _best_pair
    best = search(anchors, table, looks, board, size)
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


def _edge_table(tracks: list[Track]) -> FloatArray:
    """Return x, y and sign of the tracks' edges: (T, M, 3), NaN = none."""
    table = np.full((len(tracks), len(tracks[0].points_px) if tracks else 0, 3), np.nan)
    for t, track in enumerate(tracks):
        table[t, :, :2] = track.points_px
        table[t, ::2, 2], table[t, 1::2, 2] = 1, -1
    return table


def _anchors(index: int, track: Track, board: RodBoard) -> list[Anchor]:
    """Return the ways in which a track's marks may be the board's: shifted by pairs of marks.

    One edge may fall off: a foot on light ground or a top before the sky looks like one.
    """
    heights, edges = board.marks_m, np.nonzero(track.found)[0]
    ways = []
    for shift in range(-(len(heights) // 2) * 2, len(heights), 2):
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
        if crooked > CROOKED * scale * np.diff(heights).min() + 1:
            continue
        ends = [middle + (heights[k] - h.mean()) * slope for k in (0, -1)]
        ways.append(Anchor(index, np.array([*ends[0], *ends[1], scale])))
    return ways


def _looks(track: Track) -> tuple[float, float, float]:
    """Return how much a track looks like a rod, the logarithm of its step and of its width."""
    step = float(np.nanmean(track.steps))
    return track.score / track.found.sum(), float(np.log(step)), float(np.log(track.width_px))


def _limits(board: RodBoard, size: tuple[int, int], step: float) -> FloatArray:
    """Return the limits of score_layout for rods with the logarithm of the step ``step``."""
    margin, lateral_px = 4.0, 2.0
    return np.array(
        [
            size[0] - margin,
            size[1] - margin,
            lateral_limit_m(board),
            lateral_px,
            step,
            np.log(board.rod_diameter_m),
        ]
    )


def _best_pair(
    anchors: list[Anchor],
    table: FloatArray,
    looks: FloatArray,
    board: RodBoard,
    size: tuple[int, int],
) -> tuple[IntArray, IntArray] | None:
    """Try every two tracks as every two rods; return tracks and marks of the best board."""
    row = board.row_m
    best, best_score = None, 0.0
    chosen = np.empty(board.count, np.int64)
    indices = np.empty((board.count, table.shape[1]), np.int64)
    for one, other in combinations(anchors, 2):
        left, right = (one, other) if one.ends[0] < other.ends[0] else (other, one)
        scale = np.sqrt(left.ends[4] * right.ends[4])
        apart_m = np.hypot(*(right.ends[:2] - left.ends[:2])) / scale
        sides = left.ends[:4].reshape(2, 2), right.ends[:4].reshape(2, 2)
        if (
            one.track == other.track
            or _skew(*sides) > MAX_SKEW
            or not 0.5 < left.ends[4] / right.ends[4] < 2
        ):
            continue
        ends = np.stack([left.ends, right.ends])
        step = 0.5 * (looks[left.track, 1] + looks[right.track, 1])
        limits = _limits(board, size, step)
        for rods in combinations(range(board.count), 2):
            if not NARROWEST < apart_m / np.hypot(*(row[rods[1]] - row[rods[0]])) < WIDEST:
                continue
            score = score_layout(
                table, looks, ends, rods, row, board.marks_m, limits, chosen, indices
            )
            if score > best_score:
                best, best_score = (chosen.copy(), indices.copy()), score
    return best


def _best_single(
    anchors: list[Anchor],
    table: FloatArray,
    looks: FloatArray,
    board: RodBoard,
    size: tuple[int, int],
) -> tuple[IntArray, IntArray] | None:
    """Return track and marks of the best rod of a board that has only one."""
    best, best_score = None, 0.0
    chosen = np.empty(1, np.int64)
    indices = np.empty((1, table.shape[1]), np.int64)
    row = np.zeros((1, 2))
    for anchor in anchors:
        ends = np.stack([anchor.ends, anchor.ends])
        one = slice(anchor.track, anchor.track + 1)
        score = score_layout(
            table[one], looks[one], ends, (0, 0), row, board.marks_m,
            _limits(board, size, looks[anchor.track, 1]), chosen, indices,
        )  # fmt: skip
        if score > best_score:
            best, best_score = (np.array([anchor.track]), indices.copy()), score
    return best


def _skew(first: FloatArray, last: FloatArray) -> float:
    """Return the cosine between two rods (lowest and highest mark) and the row they stand in."""
    row = last[[0, -1]].mean(0) - first[[0, -1]].mean(0)
    up = last[-1] - last[0] + first[-1] - first[0]
    return float(abs(row @ up) / max(np.linalg.norm(row) * np.linalg.norm(up), 1e-9))
