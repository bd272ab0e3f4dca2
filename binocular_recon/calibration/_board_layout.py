# SPDX-License-Identifier: Apache-2.0
"""Tell which track is which rod, and which border which mark, from the board as a whole."""

from __future__ import annotations

from itertools import combinations
from typing import NamedTuple

import cv2
import numpy as np

from binocular_recon.calibration._layout_kernels import NONE, score_layout
from binocular_recon.calibration._rod_search import Track
from binocular_recon.calibration.rods import RodBoard
from binocular_recon.camera import FloatArray

# Best tracks that may serve as the two rods a board is built on.
ANCHORS = 14
# Best tracks that may serve as its other rods.
CANDIDATES = 80
# Rods stand this far off their place at most, besides four of the board's own sigmas, m.
ASTRAY_M = 0.06
# Largest deviation of a track's borders from even heights, as a share of a spacing.
CROOKED = 0.12
# Apparent spacing of two rods against their distance at the rods' own scale.
NARROWEST, WIDEST = 0.2, 1.3


class Anchor(NamedTuple):
    """A track taken as a rod with its lowest border at a certain mark."""

    track: int
    ends: FloatArray  # bottom and top x, y, px per metre: (5,)


def identify(
    tracks: list[Track], board: RodBoard, size: tuple[int, int]
) -> tuple[FloatArray, float]:
    """Choose the tracks that together look most like the board.

    Parameters
    ----------
    tracks : list of Track
        Candidates, the best first.
    board : RodBoard
        Places of the rods and heights of the marks.
    size : tuple of int
        Width and height of the picture, px.

    Returns
    -------
    marks_px : (R, M, 2) float64
        Rough positions of the marks found, px; NaN = not found. All NaN if no arrangement of the
        tracks looks like the board.
    width_px : float
        Typical width of the rods, px; NaN if there is none.

    """
    marks = np.full((board.count, board.marks_per_rod, 2), np.nan)
    anchors = [
        anchor for i, track in enumerate(tracks[:ANCHORS]) for anchor in _anchors(i, track, board)
    ]
    table = _border_table(tracks[:CANDIDATES])
    best = _best_single(anchors, table, board, size) if board.count == 1 else None
    if board.count > 1:
        best = _best_pair(anchors, table, board, size)
    if best is None:
        return marks, np.nan
    chosen, indices = best
    widths = []
    for rod, t in enumerate(chosen):
        if t != NONE:
            known = indices[rod] != NONE
            marks[rod, indices[rod][known]] = tracks[t].points_px[known]
            widths.append(tracks[t].width_px)
    return marks, float(np.median(widths))


def lateral_limit_m(board: RodBoard) -> float:
    """Return how far sideways a rod may be from where the others put it, m."""
    limit = ASTRAY_M + 4 * float(
        np.hypot(board.placement_sigma_m, board.tilt_sigma_rad * board.marks_m[-1])
    )
    if board.count > 1:
        limit = min(limit, 0.3 * float(np.diff(board.rods_xz_m[:, 0]).min()))
    return limit


def board_homography(board: RodBoard, marks_px: FloatArray) -> FloatArray | None:
    """Return the homography from the board's plane (x, y) to the picture: (3, 3) float64.

    None if fewer than two rods have two marks each.
    """
    found = np.isfinite(marks_px[..., 0])
    if (found.sum(1) >= 2).sum() < 2:
        return None
    world = board.world_points()[..., :2][found]
    matrix = cv2.findHomography(world, marks_px[found], 0)[0]
    return None if matrix is None else np.asarray(matrix, np.float64)


def project_plane(matrix: FloatArray, points: FloatArray) -> FloatArray:
    """Map points (..., 2) by a homography; NaN where they are behind the camera."""
    mapped = points @ matrix[:, :2].T + matrix[:, 2]
    depth = mapped[..., 2:]
    ahead = depth * np.sign(np.median(depth)) > 0
    projected: FloatArray = np.where(ahead, mapped[..., :2] / np.where(ahead, depth, 1.0), np.nan)
    return projected


def _border_table(tracks: list[Track]) -> FloatArray:
    """Return x, y and sign of the tracks' borders: (T, M, 3), NaN = none."""
    table = np.full((len(tracks), len(tracks[0].points_px) if tracks else 0, 3), np.nan)
    for t, track in enumerate(tracks):
        table[t, :, :2] = track.points_px
        table[t, ::2, 2], table[t, 1::2, 2] = 1, -1
    return table


def _anchors(index: int, track: Track, board: RodBoard) -> list[Anchor]:
    """Return the ways in which a track's marks may be the board's: shifted by pairs of marks."""
    heights, found = board.marks_m, np.nonzero(track.found)[0]
    points = track.points_px[found]
    ways = []
    for shift in range(-found[0] + found[0] % 2, len(heights) - found[-1], 2):
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


def _limits(board: RodBoard, size: tuple[int, int], width_px: float) -> FloatArray:
    margin = 4.0
    return np.array([size[0] - margin, size[1] - margin, lateral_limit_m(board), width_px / 2])


def _best_pair(
    anchors: list[Anchor], table: FloatArray, board: RodBoard, size: tuple[int, int]
) -> tuple[FloatArray, FloatArray] | None:
    """Try every two tracks as every two rods; return tracks and marks of the best board."""
    x = board.rods_xz_m[:, 0]
    limits = _limits(board, size, 4.0)
    best, best_score = None, 0.0
    chosen = np.empty(board.count, np.int64)
    indices = np.empty((board.count, table.shape[1]), np.int64)
    for one, other in combinations(anchors, 2):
        left, right = (one, other) if one.ends[0] < other.ends[0] else (other, one)
        scale = np.sqrt(left.ends[4] * right.ends[4])
        apart_m = np.hypot(*(right.ends[:2] - left.ends[:2])) / scale
        if one.track == other.track or not 0.5 < left.ends[4] / right.ends[4] < 2:
            continue
        ends = np.stack([left.ends, right.ends])
        for rods in combinations(range(board.count), 2):
            if not NARROWEST < apart_m / (x[rods[1]] - x[rods[0]]) < WIDEST:
                continue
            score = score_layout(
                table, ends, rods, x, board.marks_m, limits, chosen, indices
            )
            if score > best_score:
                best, best_score = (chosen.copy(), indices.copy()), score
    return best


def _best_single(
    anchors: list[Anchor], table: FloatArray, board: RodBoard, size: tuple[int, int]
) -> tuple[FloatArray, FloatArray] | None:
    """Return track and marks of the best rod of a board that has only one."""
    best, best_score = None, 0.0
    chosen = np.empty(1, np.int64)
    indices = np.empty((1, table.shape[1]), np.int64)
    x = np.array([0.0])
    for anchor in anchors:
        ends = np.stack([anchor.ends, anchor.ends])
        score = score_layout(
            table[anchor.track : anchor.track + 1], ends, (0, 0), x, board.marks_m,
            _limits(board, size, 4.0), chosen, indices,
        )  # fmt: skip
        if score > best_score:
            best, best_score = (np.array([anchor.track]), indices.copy()), score
    return best
