# SPDX-License-Identifier: Apache-2.0
"""Kernels that decide which track is which rod of the board."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from binocular_recon._jit import inline_kernel, kernel
from binocular_recon.camera import FloatArray
from binocular_recon.images import Mask

IntArray = npt.NDArray[np.int64]

NONE = -1
# Cost of a mark that should be in the image but was not found, and of an edge that should
# not be there, against 1 for a mark explained.
MISSING, UNEXPLAINED = 0.3, 0.5
# Rods of a board are painted alike: standard deviation of the logarithm of a track's step. And the
# most by which the logarithms of a filter's and a rod's width differ.
STEP_RANGE, WIDTH_RANGE = 0.4, 0.6
# A rod is off sideways by less than this share of the distance to the next one.
BESIDE = 0.35
# Focal lengths of real cameras, as shares of the image's width.
MIN_FOCAL, MAX_FOCAL = 0.4, 5.0
# An edge may be off where two other rods predict the mark by this share of the spacing.
ALONG = 0.35


@inline_kernel
def off_plane(
    ends: FloatArray, apart_m: float, size: tuple[float, float]
) -> tuple[float, float, float]:
    """Return the image of one metre off the plane of two rods: homogeneous x, y and weight.

    ``ends`` as in `predict_rod`, of rods ``apart_m`` apart; ``size``: width and height of the
    image, px. The focal length follows from the known distance of the two rods. They are taken to
    be square to their row and to the optical axis.
    """
    cx, cy = 0.5 * (size[0] - 1), 0.5 * (size[1] - 1)
    w0, w1 = 1 / ends[0, 4], 1 / ends[1, 4]
    x0, y0 = 0.5 * (ends[0, 0] + ends[0, 2]) - cx, 0.5 * (ends[0, 1] + ends[0, 3]) - cy
    x1, y1 = 0.5 * (ends[1, 0] + ends[1, 2]) - cx, 0.5 * (ends[1, 1] + ends[1, 3]) - cy
    ax, ay = (w1 * x1 - w0 * x0) / apart_m, (w1 * y1 - w0 * y0) / apart_m
    change = (w1 - w0) / apart_m
    focal = math.sqrt(max(0.0, 1 - ax * ax - ay * ay)) / max(abs(change), 1e-9)
    focal = min(max(focal, MIN_FOCAL * size[0]), MAX_FOCAL * size[0])
    az = focal * change
    ux = ends[0, 2] + ends[1, 2] - ends[0, 0] - ends[1, 0]
    uy = ends[0, 3] + ends[1, 3] - ends[0, 1] - ends[1, 1]
    length = math.hypot(ux, uy)
    ux, uy = ux / length, uy / length
    weight = (ax * uy - ay * ux) / focal
    return -az * uy + cx * weight, az * ux + cy * weight, weight


@inline_kernel
def predict_rod(
    ends: FloatArray,
    place: tuple[float, float],
    off: tuple[float, float, float],
    predicted: FloatArray,
) -> bool:
    """Predict bottom and top x, y of a rod from two others; False if it is behind the camera.

    ``ends`` (2, 5): bottom and top x, y, px per metre of two rods; ``place``: position of the rod
    from the first (0) to the second (1) and its distance off their plane, m; ``off`` from
    `off_plane`. Points are weighted by their depths, the inverse of the scale.
    """
    w0, w1 = (1 - place[0]) / ends[0, 4], place[0] / ends[1, 4]
    total = w0 + w1 + place[1] * off[2]
    # nearer than a fifth of the known rods' distance: no board is that deep
    if total <= 0.2 * min(1 / ends[0, 4], 1 / ends[1, 4]):
        return False
    for k in range(4):
        outward = place[1] * off[k % 2]
        predicted[k] = (w0 * ends[0, k] + w1 * ends[1, k] + outward) / total
    return True


@inline_kernel
def _place(row: FloatArray, rods: tuple[int, int], r: int) -> tuple[float, float]:
    """Return the position of rod r relative to two others as `predict_rod` takes it."""
    first, last = rods
    ax, az = row[last, 0] - row[first, 0], row[last, 1] - row[first, 1]
    dx, dz = row[r, 0] - row[first, 0], row[r, 1] - row[first, 1]
    square = max(ax * ax + az * az, 1e-12)
    return (dx * ax + dz * az) / square, (dz * ax - dx * az) / math.sqrt(square)


@inline_kernel
def _match_track(
    track: FloatArray,
    predicted: FloatArray,
    marks: FloatArray,
    dark_below: Mask,
    lateral: float,
    indices: IntArray,
) -> tuple[int, int]:
    """Assign the edges of a track to the marks of a predicted rod; count those that fit or not.

    ``track`` (n, 3): x, y, sign of each edge, NaN = none. ``indices`` (n,) is written.
    """
    length = marks[-1] - marks[0]
    ax, ay = predicted[2] - predicted[0], predicted[3] - predicted[1]
    size = ax * ax + ay * ay
    explained = unexplained = 0
    last = NONE
    for j in range(track.shape[0]):
        indices[j] = NONE
        if math.isnan(track[j, 0]):
            continue
        bx, by = track[j, 0] - predicted[0], track[j, 1] - predicted[1]
        off = (bx * ay - by * ax) / math.sqrt(size)
        height = marks[0] + (bx * ax + by * ay) / size * length
        best, best_gap = NONE, 1e9
        for m in range(marks.size):
            if (track[j, 2] > 0) == dark_below[m] and abs(height - marks[m]) < best_gap:
                best, best_gap = m, abs(height - marks[m])
        if best == NONE:
            unexplained += 1
            continue
        gap = marks[best] - marks[best - 1] if best > 0 else marks[1] - marks[0]
        if best + 1 < marks.size:
            gap = min(gap, marks[best + 1] - marks[best])
        if abs(off) < lateral and best_gap < ALONG * gap and best > last:
            indices[j] = best
            last = best
            explained += 1
        else:
            unexplained += 1
    return explained, unexplained


@inline_kernel
def _far(track: FloatArray, predicted: FloatArray, lateral: float) -> bool:
    """Return whether the track's first edge is off the predicted rod sideways."""
    j = 0
    while math.isnan(track[j, 0]):
        j += 1
    ax, ay = predicted[2] - predicted[0], predicted[3] - predicted[1]
    off = (track[j, 0] - predicted[0]) * ay - (track[j, 1] - predicted[1]) * ax
    return bool(off * off > lateral * lateral * (ax * ax + ay * ay))


