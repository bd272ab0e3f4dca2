# SPDX-License-Identifier: Apache-2.0
"""The grids of the multigrid cycle: each level has a lattice and its vectors."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from binocular_recon._jit import over_strips
from binocular_recon._simd import LANES
from binocular_recon.stereo.filtering import _lattice_kernels as lattice_kernels
from binocular_recon.stereo.filtering import _region_kernels as region_kernels
from binocular_recon.stereo.filtering._factor_kernels import factorise
from binocular_recon.stereo.filtering._lattice_kernels import OVERLAP, PAD, Lattice, Vector
from binocular_recon.stereo.filtering._transfer_kernels import Transfer

_NODES_PER_STRIP = 65536


def padded_stride(columns: int) -> int:
    """Return the floats per row of nodes: the padding and a whole number of pairs of vectors."""
    return PAD + -(-columns // (2 * LANES)) * 2 * LANES


class Level:
    """A lattice, with the vectors of the multigrid cycle.

    With ``black`` it holds the black pixels: rows are shifted against each other by half a node.
    """

    def __init__(self, rows: int, columns: int, *, black: bool = False) -> None:
        stride = padded_stride(columns)
        nodes = (rows + 2 * PAD) * stride + 2 * LANES
        strips = max(1, round(nodes / _NODES_PER_STRIP))
        strip = max(8, -(-rows // (strips + strips % 2))) if strips > 1 else rows
        strip_nodes = (min(strip, rows) + 2 * (OVERLAP + PAD)) * stride + LANES
        strips = -(-rows // strip)
        if black:
            later = [[1, stride - 1, stride, 2 * stride], [1, stride, stride + 1, 2 * stride]]
            triangles = [[0, 2, 1], [1, 2, 0], [1, 3, 2], [2, 3, 1]]
        else:
            later = [[1, stride - 1, stride, stride + 1]] * 2
            triangles = [[0, 3, 2], [0, 2, 1], [1, 2, 0], [2, 3, 0]]
        earlier = later[::-1]
        self.columns = columns
        self.lattice = Lattice(
            links=np.zeros((4, nodes), np.float32),
            excess=np.zeros(nodes, np.float32),
            rough_links=np.zeros((4, nodes), np.uint16),
            factors=np.zeros((strips, 4, strip_nodes), np.uint16),
            inverse=np.zeros((strips, strip_nodes), np.float32),
            scratch=np.zeros((strips, strip_nodes), np.float32),
            later=np.array(later),
            earlier=np.array(earlier),
            triangles=np.array(triangles),
            rows=rows,
            width=-(-columns // LANES) * LANES,
            stride=stride,
            strip=strip,
        )
        self.rhs, self.x, self.work = (self.vector() for _ in range(3))

    def vector(self) -> Vector:
        return np.zeros_like(self.lattice.excess)

    def run(self, function: Callable[..., None], *args: Any) -> None:
        """Call a kernel on all rows of this level."""
        over_strips(function, self.lattice.rows, *args, strip=self.lattice.strip)

    def factorise(self) -> None:
        self.run(factorise, self.lattice)

    def smooth(self, rhs: Vector, x: Vector, out: Vector, *, correct: bool) -> None:
        self.run(lattice_kernels.smooth, self.lattice, rhs, x, out, correct)

    def residual(self, rhs: Vector, x: Vector, out: Vector) -> None:
        self.run(lattice_kernels.residual, self.lattice, self.lattice.links, rhs, x, out)

    def rough_residual(self, rhs: Vector, x: Vector, out: Vector) -> None:
        """Write the residual of the rough links, which is enough for a preconditioner."""
        self.run(lattice_kernels.residual, self.lattice, self.lattice.rough_links, rhs, x, out)

    def strip_sums(self, function: Callable[..., None], *args: Any) -> npt.NDArray[np.float64]:
        """Call a kernel that writes three sums per strip; return them, (strips, 3)."""
        sums = np.zeros((len(self.lattice.factors), 3))
        self.run(function, self.lattice, *args, sums)
        return sums


class Regions:
    """The nodes of a level that strong links hold together, each region corrected as a whole.

    Parameters
    ----------
    level : Level
        Its memory is made once; `find` follows its links.

    """

    def __init__(self, level: Level) -> None:
        self._level = level
        self._labels, self._parents, nodes, numbers = np.zeros(
            (4, level.lattice.excess.size), np.int32
        )
        self._members, self._count = (nodes, numbers), 0
        self._inverse, self._values = np.zeros((2, 1))
        self._constants = level.vector()  # stays 0 outside regions

    def find(self, strong: float) -> None:
        """Find the regions, held together by links above ``strong``."""
        lattice, labels = self._level.lattice, self._labels
        self._constants.fill(0)
        last, self._count = region_kernels.label_regions(
            lattice, strong, labels, self._parents, self._members
        )
        diagonal, self._values = np.zeros((2, last + 1))
        nodes = self._members[0][: self._count]
        region_kernels.region_diagonal(lattice, labels, nodes, diagonal)
        # a region that nothing holds has no correction
        self._inverse = np.divide(1, diagonal, out=np.zeros_like(diagonal), where=diagonal > 0)

    def solve(self, rhs: Vector) -> Vector:
        """Return the constant in each region that takes the sum of rhs over it away; else 0."""
        nodes, numbers = (array[: self._count] for array in self._members)
        region_kernels.correct_regions(
            nodes, numbers, self._inverse, rhs, self._values, self._constants
        )
        return self._constants


class Coarser(NamedTuple):
    """The next coarser grid, and the interpolation from it."""

    level: Level
    transfer: Transfer
