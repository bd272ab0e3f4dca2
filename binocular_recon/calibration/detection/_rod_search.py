# SPDX-License-Identifier: Apache-2.0
"""Search for rods: short edges of bands, chained along straight lines with the marks' spacing."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from binocular_recon._jit import over_strips
from binocular_recon.calibration.detection._edge_kernels import (
    NONE,
    STEP,
    chain_edges,
    edge_response,
    mark_peaks,
)
from binocular_recon.calibration.target.rods import RodBoard
from binocular_recon.camera import FloatArray
from binocular_recon.images import FloatImage

# Widths of rods that the filters are made for, px of a pyramid level. Each level halves the image:
# together they cover 2.7 to 50 px.
FILTER_WIDTHS_PX = (3.5, 5.5)
LEVELS = 4
# The strongest edges kept at each width; a forest or a heap of gravel has 50 000.
MAX_EDGES = 20_000
# Number of tracks kept; an image with more is all clutter.
MAX_TRACKS = 100


class Track(NamedTuple):
    """A straight row of edges that may be a rod.

    ``points_px`` (M, 2), NaN where the row has a gap; where the spacing repeats, the indices of
    the marks are a guess. ``steps`` (M,): light less dark, grey levels. ``width_px``: of the
    filter that found it.
    """

    points_px: FloatArray
    steps: FloatArray
    width_px: float
    score: float

    @property
    def found(self) -> npt.NDArray[np.bool_]:
        """Which marks the row has, (M,)."""
        present: npt.NDArray[np.bool_] = np.isfinite(self.points_px[:, 0])
        return present


class Edges(NamedTuple):
    """Edges of one filter width, sorted by cells of a grid."""

    table: FloatArray
    first: npt.NDArray[np.int64]
    cell_px: float
    middle: FloatImage


def find_tracks(
    grey: FloatImage,
    board: RodBoard,
    threshold: float,
    leans: tuple[float, ...] = (0.0,),
    known: Sequence[Track] = (),
) -> list[Track]:
    """Return rows of edges that may be rods, the best first, one for each position.

    Parameters
    ----------
    grey : (H, W) float32
        Grey levels.
    board : RodBoard
        Heights of the marks and the rods' diameter.
    threshold : float
        Least step of an edge, grey levels.
    leans : tuple of float
        Slopes dx / dy of the rods to search; each finds rods up to 12 degrees off it, and up to
        20 degrees on a plain background.
    known : sequence of Track
        Rows found before, at other leans.

    """
    tracks = list(known)
    for lean in leans:
        tracks += _leaning_tracks(grey, board, threshold, lean)
    tracks.sort(key=lambda track: -track.score)
    return _each_place_once(tracks)


def _leaning_tracks(
    grey: FloatImage, board: RodBoard, threshold: float, lean: float
) -> list[Track]:
    """Return the tracks of rods with slope dx / dy near ``lean``, upright in a sheared image."""
    if not lean:
        return _upright_tracks(grey, board, threshold)
    height, width = grey.shape
    offset = lean * height if lean > 0 else 0.0
    shear = np.array([[1.0, -lean, offset], [0.0, 1.0, 0.0]])
    size = (width + int(abs(lean) * height) + 1, height)
    upright = cv2.warpAffine(grey, shear, size, borderMode=cv2.BORDER_REPLICATE)
    tracks = []
    for track in _upright_tracks(upright, board, threshold):
        points = track.points_px.copy()
        points[:, 0] += lean * points[:, 1] - offset
        tracks.append(track._replace(points_px=points))
    return tracks


def _upright_tracks(grey: FloatImage, board: RodBoard, threshold: float) -> list[Track]:
    """Return the tracks at every width."""
    tracks: list[Track] = []
    level, scale = grey, 1.0
    for _ in range(LEVELS):
        if min(level.shape) < 32:
            break
        for width in FILTER_WIDTHS_PX:
            edges = _find_edges(level, width, threshold)
            tracks += _chain(edges, board, width, scale)
        level, scale = cv2.pyrDown(level), 2 * scale
    return tracks


def _find_edges(level: FloatImage, width: float, threshold: float) -> Edges:
    """Filter one pyramid level for edges on rods about ``width`` wide."""
    # half sizes of the boxes on the rod and beside it, and their distances from the edge
    mid, side, tall = round(0.25 * width), round(0.2 * width), max(1, round(0.35 * width))
    reach, rise = round(0.5 * width) + 1 + side, 1 + tall
    middle = cv2.blur(level, (2 * mid + 1, 2 * tall + 1))
    beside = cv2.blur(level, (2 * side + 1, 2 * tall + 1))
    response = np.zeros_like(level)
    peak = np.zeros(level.shape, np.bool_)
    over_strips(edge_response, len(level), middle, beside, rise, reach, response, strip=64)
    radius = max(1, round(width / 3))
    over_strips(mark_peaks, len(level), response, threshold, radius, peak, strip=64)
    y, x = np.nonzero(peak)
    size = np.abs(response[y, x])
    if len(y) > MAX_EDGES:
        strongest = np.argpartition(-size, MAX_EDGES)[:MAX_EDGES]
        y, x = y[strongest], x[strongest]
    above, below = middle[y - rise, x], middle[y + rise, x]
    levels = np.maximum(above, below), np.minimum(above, below)
    table = np.stack([x, y, response[y, x], *levels], -1).astype(np.float64)
    cell = 2 * width
    rows, columns = int(level.shape[0] / cell) + 1, int(level.shape[1] / cell) + 1
    key = (y / cell).astype(np.int64) * (columns + 1) + (x / cell).astype(np.int64)
    order = np.argsort(key, kind='stable')
    first = np.searchsorted(key[order], np.arange(rows * (columns + 1)))
    return Edges(table[order], first.reshape(rows, columns + 1), cell, middle)


def _chain(edges: Edges, board: RodBoard, width: float, scale: float) -> list[Track]:
    """Return the tracks of one filter width in pixels of the whole image."""
    table = edges.table
    chains = np.full((len(table), board.marks_per_rod), NONE)
    counts = np.zeros(len(table), np.int64)
    chain_edges(
        table,
        edges.first,
        edges.cell_px,
        board.marks_m,
        board.dark_below,
        (width, width / board.rod_diameter_m),
        edges.middle,
        chains,
        counts,
    )
    chosen = chains[counts >= min(3, board.marks_per_rod)]
    if not len(chosen):
        return []
    present = chosen != NONE
    points = np.where(present[..., None], table[chosen, :2] * scale + (scale - 1) / 2, np.nan)
    steps = np.where(present, np.abs(table[chosen, STEP]), np.nan)
    scores = _scores(points, steps, present, board, width * scale)
    best = np.argsort(-scores, kind='stable')[: 3 * MAX_TRACKS]
    return [Track(points[i], steps[i], width * scale, float(scores[i])) for i in best]


def _scores(
    points: FloatArray,
    steps: FloatArray,
    present: npt.NDArray[np.bool_],
    board: RodBoard,
    width: float,
) -> FloatArray:
    """Return the number of marks of each track, reduced for uneven steps and crooked lines."""
    weight = present.astype(np.float64)
    count = weight.sum(1)
    heights = np.where(present, board.marks_m, 0.0)
    place = np.where(present[..., None], points, 0.0)
    mean_h = heights.sum(1) / count
    mean_p = place.sum(1) / count[:, None]
    dh = (board.marks_m - mean_h[:, None]) * weight
    dp = (place - mean_p[:, None]) * weight[..., None]
    slope = (dh[..., None] * dp).sum(1) / (dh**2).sum(1)[:, None]
    crooked = np.sqrt(((dp - dh[..., None] * slope[:, None]) ** 2).sum((1, 2)) / count)
    mean_step = np.nansum(steps, 1) / count
    uneven = np.sqrt(np.nansum((steps - mean_step[:, None]) ** 2, 1) / count) / mean_step
    scores: FloatArray = count / (1 + uneven**2 + (crooked / (0.3 * width)) ** 2)
    return scores


def _each_place_once(tracks: list[Track]) -> list[Track]:
    """Drop tracks that lie on the line of a better one."""
    kept: list[Track] = []
    # x at the top, slope, top, bottom and width of the lines kept
    lines = np.empty((MAX_TRACKS, 5))
    for track in tracks:
        points = track.points_px[track.found]
        (x0, y0), (x1, y1) = points[-1], points[0]  # marks run from the foot up
        slope = (x1 - x0) / (y1 - y0)
        x, tilt, top, bottom, width = lines[: len(kept)].T
        low, high = np.maximum(top, y0), np.minimum(bottom, y1)
        y = 0.5 * (low + high)
        gap = np.abs(x0 + slope * (y - y0) - x - tilt * (y - top))
        beside = high - low > 0.3 * np.minimum(bottom - top, y1 - y0)
        if (beside & (gap < 0.7 * np.maximum(width, track.width_px))).any():
            continue
        lines[len(kept)] = x0, slope, y0, y1, track.width_px
        kept.append(track)
        if len(kept) == MAX_TRACKS:
            break
    return kept
