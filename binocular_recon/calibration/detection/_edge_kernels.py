# SPDX-License-Identifier: Apache-2.0
"""Kernels that find short edges between light and dark bands and chain them into rods."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from binocular_recon._jit import inline_kernel, kernel
from binocular_recon.camera import FloatArray
from binocular_recon.images import FloatImage, Mask

IntArray = npt.NDArray[np.int64]

NONE = -1
# Columns of the table of edges.
X, Y, STEP, LIGHT, DARK = range(5)
# Length of a gap against what the filter's width suggests: filters differ by a factor of 1.57.
MIN_GAP, MAX_GAP = 0.6, 1.7
# Largest dx / dy of a rod: 20 degrees, and the inaccuracy of its edges.
LEAN = 0.42
# Levels of one rod's dark (or light) bands agree to this share of its contrast.
LEVEL_TOLERANCE = 0.45


@kernel
def edge_response(
    middle: FloatImage,
    side: FloatImage,
    rise: int,
    reach: int,
    response: FloatImage,
    start: int,
    stop: int,
) -> None:
    """Write how much each pixel of rows start..stop - 1 looks like the middle of an edge.

    The step on the rod from ``rise`` rows below to as many above, less that of the background
    ``reach`` columns to either side, so that a long horizontal line gives nothing. Positive: dark
    below. ``middle`` and ``side`` are the image averaged over boxes for rod and background.
    """
    height, width = response.shape
    for y in range(max(start, rise), min(stop, height - rise)):
        for x in range(reach, width - reach):
            step = middle[y - rise, x] - middle[y + rise, x]
            left = side[y - rise, x - reach] - side[y + rise, x - reach]
            right = side[y - rise, x + reach] - side[y + rise, x + reach]
            clear = step - np.float32(0.5) * (left + right)
            if step > 0:
                response[y, x] = max(np.float32(0), min(step, clear))
            else:
                response[y, x] = min(np.float32(0), max(step, clear))


@kernel
def mark_peaks(
    response: FloatImage,
    threshold: float,
    radius: int,
    peak: npt.NDArray[np.bool_],
    start: int,
    stop: int,
) -> None:
    """Mark the local extrema beyond ``threshold`` in rows start..stop - 1."""
    height, width = response.shape
    for y in range(start, stop):
        for x in range(width):
            value = response[y, x]
            if abs(value) < threshold:
                continue
            sign = np.float32(1 if value > 0 else -1)
            best = True
            for v in range(max(0, y - radius), min(height, y + radius + 1)):
                for u in range(max(0, x - radius), min(width, x + radius + 1)):
                    other, size = sign * response[v, u], sign * value
                    # equal neighbours: the first one counts
                    if other > size or (other == size and (v < y or (v == y and u < x))):
                        best = False
                        break
                if not best:
                    break
            peak[y, x] = best


@inline_kernel
def _same_rod(edges: FloatArray, i: int, j: int) -> bool:
    """Return whether the bands at two edges have the same two grey levels."""
    contrast = 0.5 * (abs(edges[i, STEP]) + abs(edges[j, STEP]))
    limit = LEVEL_TOLERANCE * contrast
    return bool(
        abs(edges[i, LIGHT] - edges[j, LIGHT]) < limit
        and abs(edges[i, DARK] - edges[j, DARK]) < limit
    )


@inline_kernel
def _even_band(edges: FloatArray, i: int, j: int, middle: FloatImage) -> bool:
    """Return whether the band from edge i up to edge j has a uniform level, the right one."""
    level = 0.5 * (
        edges[i, LIGHT] + edges[j, LIGHT]
        if edges[i, STEP] > 0
        else edges[i, DARK] + edges[j, DARK]
    )
    limit = LEVEL_TOLERANCE * 0.5 * (abs(edges[i, STEP]) + abs(edges[j, STEP]))
    for k in range(1, 4):
        x = edges[i, X] + 0.25 * k * (edges[j, X] - edges[i, X])
        y = edges[i, Y] + 0.25 * k * (edges[j, Y] - edges[i, Y])
        if abs(middle[int(y + 0.5), int(x + 0.5)] - level) > limit:
            return False
    return True


@kernel
def _nearest(
    edges: FloatArray, first: IntArray, cell: float, point: tuple[float, float, float], like: int
) -> int:
    """Return the edge nearest to x, y within a radius that may be on the rod of edge ``like``.

    NONE if there is none. A negative radius asks for a step of the same sign as that of ``like``,
    a positive one for the opposite sign.
    """
    x, y, radius = point
    sign = edges[like, STEP] if radius < 0 else -edges[like, STEP]
    radius = abs(radius)
    rows, columns = first.shape[0], first.shape[1] - 1
    best, best_distance = NONE, radius * radius
    for r in range(max(0, int((y - radius) / cell)), min(rows, int((y + radius) / cell) + 1)):
        c0 = max(0, int((x - radius) / cell))
        c1 = min(columns, int((x + radius) / cell) + 1)
        if c1 <= c0:
            continue
        for j in range(first[r, c0], first[r, c1]):
            distance = (edges[j, X] - x) ** 2 + (edges[j, Y] - y) ** 2
            if (
                distance < best_distance
                and edges[j, STEP] * sign > 0
                and _same_rod(edges, like, j)
            ):
                best, best_distance = j, distance
    return best


@inline_kernel
def _grow(
    edges: FloatArray,
    first: IntArray,
    cell: float,
    marks: FloatArray,
    dark_below: Mask,
    width: float,
    middle: FloatImage,
    chain: IntArray,
) -> int:
    """Extend a chain of two neighbouring marks both ways; return its number of marks."""
    count = 2
    lowest = 0
    while chain[lowest] == NONE:
        lowest += 1
    for way in (1, -1):
        last = lowest + 1 if way == 1 else lowest
        before = last - way
        k = last + way
        while 0 <= k < marks.size and abs(k - last) <= 2:
            ratio = (marks[k] - marks[last]) / (marks[last] - marks[before])
            i, j = chain[before], chain[last]
            dx, dy = (
                ratio * (edges[j, X] - edges[i, X]),
                ratio * (edges[j, Y] - edges[i, Y]),
            )
            radius = 0.3 * width + 0.1 * np.sqrt(dx * dx + dy * dy)
            if dark_below[k] == dark_below[last]:
                radius = -radius
            found = _nearest(edges, first, cell, (edges[j, X] + dx, edges[j, Y] + dy, radius), j)
            if found != NONE and abs(k - last) == 1:
                low, high = (j, found) if way == 1 else (found, j)
                if not _even_band(edges, low, high, middle):
                    found = NONE
            if found != NONE:
                chain[k] = found
                count += 1
                before, last = last, k
            k += way
    return count


@kernel
def chain_edges(
    edges: FloatArray,
    first: IntArray,
    cell: float,
    marks: FloatArray,
    dark_below: Mask,
    scale: tuple[float, float],
    middle: FloatImage,
    chains: IntArray,
    counts: IntArray,
) -> None:
    """Write for each edge the longest chain in which it is the lower of the first two marks.

    Parameters
    ----------
    edges : (N, 5) float64
        x, y, step, light and dark level, sorted by grid cells, px of ``middle``.
    first : (rows, columns + 1) int64
        Index of the first edge of each cell; row r ends at ``first[r, columns]``.
    cell : float
        Side of a cell, px.
    marks : (M,) float64
        Heights of the marks, m.
    dark_below : (M,) bool
        Which marks have a dark band below and a light one above.
    scale : tuple of float
        Width of the rods, px, and the px per metre that follow from it.
    middle : (H, W) float32
        Image averaged over the rod's width.
    chains : (N, M) int64
        Edge of each mark, NONE = not found.
    counts : (N,) int64
        Number of marks found, 0 = no chain.

    """
    width, px_per_m = scale
    chain = np.empty(marks.size, np.int64)
    gaps = np.diff(marks)
    reach = MAX_GAP * px_per_m * gaps.max()
    nearest = MIN_GAP * px_per_m * gaps.min() * 0.9
    rows, columns = first.shape[0], first.shape[1] - 1
    for i in range(edges.shape[0]):
        x, y = edges[i, X], edges[i, Y]
        side = LEAN * reach
        c0, c1 = max(0, int((x - side) / cell)), min(columns, int((x + side) / cell) + 1)
        for r in range(max(0, int((y - reach) / cell)), min(rows, int((y - nearest) / cell) + 1)):
            if y - nearest < 0:
                break
            for j in range(first[r, c0], first[r, c1]):
                dx, dy = edges[j, X] - x, y - edges[j, Y]
                if (
                    dy <= 0
                    or abs(dx) > LEAN * dy
                    or edges[i, STEP] * edges[j, STEP] > 0
                    or not _same_rod(edges, i, j)
                ):
                    continue
                length = np.sqrt(dx * dx + dy * dy)
                even = False
                for a in range(marks.size - 1):
                    if dark_below[a] != (edges[i, STEP] > 0):
                        continue
                    ratio = length / (gaps[a] * px_per_m)
                    if ratio < MIN_GAP or ratio > MAX_GAP:
                        continue
                    if not even and not _even_band(edges, i, j, middle):
                        break
                    even = True
                    chain[:] = NONE
                    chain[a], chain[a + 1] = i, j
                    count = _grow(edges, first, cell, marks, dark_below, width, middle, chain)
                    if count > counts[i]:
                        counts[i] = count
                        chains[i] = chain