@inline_kernel
def _taken(chosen: IntArray, track: int, count: int) -> bool:
    """Return whether one of the first ``count`` rods already has the track."""
    return bool((chosen[:count] == track).any())


@inline_kernel
def _neighbour_gap(
    ends: FloatArray,
    rods: tuple[int, int],
    row: FloatArray,
    off: tuple[float, float, float],
    r: int,
    predicted: FloatArray,
) -> float:
    """Return the distance of the nearest neighbour's foot from that of rod r, px."""
    beside = np.empty(4)
    gap = 1e9
    for other in (r - 1, r + 1):
        if not 0 <= other < len(row):
            continue
        if predict_rod(ends, _place(row, rods, other), off, beside):
            distance = math.hypot(beside[0] - predicted[0], beside[1] - predicted[1])
            gap = min(gap, distance)
    return gap


@kernel
def score_layout(
    tracks: FloatArray,
    looks: FloatArray,
    ends: FloatArray,
    rods: tuple[int, int],
    row: FloatArray,
    marks: FloatArray,
    dark_below: Mask,
    limits: FloatArray,
    chosen: IntArray,
    indices: IntArray,
) -> float:
    """Return how well all tracks fit the board that two rods predict.

    Parameters
    ----------
    tracks : (T, n, 3) float64
        x, y, sign of each edge, NaN = none.
    looks : (T, 3) float64
        How much each track looks like a rod (0..1), logarithm of its step and of its width.
    ends : (2, 5) float64
        Bottom and top x, y, px per metre of the two rods.
    rods : tuple of int
        Which rods of the board they are.
    row : (R, 2) float64
        Positions of the rods along and off their row, m.
    marks : (M,) float64
        Heights of the marks, m.
    dark_below : (M,) bool
        Which marks have a dark band below and a light one above.
    limits : (6,) float64
        Width and height of the image less a margin, px; how far a rod may be off sideways, m
        and px; logarithm of the usual step and of the rods' diameter, m.
    chosen : (R,) int64
        Written: track of each rod, NONE = none.
    indices : (R, n) int64
        Written: mark of each edge of the chosen track, NONE = none.

    """
    total = 0.0
    predicted = np.empty(4)
    trial = np.empty(tracks.shape[1], np.int64)
    apart_m = math.hypot(row[rods[1], 0] - row[rods[0], 0], row[rods[1], 1] - row[rods[0], 1])
    off = off_plane(ends, max(apart_m, 1e-6), (limits[0], limits[1]))
    for r in range(len(row)):
        chosen[r] = NONE
        if not predict_rod(ends, _place(row, rods, r), off, predicted):
            continue
        expected = 0
        for m in range(marks.size):
            f = (marks[m] - marks[0]) / (marks[-1] - marks[0])
            x = predicted[0] + f * (predicted[2] - predicted[0])
            y = predicted[1] + f * (predicted[3] - predicted[1])
            if limits[0] > x > 4 and limits[1] > y > 4:
                expected += 1
        length = math.hypot(predicted[2] - predicted[0], predicted[3] - predicted[1])
        lateral = limits[2] * length / (marks[-1] - marks[0]) + limits[3]
        lateral = min(lateral, BESIDE * _neighbour_gap(ends, rods, row, off, r, predicted))
        best = 0.0
        for t in range(tracks.shape[0]):
            if _taken(chosen, t, r) or _far(tracks[t], predicted, 2 * lateral):
                continue
            explained, unexplained = _match_track(
                tracks[t], predicted, marks, dark_below, lateral, trial
            )
            width = limits[5] + math.log(length / (marks[-1] - marks[0]))
            if abs(looks[t, 2] - width) > WIDTH_RANGE:
                continue
            unlike = (looks[t, 1] - limits[4]) / STEP_RANGE
            value = looks[t, 0] * math.exp(-0.5 * unlike * unlike)
            value *= explained - UNEXPLAINED * unexplained
            if explained >= 2 and value > best:
                best, chosen[r] = value, t
                indices[r] = trial
                found = explained
        if chosen[r] != NONE:
            total += best - MISSING * max(0, expected - found)
        else:
            total -= MISSING * expected
    return total
