# SPDX-License-Identifier: Apache-2.0
"""Solver of the filter's equations (C + lambda L_g) f = C b (eq. 13) at image rate.

Conjugate gradients on the black half of the pixels, preconditioned by one multigrid cycle:
black-box interpolation, Galerkin's coarse equations, incomplete Cholesky as smoother. It stops on
an estimate of the largest error in px, not on a residual.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from binocular_recon._jit import over_strips
from binocular_recon.stereo import _wls_kernels as lattice_kernels
from binocular_recon.stereo import _wls_reduction_kernels as reduction
from binocular_recon.stereo import _wls_transfer_kernels as transfers
from binocular_recon.stereo._wls_kernels import OVERLAP, PAD, Lattice, Vector
from binocular_recon.stereo._wls_reduction_kernels import Picture
from binocular_recon.stereo._wls_transfer_kernels import Transfer

_NODES_PER_STRIP = 65536
_MAX_ITERATIONS = 200
# The largest error is at most about 1.7 times its estimate from the smallest Ritz value
# (measured over natural, synthetic and random systems); half the error must never be exceeded.
_SAFETY = 1.0
# A Ritz value this large is not believed before the Krylov space has this many dimensions.
_FIRST_RITZ_VALUE, _FEW_ITERATIONS = 0.35, 3
# Rounding of float32, relative to the largest value.
_ROUNDING = 1e-6


class Solution(NamedTuple):
    """A solved system.

    Attributes
    ----------
    values : (H, W) float32
        f.
    iterations : int
        Iterations done.
    error_estimate : float
        Estimated largest difference from the exact solution.

    """

    values: Vector
    iterations: int
    error_estimate: float


class _Level:
    """A lattice with the vectors that a cycle needs on it."""

    def __init__(self, rows: int, columns: int, *, black: bool = False) -> None:
        stride = columns + 2 * PAD
        nodes = (rows + 2 * PAD) * stride
        strip = max(8, _NODES_PER_STRIP // columns)
        strip = rows if rows < 1.5 * strip else strip
        of_strip = (min(strip, rows) + 2 * (OVERLAP + PAD)) * stride
        strips = -(-rows // strip)
        if black:
            later = [[1, stride - 1, stride, 2 * stride], [1, stride, stride + 1, 2 * stride]]
            triangles = [[0, 2, 1], [1, 2, 0], [1, 3, 2], [2, 3, 1]]
        else:
            later = [[1, stride - 1, stride, stride + 1]] * 2
            triangles = [[0, 2, 1], [0, 3, 2], [1, 2, 0], [2, 3, 0]]
        earlier = later[::-1]
        self.columns = columns
        self.lattice = Lattice(
            links=np.zeros((4, nodes), np.float32),
            excess=np.zeros(nodes, np.float32),
            factors=np.zeros((strips, 5, of_strip), np.float32),
            scratch=np.zeros((strips, of_strip), np.float32),
            later=np.array(later),
            earlier=np.array(earlier),
            triangles=np.array(triangles),
            rows=rows,
            stride=stride,
            strip=strip,
        )
        self.right, self.x, self.work = (self.vector() for _ in range(3))

    def vector(self) -> Vector:
        return np.zeros_like(self.lattice.excess)

    def over(self, function: Callable[..., None], *args: Any) -> None:
        """Call a kernel on this level's rows."""
        over_strips(function, self.lattice.rows, *args, strip=self.lattice.strip)

    def factorise(self) -> None:
        self.over(lattice_kernels.factorise, self.lattice)

    def smooth(self, right: Vector, x: Vector, out: Vector, *, correct: bool) -> None:
        self.over(lattice_kernels.smooth, self.lattice, right, x, out, correct)

    def residual(self, right: Vector, x: Vector, out: Vector) -> None:
        self.over(lattice_kernels.residual, self.lattice, right, x, out)

    def add_scaled(self, out: Vector, a: Vector, factor: float, b: Vector) -> None:
        self.over(lattice_kernels.add_scaled, self.lattice, out, a, factor, b)

    def dots(self, a: Vector, b: Vector, c: Vector) -> tuple[float, float, float]:
        """Return a.b, a.c and max|a|."""
        sums = np.zeros((len(self.lattice.factors), 3))
        self.over(lattice_kernels.dots, self.lattice, a, b, c, sums)
        return float(sums[:, 0].sum()), float(sums[:, 1].sum()), float(sums[:, 2].max())


