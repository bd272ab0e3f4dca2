# SPDX-License-Identifier: Apache-2.0
"""One point per cube of space, of the clouds of several stations."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import numpy.typing as npt

from binocular_recon.camera import FloatArray
from binocular_recon.io.exports.point_table import SIGMAS, WHOLE, PointChunk
from binocular_recon.io.ply import SCALAR, Vertices, vertex_kind
from binocular_recon.stereo.thinning import grouped, repeated
from binocular_recon.stereo.validity import Validity

# Smaller standard deviations would not divide, m.
_LEAST_SIGMA_M = 1e-6
_COLOURS = ('red', 'green', 'blue')


class _Cells:
    """Sums of the points in each cube that holds some: measured points apart from others.

    Attributes
    ----------
    keys : (N, 4) int64
        0 for measured points, 1 for others, which then follow those of the same cube; and the
        cube along each axis.
    sums : (N, 10) or (N, 14) float64
        Of the weight, and of weight times coordinates within the cube, colours and sigmas; of
        stations also of weight times the squares of these coordinates, and their number.
    bits : (N,) uint8
        All bits of their validity.

    """

    def __init__(
        self, keys: npt.NDArray[np.int64], sums: FloatArray, bits: npt.NDArray[np.uint8]
    ) -> None:
        self.keys, self.sums, self.bits = keys, sums, bits

    @classmethod
    def of(cls, chunk: PointChunk, size_m: float) -> _Cells:
        cubes = np.floor(chunk.xyz / size_m)
        sigmas = np.stack([chunk.scalars[name] for name in SIGMAS], axis=-1).astype(np.float64)
        weight = 1 / np.maximum((sigmas**2).mean(axis=1), _LEAST_SIGMA_M**2)
        values = np.column_stack([chunk.xyz - cubes * size_m, chunk.rgb, sigmas])
        bits = chunk.scalars['validity']
        guessed = (bits & Validity.MEASURED) == 0
        keys = np.column_stack([guessed, cubes]).astype(np.int64)
        return joined([cls(keys, np.column_stack([weight, weight[:, None] * values]), bits)])

    @property
    def means(self) -> FloatArray:
        """Weighted means of coordinates within the cube, colours and sigmas, (N, 9)."""
        means: FloatArray = self.sums[:, 1:] / self.sums[:, :1]
        return means


def joined(parts: Iterable[_Cells]) -> _Cells:
    """Return the sums of several parts."""
    listed = list(parts)
    keys = np.concatenate([part.keys for part in listed])
    order, starts = grouped(keys)
    keys = keys[order]
    sums = np.concatenate([part.sums for part in listed])[order]
    bits = np.concatenate([part.bits for part in listed])[order]
    if not len(starts):
        return _Cells(keys, sums, bits)
    return _Cells(
        keys[starts], np.add.reduceat(sums, starts, axis=0), np.bitwise_or.reduceat(bits, starts)
    )


class VoxelCloud:
    """The clouds of stations, one point per cube.

    Parameters
    ----------
    size_m : float
        Edge of the cubes.

    Notes
    -----
    Points of one station in a cube are averaged by 1 / sigma^2; their errors are nearly the same,
    so their sigma is the mean. Stations are averaged in the same way. Their errors are partly the
    same too (the calibration, control points), so the sigma of the result is the mean of theirs,
    and not less than their spread. Where a station has measured a cube, what others guessed there
    does not count.

    """

    def __init__(self, size_m: float) -> None:
        self._size_m = size_m
        self._stations: list[_Cells] = []

    def add(self, chunks: Iterable[PointChunk]) -> int:
        """Add the points of a station; return in how many cubes they lie."""
        found: _Cells | None = None
        for chunk in chunks:
            new = _Cells.of(chunk, self._size_m)
            found = new if found is None else joined([found, new])
        if found is None:
            found = _Cells(np.empty((0, 4), np.int64), np.empty((0, 10)), np.empty(0, np.uint8))
        # as one point of a station, whatever their number
        means = found.means
        weight = 1 / np.maximum((means[:, 6:] ** 2).mean(axis=1), _LEAST_SIGMA_M**2)
        squares = weight[:, None] * means[:, :3] ** 2
        sums = np.column_stack([weight, weight[:, None] * means, squares, np.ones(len(weight))])
        self._stations.append(_Cells(found.keys, sums, found.bits))
        return int(np.count_nonzero(~repeated(found.keys[:, 1:])))

    def vertices(self) -> Vertices:
        """Return the points of all stations, laid out as in a PLY file, double precision."""
        cells = joined(self._stations)
        kept = ~repeated(cells.keys[:, 1:])
        keys, sums, bits = cells.keys[kept], cells.sums[kept], cells.bits[kept]
        means = sums[:, 1:13] / sums[:, :1]
        spread = np.sqrt(np.maximum(means[:, 9:] - means[:, :3] ** 2, 0))
        vertices = np.empty(len(keys), vertex_kind([*SIGMAS, *WHOLE], '<f8'))
        for axis, name in enumerate('xyz'):
            vertices[name] = keys[:, 1 + axis] * self._size_m + means[:, axis]
            sigma = np.maximum(means[:, 6 + axis], spread[:, axis])
            vertices[f'{SCALAR}{SIGMAS[axis]}'] = sigma
        for axis, name in enumerate(_COLOURS):
            vertices[name] = np.rint(means[:, 3 + axis])
        vertices[f'{SCALAR}validity'] = bits
        vertices[f'{SCALAR}count'] = sums[:, 13]
        return vertices
