# SPDX-License-Identifier: Apache-2.0
"""Normal equations of the adjustment: solved and inverted block by block.

Rods touch only their own marks, boards only their own rods: eliminating the rods, then the
boards, leaves one small system for the calibration (Schur complement), whatever their number.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from binocular_recon.camera import FloatArray
from binocular_recon.images import Mask

# Keeps a board's pose solvable where its marks leave a freedom (a single rod may turn about its
# axis): information of a turn known to 10 rad and a shift known to 1000 m.
_POSE_FLOOR = np.array([1e-2] * 3 + [1e-6] * 3)


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """``J^T W J`` and ``J^T W r`` in blocks; "shared" is a board's pose, then the calibration.

    Where boards bend, their warp belongs to the calibration.

    Attributes
    ----------
    rod : (B, R, f, f) float64
        Free deviations of each rod, its prior included.
    rod_shared : (B, R, f, 6 + n) float64
        Between a rod and the shared parameters.
    shared : (B, 6 + n, 6 + n) float64
        Shared parameters, summed over the board's marks.
    rod_rhs, shared_rhs : (B, R, f), (B, 6 + n) float64
        Right-hand sides.
    prior, prior_rhs : (n, n), (n,) float64
        What is known about the calibration beforehand.

    """

    rod: FloatArray
    rod_shared: FloatArray
    shared: FloatArray
    rod_rhs: FloatArray
    shared_rhs: FloatArray
    prior: FloatArray
    prior_rhs: FloatArray

    def solve(self, damping: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the steps of calibration (n,), boards (B, 6) and rods (B, R, f).

        ``damping`` is Levenberg and Marquardt's: each diagonal grows by that share.
        """
        rod = self.rod + damping * _diagonal(self.rod)
        lifted, rod_part = self._lifted(rod)
        pose = lifted[:, :6, :6] + damping * _diagonal(self.shared[:, :6, :6])
        rhs = self.shared_rhs - np.einsum('brfs,brf->bs', self.rod_shared, rod_part[..., -1])
        gain = np.linalg.solve(pose, np.concatenate([lifted[:, :6, 6:], rhs[:, :6, None]], -1))
        reduced = lifted[:, 6:, 6:].sum(0) - np.einsum(
            'bpc,bpd->cd', lifted[:, :6, 6:], gain[..., :-1]
        )
        total = self.shared[:, 6:, 6:].sum(0) + self.prior
        reduced += self.prior + damping * _diagonal(total)
        right = rhs[:, 6:].sum(0) - np.einsum('bpc,bp->c', lifted[:, :6, 6:], gain[..., -1])
        calibration = np.linalg.solve(reduced, right + self.prior_rhs)
        boards = gain[..., -1] - gain[..., :-1] @ calibration
        shared = np.concatenate([boards, np.tile(calibration, (len(boards), 1))], axis=-1)
        rods = rod_part[..., -1] - np.einsum('brfs,bs->brf', rod_part[..., :-1], shared)
        return calibration, boards, rods

    def select(self, boards: Mask) -> NormalEquations:
        """Return the equations of some of the boards, (B,) bool, with the same prior."""
        return replace(
            self,
            rod=self.rod[boards],
            rod_shared=self.rod_shared[boards],
            shared=self.shared[boards],
            rod_rhs=self.rod_rhs[boards],
            shared_rhs=self.shared_rhs[boards],
        )

    def board_information(self) -> FloatArray:
        """Return what each board says about the calibration alone, (B, n, n)."""
        lifted, _ = self._lifted(self.rod)
        gain = np.linalg.solve(lifted[:, :6, :6], lifted[:, :6, 6:])
        information: FloatArray = lifted[:, 6:, 6:] - np.einsum(
            'bpc,bpd->bcd', lifted[:, :6, 6:], gain
        )
        return information

    def covariance(self) -> tuple[FloatArray, FloatArray]:
        """Return the covariance of the calibration and of each rod with all that it depends on.

        Returns
        -------
        calibration : (n, n) float64
            Boards and rods marginalised.
        rods : (B, R, f + 6 + n, f + 6 + n) float64
            Rod, pose of its board, calibration.

        """
        lifted, rod_part = self._lifted(self.rod)
        pose_inverse = _inverses(lifted[:, :6, :6])
        gain = -pose_inverse @ lifted[:, :6, 6:]
        reduced = lifted[:, 6:, 6:].sum(0) + np.einsum('bpc,bpd->cd', lifted[:, :6, 6:], gain)
        calibration = inverse(reduced + self.prior)
        boards = _extended(
            pose_inverse, gain, np.broadcast_to(calibration, (len(gain), *calibration.shape))
        )
        rod_inverse = _inverses(self.rod)
        rod_gain = -rod_part[..., :-1]
        rods = _extended(
            rod_inverse,
            rod_gain,
            np.broadcast_to(boards[:, None], (*self.rod.shape[:2], *boards.shape[1:])),
        )
        return calibration, rods

    def _lifted(self, rod: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Eliminate the rods: shared information, and rod^-1 [rod_shared, rod_rhs]."""
        columns = np.concatenate([self.rod_shared, self.rod_rhs[..., None]], axis=-1)
        rod_part = np.linalg.solve(rod, columns)
        lifted = self.shared - np.einsum('brfs,brft->bst', self.rod_shared, rod_part[..., :-1])
        lifted[:, range(6), range(6)] += _POSE_FLOOR
        return lifted, rod_part


def _extended(inverse: FloatArray, gain: FloatArray, rest: FloatArray) -> FloatArray:
    """Return the covariance of (x, y): x = gain y plus an independent part, y ~ rest."""
    cross = gain @ rest
    own = inverse + cross @ np.swapaxes(gain, -1, -2)
    top = np.concatenate([own, cross], axis=-1)
    bottom = np.concatenate([np.swapaxes(cross, -1, -2), rest], axis=-1)
    return np.concatenate([top, bottom], axis=-2)


def _inverses(matrices: FloatArray) -> FloatArray:
    inverses: FloatArray = np.linalg.inv(matrices).astype(np.float64, copy=False)
    return inverses


def inverse(matrix: FloatArray) -> FloatArray:
    """Invert a positive definite matrix whose parameters have very different units."""
    scale = 1 / np.sqrt(np.diag(matrix))
    inverted: FloatArray = np.linalg.inv(matrix * scale[:, None] * scale) * scale[:, None] * scale
    return inverted


def _diagonal(matrix: FloatArray) -> FloatArray:
    """Return the matrices (..., n, n) with everything off the diagonal zero."""
    return matrix * np.eye(matrix.shape[-1])
