# SPDX-License-Identifier: Apache-2.0
"""Solver of the filter's equations (C + lambda L_g) f = C b (eq. 13), fast enough for video.

Conjugate gradients on the black half of the pixels, preconditioned by one multigrid cycle with
black-box interpolation, Galerkin coarse equations and incomplete Cholesky as smoother; first, each
region that strong links hold together is corrected as a whole. It stops on an estimate of the
largest error in px, not on a residual.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from binocular_recon._simd import LANES
from binocular_recon.stereo.filtering import _gradient_kernels as gradient_kernels
from binocular_recon.stereo.filtering import _reduction_kernels as reduction
from binocular_recon.stereo.filtering import _transfer_kernels as transfers
from binocular_recon.stereo.filtering._grids import Coarser, Level, Regions, padded_stride
from binocular_recon.stereo.filtering._lattice_kernels import PAD, Vector
from binocular_recon.stereo.filtering._reduction_kernels import RedBlackGrid
from binocular_recon.stereo.filtering._transfer_kernels import Transfer

# Iterations within which the error must fall.
_PATIENCE = 30
# After one iteration, the smallest eigenvalue is not taken to be larger than this.
_FIRST_EIGENVALUE = 0.35
_LEAST_EIGENVALUE = 1e-6
# The next step may reduce the error by this factor less than the previous ones suggest.
_SAFETY = 4.0
# Links above this hold a region together: four times the largest weight of the data.
STRONG = 4.0
# Rounding of float32, relative to the largest value.
_ROUNDING = 1e-6


class Solution(NamedTuple):
    """A solved system.

    Attributes
    ----------
    values : (H, W) float32
        f.
    iterations : int
        Number of iterations.
    error_estimate : float
        Estimated largest difference from the exact solution.

    """

    values: Vector
    iterations: int
    error_estimate: float


class System:
    """The equations (C + lambda L_g) f = C b for images of one size; memory is reused.

    Parameters
    ----------
    rows, columns : int
        H and W.

    """

    def __init__(self, rows: int, columns: int) -> None:
        self.shape = rows, columns
        self._black = Level(rows, (columns + 1) // 2, black=True)
        stride = padded_stride(columns)
        padded = (rows + 2 * PAD) * stride + 2 * LANES
        self._grid = RedBlackGrid(
            links=np.zeros((4, padded), np.float32),
            weight=np.zeros(padded, np.float32),
            inverse=self._black.vector(),
            columns=columns,
            stride=stride,
            half_stride=self._black.lattice.stride,
        )
        self._rhs, self._pixel_values = np.zeros((2, padded), np.float32)
        self._vectors = [self._black.vector() for _ in range(6)]
        self._coarser = self._make_grids()
        self._regions = Regions(self._black)

    def _make_grids(self) -> list[Coarser]:
        """Make the grids of every 2nd, 4th, 8th ... pixel down to a single one."""
        (rows, columns), stride = self.shape, self._grid.stride
        coarser: list[Coarser] = []
        while max(rows, columns) > 1:
            level = Level((rows + 1) // 2, (columns + 1) // 2)
            weights = np.zeros((6, level.lattice.excess.size), np.float32)
            weights[:2] = 1
            transfer = Transfer(
                weights, rows, columns, stride, level.lattice.stride, diagonal=bool(coarser)
            )
            coarser.append(Coarser(level, transfer))
            rows, columns, stride = level.lattice.rows, level.columns, level.lattice.stride
        return coarser

    def _pixels(self, padded: Vector) -> Vector:
        """View a padded array as an image, (H, W)."""
        rows = padded[: -2 * LANES].reshape(-1, self._grid.stride)
        return rows[PAD:-PAD, PAD : PAD + self._grid.columns]

    def assemble(self, weight: Vector, link_east: Vector, link_south: Vector) -> None:
        """Set the matrix, C + lambda L_g.

        Parameters
        ----------
        weight : (H, W) float32
            c, the diagonal of C; above 0 somewhere.
        link_east : (H, W - 1) float32
            lambda a_x.
        link_south : (H - 1, W) float32
            lambda a_y.

        """
        grid, black = self._grid, self._black
        self._pixels(grid.weight)[:] = weight
        self._pixels(grid.links[0])[:, :-1] = link_east
        self._pixels(grid.links[2])[:-1] = link_south
        black.run(reduction.invert_red, grid)
        black.run(reduction.reduce_links, grid, black.lattice.links, black.lattice.excess)
        black.factorise()
        self._regions.find(STRONG)
        links, excess = grid.links, grid.weight
        for level, transfer in self._coarser:
            level.run(transfers.set_line_weights, links, transfer)
            level.run(transfers.set_centre_weights, links, transfer)
            level.run(transfers.galerkin, links, transfer, level.lattice.links)
            level.run(transfers.restrict, excess, transfer, level.lattice.excess)
            level.factorise()
            links, excess = level.lattice.links, level.lattice.excess

    def solve(self, data: Vector, tolerance: float, initial: Vector | None = None) -> Solution:
        """Solve for one b.

        Parameters
        ----------
        data : (H, W) float32
            b; any finite value where c is 0. The iteration starts from it.
        tolerance : float
            Largest error allowed, in the unit of the data.
        initial : (H, W) float32, optional
            An approximate solution; the first step of the iteration goes towards it.

        Returns
        -------
        Solution
            The values and how they were found.

        """
        black, grid, pixels = self._black, self._grid, self._pixel_values
        rhs, x, residual, _, p, Ap = self._vectors
        np.multiply(data, self._pixels(grid.weight), out=self._pixels(self._rhs))
        self._pixels(pixels)[:] = data
        black.run(reduction.reduce_rhs, grid, self._rhs, rhs)
        black.run(reduction.gather_black, grid, pixels, x)
        black.residual(rhs, x, residual)
        p.fill(0)
        Ap.fill(0)
        if initial is not None:
            np.subtract(initial, data, out=self._pixels(pixels))
            self._step_along(pixels)
        rounding = _ROUNDING * max(abs(float(data.max())), abs(float(data.min())))
        iterations, error = self._iterate(max(tolerance, rounding))
        black.run(reduction.substitute_red, grid, self._rhs, x, pixels)
        # a copy, because kernels are slower on rows that are not one behind the other
        return Solution(self._pixels(pixels).copy(), iterations, error + rounding)

    def _step_along(self, pixels: Vector) -> None:
        """Change x along a direction by the best step."""
        black, (rhs, x, residual, z, p, Ap) = self._black, self._vectors
        black.run(reduction.gather_black, self._grid, pixels, z)
        sums = black.strip_sums(gradient_kernels.update_direction, z, 0.0, residual, p, Ap)
        pAp, pr, _ = sums.sum(axis=0).tolist()
        if pAp > 0:
            black.run(gradient_kernels.update_solution, black.lattice, pr / pAp, p, x)
            black.residual(rhs, x, residual)

    def _cycle(self, depth: int, rhs: Vector, out: Vector) -> None:
        """Write roughly ``A^-1 rhs`` of a coarse level: one V-cycle."""
        level = self._coarser[depth].level
        if depth + 1 == len(self._coarser):
            level.smooth(rhs, level.x, out, correct=False)
            return
        coarse, transfer = self._coarser[depth + 1]
        level.smooth(rhs, level.x, level.x, correct=False)
        level.rough_residual(rhs, level.x, level.work)
        coarse.run(transfers.restrict, level.work, transfer, coarse.rhs)
        self._cycle(depth + 1, coarse.rhs, coarse.work)
        coarse.run(transfers.prolong, coarse.work, transfer, level.x)
        level.smooth(rhs, level.x, out, correct=True)

    def _precondition(self, rhs: Vector, out: Vector) -> None:
        """Write roughly ``A^-1 rhs`` of the black pixels."""
        black = self._black
        black.smooth(rhs, self._regions.solve(rhs), black.x, correct=True)
        if self._coarser:
            coarse, transfer = self._coarser[0]
            black.rough_residual(rhs, black.x, black.work)
            coarse.run(reduction.restrict_black, black.work, transfer, coarse.rhs)
            self._cycle(0, coarse.rhs, coarse.work)
            coarse.run(reduction.prolong_black, coarse.work, transfer, black.x)
        black.smooth(rhs, black.x, out, correct=True)

    def _iterate(self, tolerance: float) -> tuple[int, float]:
        """Improve x by flexible conjugate gradients (Y. Notay, SIAM J. Sci. Comput. 22, 2000)."""
        black, (rhs, x, residual, z, p, Ap) = self._black, self._vectors
        estimate = _ErrorEstimate()
        errors: list[float] = []
        pAp = 1.0
        while _improves(errors):
            self._precondition(residual, z)
            sums = black.strip_sums(gradient_kernels.dot_and_largest, z, Ap)
            beta = -float(sums[:, 0].sum()) / pAp if errors else 0.0
            largest_z = float(sums[:, 1].max())
            sums = black.strip_sums(gradient_kernels.update_direction, z, beta, residual, p, Ap)
            pAp, pr = sums[:, :2].sum(axis=0).tolist()
            if not (pAp > 0 and pr > 0):  # solved to the last digit
                errors.append(largest_z)
                break
            alpha = pr / pAp
            black.run(gradient_kernels.update_solution, black.lattice, alpha, p, x)
            largest_step = alpha * float(sums[:, 2].max())
            errors.append(estimate.after_step(alpha, beta, largest_z, largest_step))
            if errors[-1] <= tolerance:
                break
            # recomputed, not updated by A p, so that rounding errors do not accumulate in it
            black.residual(rhs, x, residual)
        return len(errors), errors[-1]


def _improves(errors: list[float]) -> bool:
    """Return whether the error still falls; at the limit of float32 it stops falling."""
    before, lately = errors[:-_PATIENCE], errors[-_PATIENCE:]
    return not before or min(lately) < 0.9 * min(before)


class _ErrorEstimate:
    """The largest error that is left, estimated from the course of the iteration.

    With z = M^-1 r and the smallest eigenvalue s of M^-1 A, the error before a step is at most
    about max|z| / s. The step reduces it by the same factor as the previous step did, or by that
    which the condition number of M^-1 A guarantees for conjugate gradients; the smaller reduction
    is assumed. The eigenvalues are those of the Lanczos matrix, which follows from alpha and beta;
    the smallest is extrapolated, because it still falls.
    """

    def __init__(self) -> None:
        self._alphas: list[float] = []
        self._betas: list[float] = []
        self._smallest: list[float] = []
        self._changes: list[npt.NDArray[np.float64]] = []

    def after_step(
        self, alpha: float, beta: float, largest_z: float, largest_step: float
    ) -> float:
        """Return the estimated error after one more step."""
        self._alphas.append(alpha)
        self._betas.append(beta)
        self._changes.append(np.array([largest_z, largest_step]))
        low, high = self._ritz_values()
        self._smallest.append(low)
        error = float(self._changes[-1].max())
        if len(self._changes) == 1:
            return error / min(low, _FIRST_EIGENVALUE)
        smallest = low * (low / self._smallest[-2]) ** 2
        root = math.sqrt(max(high, 1.0) / smallest)
        rate = max(*self._changes[-1] / self._changes[-2], (root - 1) / (root + 1))
        return error / smallest * min(1.0, _SAFETY * float(rate))

    def _ritz_values(self) -> tuple[float, float]:
        """Return the smallest and the largest eigenvalue of the Lanczos matrix."""
        alphas, betas = np.array(self._alphas), np.maximum(self._betas, 0.0)[1:]
        diagonal = 1 / alphas
        diagonal[1:] += betas / alphas[:-1]
        off_diagonal = np.diag(np.sqrt(betas) / alphas[:-1], 1)
        values = np.linalg.eigvalsh(np.diag(diagonal) + off_diagonal + off_diagonal.T)
        return max(float(values[0]), _LEAST_EIGENVALUE), float(values[-1])
