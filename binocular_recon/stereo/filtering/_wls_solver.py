# SPDX-License-Identifier: Apache-2.0
"""Solver of the filter's equations (C + lambda L_g) f = C b (eq. 13) at image rate.

Conjugate gradients on the black half of the pixels, preconditioned by one multigrid cycle:
black-box interpolation, Galerkin's coarse equations, incomplete Cholesky as smoother. It stops on
an estimate of the largest error in px, not on a residual.
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
from binocular_recon.stereo.filtering._grids import Coarser, Level, padded_stride
from binocular_recon.stereo.filtering._lattice_kernels import PAD, Vector
from binocular_recon.stereo.filtering._reduction_kernels import RedBlackGrid
from binocular_recon.stereo.filtering._transfer_kernels import Transfer

_PATIENCE = 30  # iterations
# The smallest eigenvalue is not taken to be larger than this after one iteration.
_FIRST_EIGENVALUE = 0.35
_LEAST_EIGENVALUE = 1e-6
# The error falls by this factor less than the iteration so far lets expect.
_SAFETY = 4.0
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


class System:
    """The equations (C + lambda L_g) f = C b of pictures of one size, one after the other.

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
        self._picture = RedBlackGrid(
            links=np.zeros((4, padded), np.float32),
            weight=np.zeros(padded, np.float32),
            inverse=self._black.vector(),
            columns=columns,
            stride=stride,
            half_stride=self._black.lattice.stride,
        )
        self._right_side, self._pixel_values = np.zeros((2, padded), np.float32)
        self._vectors = [self._black.vector() for _ in range(6)]
        self._coarser = self._make_grids()

    def _make_grids(self) -> list[Coarser]:
        """Make the grids of every 2nd, 4th, 8th ... pixel down to a single one."""
        (rows, columns), stride = self.shape, self._picture.stride
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
        """View padded pixels as a picture."""
        picture = self._picture
        rows = padded[: -2 * LANES].reshape(-1, picture.stride)
        return rows[PAD:-PAD, PAD : PAD + picture.columns]

    def assemble(self, weight: Vector, link_x: Vector, link_y: Vector) -> None:
        """Take C and L_g.

        Parameters
        ----------
        weight : (H, W) float32
            c, the diagonal of C; above 0 somewhere.
        link_x : (H, W - 1) float32
            lambda a_x.
        link_y : (H - 1, W) float32
            lambda a_y.

        """
        picture, black = self._picture, self._black
        self._pixels(picture.weight)[:] = weight
        self._pixels(picture.links[0])[:, :-1] = link_x
        self._pixels(picture.links[2])[:-1] = link_y
        black.over(reduction.invert_red, picture)
        black.over(reduction.reduce_links, picture, black.lattice.links, black.lattice.excess)
        black.factorise()
        links, excess = picture.links, picture.weight
        for level, transfer in self._coarser:
            level.over(transfers.weigh_between, links, transfer)
            level.over(transfers.weigh_amid, links, transfer)
            level.over(transfers.galerkin, links, transfer, level.lattice.links)
            level.over(transfers.restrict, excess, transfer, level.lattice.excess)
            level.factorise()
            links, excess = level.lattice.links, level.lattice.excess

    def solve(self, data: Vector, tolerance: float, initial: Vector | None = None) -> Solution:
        """Solve for one b.

        Parameters
        ----------
        data : (H, W) float32
            b; anything finite where c is 0. The iteration starts from it.
        tolerance : float
            Largest error allowed, in the data's unit.
        initial : (H, W) float32, optional
            A guess, towards which the iteration takes its first step.

        Returns
        -------
        Solution
            Its values are overwritten by the next call.

        """
        black, picture, pixels = self._black, self._picture, self._pixel_values
        right, x, residual, _, p, Ap = self._vectors
        np.multiply(data, self._pixels(picture.weight), out=self._pixels(self._right_side))
        self._pixels(pixels)[:] = data
        black.over(reduction.reduce_right_side, picture, self._right_side, right)
        black.over(reduction.gather_black, picture, pixels, x)
        black.residual(right, x, residual)
        p.fill(0)
        Ap.fill(0)
        if initial is not None:
            np.subtract(initial, data, out=self._pixels(pixels))
            self._step_towards(pixels)
        rounding = _ROUNDING * max(abs(float(data.max())), abs(float(data.min())))
        iterations, error = self._iterate(max(tolerance, rounding))
        black.over(reduction.substitute, picture, self._right_side, x, pixels)
        return Solution(self._pixels(pixels), iterations, error + rounding)

    def _step_towards(self, pixels: Vector) -> None:
        """Change x along a direction as far as it becomes better."""
        black, (right, x, residual, z, p, Ap) = self._black, self._vectors
        black.over(reduction.gather_black, self._picture, pixels, z)
        sums = black.sums(gradient_kernels.turn, z, 0.0, residual, p, Ap)
        pAp, pr, _ = sums.sum(axis=0).tolist()
        if pAp > 0:
            black.over(gradient_kernels.step, black.lattice, pr / pAp, p, x)
            black.residual(right, x, residual)

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

    def _iterate(self, tolerance: float) -> tuple[int, float]:
        """Improve x by flexible conjugate gradients (Y. Notay, SIAM J. Sci. Comput. 22, 2000)."""
        black, (right, x, residual, z, p, Ap) = self._black, self._vectors
        progress = _Progress()
        errors: list[float] = []
        pAp = 1.0
        while _improves(errors):
            self._precondition(residual, z)
            sums = black.sums(gradient_kernels.measure, z, Ap)
            share = -float(sums[:, 0].sum()) / pAp if errors else 0.0
            largest = float(sums[:, 1].max())
            sums = black.sums(gradient_kernels.turn, z, share, residual, p, Ap)
            pAp, pr = sums[:, :2].sum(axis=0).tolist()
            if not (pAp > 0 and pr > 0):  # solved to the last digit
                errors.append(largest)
                break
            length = pr / pAp
            black.over(gradient_kernels.step, black.lattice, length, p, x)
            # anew, not updated by A p: what rounding leaves in it must not stay
            black.residual(right, x, residual)
            errors.append(progress.error(length, share, largest, length * float(sums[:, 2].max())))
            if errors[-1] <= tolerance:
                break
        return len(errors), errors[-1]


