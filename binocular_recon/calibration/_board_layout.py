# SPDX-License-Identifier: Apache-2.0
"""Tell which track is which rod, and which border which mark, from the board as a whole."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations
from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from binocular_recon.calibration._layout_kernels import NONE, score_layout
from binocular_recon.calibration._rod_search import Track
from binocular_recon.calibration.rods import RodBoard
from binocular_recon.camera import FloatArray

IntArray = npt.NDArray[np.int64]

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
# Rods of a board differ in scale by less than this.
MOST_SCALE = 4.0
# Share of the marks found that another identity must have too.
FEWEST_KEPT = 0.7
# Rods stand upright on the row: largest cosine between the two in a picture (perspective).
MOST_SKEW = 0.7


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
    tracks = tracks[:CANDIDATES]
    table = _border_table(tracks)
    looks = np.array([_looks(track) for track in tracks])
    search = _best_single if board.count == 1 else _best_pair
    best = search(anchors, table, looks, board, size)
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


def plane_marks(board: RodBoard, marks_px: FloatArray) -> FloatArray | None:
    """Return where the plane of the board that fits the marks found puts every mark.

    (R, M, 2) float64, NaN behind the camera. None if fewer than two rods have two marks each.
    """
    found = np.isfinite(marks_px[..., 0])
    if (found.sum(1) >= 2).sum() < 2:
        return None
    world = board.world_points()[..., :2]
    matrix = cv2.findHomography(world[found], marks_px[found], 0)[0]
    if matrix is None:
        return None
    mapped = world @ matrix[:, :2].T + matrix[:, 2]
    depth = mapped[..., 2:]
    ahead = depth * np.sign(np.median(depth[found])) > 0
    projected: FloatArray = np.where(ahead, mapped[..., :2] / np.where(ahead, depth, 1.0), np.nan)
    length = np.linalg.norm(projected[:, -1] - projected[:, 0], axis=1)
    usual = np.nanmedian(length[found.any(1)])
    # beyond the vanishing point or so near that no rig sees it
    far = ~((length > usual / MOST_SCALE) & (length < usual * MOST_SCALE))
    projected[far] = np.nan
    return projected


def other_identities(board: RodBoard, marks_px: FloatArray) -> Iterator[FloatArray]:
    """Yield the same marks as other rods or at other heights, where the spacings allow it.

    With even spacing a board of which a part is seen may be shifted by a rod, or by two marks.
    Some marks may fall off: feet on light ground that were taken for marks.
    """
    rods, marks = np.nonzero(np.isfinite(marks_px[..., 0]))
    plane = plane_marks(board, marks_px)
    if plane is None and board.count > 1:
        return
    seen = sorted(set(rods))
    moves = [
        np.tile((r, m), (len(rods), 1)) for r in (-2, -1, 0, 1, 2) for m in (-2, 0, 2) if r or m
    ]
    if len(seen) == 2:
        # nothing else tells how high the two are against each other
        moves += [np.stack([0 * rods, m * (rods == r)], -1) for r in seen for m in (-2, 2)]
    for move in moves:
        r, m = rods + move[:, 0], marks + move[:, 1]
        exists = (r >= 0) & (r < board.count) & (m >= 0) & (m < board.marks_per_rod)
        if exists.mean() < FEWEST_KEPT:
            continue
        moved = np.full_like(marks_px, np.nan)
        moved[r[exists], m[exists]] = marks_px[rods[exists], marks[exists]]
        if _plausible(board, moved):
            yield moved


def _plausible(board: RodBoard, marks_px: FloatArray) -> bool:
    """Return whether the marks lie like the board's, upright and evenly."""
    found = np.isfinite(marks_px[..., 0])
    plane = plane_marks(board, marks_px)
    if plane is None:
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
        if _skew(plane[0], plane[-1]) > MOST_SKEW:
            return False
    return bool(np.abs(off).max() < 2 * CROOKED * scale * np.diff(board.marks_m).min() + 2)


def _skew(first: FloatArray, last: FloatArray) -> float:
    """Return the cosine between two rods (lowest and highest mark) and the row they stand in."""
    row = last[[0, -1]].mean(0) - first[[0, -1]].mean(0)
    up = last[-1] - last[0] + first[-1] - first[0]
    return float(abs(row @ up) / max(np.linalg.norm(row) * np.linalg.norm(up), 1e-9))


def expected_in_picture(
    predicted_px: FloatArray, size: tuple[int, int], margin_px: float
) -> npt.NDArray[np.bool_]:
    """Return which marks should be in the picture, (R, M) bool."""
    limit = np.array(size) - 1 - margin_px
    with np.errstate(invalid='ignore'):
        inside: npt.NDArray[np.bool_] = np.all(
            (predicted_px >= margin_px) & (predicted_px <= limit), -1
        )
    return inside


def _border_table(tracks: list[Track]) -> FloatArray:
    """Return x, y and sign of the tracks' borders: (T, M, 3), NaN = none."""
    table = np.full((len(tracks), len(tracks[0].points_px) if tracks else 0, 3), np.nan)
    for t, track in enumerate(tracks):
        table[t, :, :2] = track.points_px
        table[t, ::2, 2], table[t, 1::2, 2] = 1, -1
    return table


def _anchors(index: int, track: Track, board: RodBoard) -> list[Anchor]:
    """Return the ways in which a track's marks may be the board's: shifted by pairs of marks.

    One border may fall off: a foot on light ground or a top before the sky looks like one.
    """
    heights, borders = board.marks_m, np.nonzero(track.found)[0]
    ways = []
    for shift in range(-(len(heights) // 2) * 2, len(heights), 2):
        found = borders[(borders + shift >= 0) & (borders + shift < len(heights))]
        if len(found) < max(2, len(borders) - 1):
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
    x = board.rods_xz_m[:, 0]
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
            or _skew(*sides) > MOST_SKEW
            or not 0.5 < left.ends[4] / right.ends[4] < 2
        ):
            continue
        ends = np.stack([left.ends, right.ends])
        step = 0.5 * (looks[left.track, 1] + looks[right.track, 1])
        limits = _limits(board, size, step)
        for rods in combinations(range(board.count), 2):
            if not NARROWEST < apart_m / (x[rods[1]] - x[rods[0]]) < WIDEST:
                continue
            score = score_layout(
                table, looks, ends, rods, x, board.marks_m, limits, chosen, indices
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
    x = np.array([0.0])
    for anchor in anchors:
        ends = np.stack([anchor.ends, anchor.ends])
        one = slice(anchor.track, anchor.track + 1)
        score = score_layout(
            table[one], looks[one], ends, (0, 0), x, board.marks_m,
            _limits(board, size, looks[anchor.track, 1]), chosen, indices,
        )  # fmt: skip
        if score > best_score:
            best, best_score = (np.array([anchor.track]), indices.copy()), score
    return best