@dataclass(frozen=True)
class _Coarser:
    """The next coarser grid and the way to it."""

    level: _Level
    transfer: Transfer


class System:
    """The equations (C + lambda L_g) f = C b for one C and L_g.

    Parameters
    ----------
    weight : (H, W) float32
        c, the diagonal of C; above 0 somewhere.
    link_x : (H, W - 1) float32
        lambda a_x.
    link_y : (H - 1, W) float32
        lambda a_y.

    """

    def __init__(self, weight: Vector, link_x: Vector, link_y: Vector) -> None:
        rows, columns = weight.shape
        self._black = _Level(rows, (columns + 1) // 2, black=True)
        stride = columns + 2 * PAD
        padded = (rows + 2 * PAD) * stride
        self._picture = Picture(
            links=np.zeros((4, padded), np.float32),
            weight=np.zeros(padded, np.float32),
            inverse=self._black.vector(),
            columns=columns,
            stride=stride,
            half_stride=self._black.lattice.stride,
        )
        self._pixels(self._picture.weight)[:] = weight
        self._pixels(self._picture.links[0])[:, :-1] = link_x
        self._pixels(self._picture.links[2])[:-1] = link_y
        lattice = self._black.lattice
        self._black.over(reduction.invert_red, self._picture)
        self._black.over(reduction.reduce_links, self._picture, lattice.links, lattice.excess)
        self._black.factorise()
        self._coarser = self._coarsen_all(rows, columns)

    def _pixels(self, padded: Vector) -> Vector:
        """View padded pixels as a picture."""
        return padded.reshape(-1, self._picture.stride)[PAD:-PAD, PAD:-PAD]

    def _coarsen_all(self, rows: int, columns: int) -> list[_Coarser]:
        """Make the grids of every 2nd, 4th, 8th ... pixel down to a single one."""
        links, excess, coarser = self._picture.links, self._picture.weight, []
        while max(rows, columns) > 1:
            level = _Level((rows + 1) // 2, (columns + 1) // 2)
            lattice = level.lattice
            weights = np.zeros((6, lattice.excess.size), np.float32)
            weights[:2] = 1
            transfer = Transfer(weights, rows, columns, columns + 2 * PAD, lattice.stride)
            level.over(transfers.weigh_between, links, transfer)
            level.over(transfers.weigh_amid, links, transfer)
            level.over(transfers.galerkin, links, transfer, lattice.links)
            level.over(transfers.restrict, excess, transfer, lattice.excess)
            level.factorise()
            coarser.append(_Coarser(level, transfer))
            links, excess = lattice.links, lattice.excess
            rows, columns = lattice.rows, level.columns
        return coarser

    def solve(self, data: Vector, tolerance: float, initial: Vector | None = None) -> Solution:
        """Solve for one b.

        Parameters
        ----------
        data : (H, W) float32
            b; anything finite where c is 0.
        tolerance : float
            Largest error allowed, in the data's unit.
        initial : (H, W) float32, optional
            A first guess.

        """
        black, picture = self._black, self._picture
        right_side = np.zeros_like(picture.weight)
        self._pixels(right_side)[:] = data
        right_side *= picture.weight
        right, x = black.vector(), black.vector()
        black.over(reduction.reduce_right_side, picture, right_side, right)
        if initial is None:
            self._guess(right_side, x)
        else:
            first = np.zeros_like(right_side)
            self._pixels(first)[:] = initial
            black.over(reduction.gather_black, picture, first, x)
        iterations, error = self._iterate(right, x, tolerance)
        values = np.zeros_like(right_side)
        black.over(reduction.substitute, picture, right_side, x, values)
        return Solution(self._pixels(values), iterations, error)

    def _guess(self, right_side: Vector, x: Vector) -> None:
        """Nested iteration: solve roughly on the coarsest grid, refine from grid to grid."""
        rights = [right_side]
        for coarser in self._coarser:
            rights.append(coarser.level.vector())
            coarser.level.over(transfers.restrict, rights[-2], coarser.transfer, rights[-1])
        guess = None
        for depth in range(len(self._coarser) - 1, -1, -1):
            level = self._coarser[depth].level
            correction, rest = level.vector(), rights[depth + 1]
            if guess is None:
                self._cycle(depth, rest, correction)
                guess = correction
                continue
            finer, below = level.vector(), self._coarser[depth + 1]
            below.level.over(transfers.prolong, guess, below.transfer, finer)
            level.residual(rest, finer, level.work)
            rest = level.work.copy()
            self._cycle(depth, rest, correction)
            guess = finer + correction
        if guess is not None:
            first = self._coarser[0]
            first.level.over(reduction.prolong_black, guess, first.transfer, x)

    def _cycle(self, depth: int, right: Vector, out: Vector) -> None:
        """Write roughly ``A^-1 right`` of a coarse level: one V-cycle."""
        level = self._coarser[depth].level
        if depth + 1 == len(self._coarser):
            level.smooth(right, level.x, out, correct=False)
            return
        below = self._coarser[depth + 1]
        level.smooth(right, level.x, level.x, correct=False)
        level.residual(right, level.x, level.work)
        below.level.over(transfers.restrict, level.work, below.transfer, below.level.right)
        self._cycle(depth + 1, below.level.right, below.level.work)
        below.level.over(transfers.prolong, below.level.work, below.transfer, level.x)
        level.smooth(right, level.x, out, correct=True)

    def _precondition(self, right: Vector, out: Vector) -> None:
        """Write roughly ``A^-1 right`` of the black half."""
        black = self._black
        black.smooth(right, black.x, black.x, correct=False)
        if self._coarser:
            first = self._coarser[0]
            black.residual(right, black.x, black.work)
            first.level.over(
                reduction.restrict_black, black.work, first.transfer, first.level.right
            )
            self._cycle(0, first.level.right, first.level.work)
            first.level.over(reduction.prolong_black, first.level.work, first.transfer, black.x)
        black.smooth(right, black.x, out, correct=True)

    def _iterate(self, right: Vector, x: Vector, tolerance: float) -> tuple[int, float]:
        """Improve x by flexible conjugate gradients (Y. Notay, SIAM J. Sci. Comput. 22, 2000).

        With z = M^-1 r and the smallest eigenvalue s of M^-1 A, the error is at most about
        max|z| / s; the smallest Ritz value of the Lanczos matrix, whose entries the iteration
        yields, tells s.
        """
        black = self._black
        residual, z, p, Ap = (black.vector() for _ in range(4))
        zero = black.vector()
        black.residual(right, x, residual)
        pAp = 1.0
        steps: list[float] = []
        shares: list[float] = []
        for iteration in range(1, _MAX_ITERATIONS + 1):
            self._precondition(residual, z)
            zAp, _, largest = black.dots(z, Ap, residual)
            share = zAp / pAp if steps else 0.0
            black.add_scaled(p, z, share, p)  # Ap below is minus A p
            black.residual(zero, p, Ap)
            pAp_minus, pr, _ = black.dots(p, Ap, residual)
            pAp = -pAp_minus
            if not pAp > 0:
                return iteration, _ROUNDING * self._largest(x)
            step = pr / pAp
            black.add_scaled(x, x, step, p)
            black.add_scaled(residual, residual, step, Ap)
            steps.append(step)
            shares.append(share)
            error = _SAFETY * largest / _smallest_ritz_value(steps, shares)
            rounding = _ROUNDING * self._largest(x)
            if error <= max(tolerance, rounding):
                break
        return iteration, error + rounding

    def _largest(self, x: Vector) -> float:
        return self._black.dots(x, x, x)[2]


def _smallest_ritz_value(steps: list[float], shares: list[float]) -> float:
    """Return the smallest eigenvalue of the Lanczos matrix of conjugate gradients."""
    size = len(steps)
    matrix = np.zeros((size, size))
    for i in range(size):
        matrix[i, i] = 1 / steps[i]
        if i:
            matrix[i, i] += shares[i] / steps[i - 1]
            matrix[i, i - 1] = matrix[i - 1, i] = np.sqrt(max(shares[i], 0)) / steps[i - 1]
    smallest = float(np.linalg.eigvalsh(matrix)[0])
    return min(smallest, _FIRST_RITZ_VALUE) if size < _FEW_ITERATIONS else smallest