def _improves(errors: list[float]) -> bool:
    """Return whether the error still falls; at the limit of float32 it does not."""
    before, lately = errors[:-_PATIENCE], errors[-_PATIENCE:]
    return not before or min(lately) < 0.9 * min(before)


class _Progress:
    """What the iteration tells about the error that is left.

    With z = M^-1 r and the smallest eigenvalue s of M^-1 A, the error before a step is at most
    about max|z| / s. The step lets of it what the step before did, or what the condition number
    of M^-1 A promises conjugate gradients, whichever is more. The eigenvalues are those of the
    Lanczos matrix, whose entries the iteration yields; the smallest is expected to fall further.
    """

    def __init__(self) -> None:
        self._lengths: list[float] = []
        self._shares: list[float] = []
        self._smallest: list[float] = []
        self._changes: list[npt.NDArray[np.float64]] = []

    def error(self, length: float, share: float, largest_z: float, largest_step: float) -> float:
        """Return the estimated error after one more step."""
        self._lengths.append(length)
        self._shares.append(share)
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
        lengths, shares = np.array(self._lengths), np.maximum(self._shares, 0.0)[1:]
        diagonal = 1 / lengths
        diagonal[1:] += shares / lengths[:-1]
        beside = np.diag(np.sqrt(shares) / lengths[:-1], 1)
        values = np.linalg.eigvalsh(np.diag(diagonal) + beside + beside.T)
        return max(float(values[0]), _LEAST_EIGENVALUE), float(values[-1])
