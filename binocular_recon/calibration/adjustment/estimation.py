# SPDX-License-Identifier: Apache-2.0
"""The adjustment with what it must find out by itself: noise of the marks, outliers, bad boards.

Rounds of adjusting and judging: each mark is judged by its residual against what its board
still lets it show (Baarda's data snooping), each board by the typical residual of its marks, and
the noise by the residuals and their redundancy (variance components; Koch, "Parameter
Estimation and Hypothesis Testing in Linear Models", section 3.6).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from binocular_recon.calibration.adjustment._board_faults import fault
from binocular_recon.calibration.adjustment.bundle_adjustment import (
    HUBER,
    Problem,
    minimise,
    normal_equations,
    weighted_rows,
)
from binocular_recon.calibration.adjustment.linearisation import State, linearise
from binocular_recon.calibration.adjustment.planar import MIN_MARKS
from binocular_recon.camera import FloatArray
from binocular_recon.images import Mask
from binocular_recon.number_text import significant

# A mark farther off than this many standard deviations (of both axes together) is left out: one
# good mark in 100,000 is.
MARK_LIMIT = 4.8
# Smaller errors are left in, px: noise differs from board to board (distance, light, blur), and
# the robust loss takes care of the rest.
ERROR_FLOOR_PX = 0.25
# A board whose typical residual is this many times that of all marks is left out.
BOARD_LIMIT = 2.5
# Share of a board's marks that may be left out before the whole board is.
BOARD_MARK_LOSS = 0.35
# Stated placement sigmas are believed unless the rods contradict them by this factor.
PLACEMENT_LIMIT = 1.5
_ROUNDS = 20
# From this round with the same boards on, marks left out stay so: some would come and go for ever.
_RESTORING_ROUNDS = 5
# Fewer boards are not enough to judge one of them (and to calibrate, see solve.py).
MIN_BOARDS = 3
# median of the length of a two-dimensional standard normal vector
_MEDIAN_LENGTH = np.sqrt(2 * np.log(2))


@dataclass(frozen=True, eq=False)
class Estimate:
    """A finished adjustment.

    Attributes
    ----------
    problem : Problem
        With outliers removed, the noise found and the placement scale applied.
    state : State
        Calibration, boards, rods.
    boards : (B,) int
        Which of the given boards were used; the arrays of ``problem`` and ``state`` hold these.
    outliers : (B, R, M, 2) bool
        Marks of the used boards that were left out.
    bad_boards : dict of int to str
        Boards left out and why.
    shared_covariance : (n + w, n + w) float64
        Of the n free parameters of the calibration and then of the w parts of the boards' warp
        (2; 0 on boards that do not bend), as the noise of the marks makes it.
    settled : bool
        Whether outliers and noise stayed the same in the last round.
    inflation : float
        Factor on all standard deviations, found by comparing halves of the boards
        (`split_halves`).

    """

    problem: Problem
    state: State
    boards: tuple[int, ...]
    outliers: Mask
    bad_boards: dict[int, str]
    shared_covariance: FloatArray
    settled: bool = True
    inflation: float = 1.0

    @property
    def covariance(self) -> FloatArray:
        """Of the free parameters of the calibration, warp and boards marginalised, (n, n)."""
        count = int(self.problem.free.sum())
        return self.inflation**2 * self.shared_covariance[:count, :count]

    @property
    def warp_sigma_m(self) -> FloatArray:
        """One standard deviation of both parts of the warp, (w,) m."""
        variances = np.diag(self.shared_covariance)[int(self.problem.free.sum()) :]
        sigma: FloatArray = self.inflation * np.sqrt(variances)
        return sigma

    @property
    def full_covariance(self) -> FloatArray:
        """Covariance of all parameters of the calibration, (p, p); 0 for those not estimated."""
        free = self.problem.free
        full = np.zeros((free.size, free.size))
        full[np.ix_(free, free)] = self.covariance
        return full


@dataclass(frozen=True, eq=False)
class Fit:
    """How well the marks and rods fit a state.

    Attributes
    ----------
    lengths : (B, R, M, 2) float64
        Residual of each mark, both axes together, in the standard deviations it should have by
        the robust noise; NaN = not found.
    errors_px : (B, R, M, 2) float64
        The same in px.
    sigma_px : (2,) or (2, 2) float64
        Noise of u and v from the marks used (variance components), as in `Problem`.
    robust_sigma_px : (2,) or (2, 2) float64
        Noise of u and v from the median residual of all marks.
    placement_scale : (5,) float64
        Spread of the rods against each stated sigma; 1 where they are exact.

    """

    lengths: FloatArray
    errors_px: FloatArray
    sigma_px: FloatArray
    robust_sigma_px: FloatArray
    placement_scale: FloatArray

    @property
    def outliers(self) -> Mask:
        """Marks that do not fit, (B, R, M, 2)."""
        return (self.lengths > MARK_LIMIT) & (self.errors_px > ERROR_FLOOR_PX)


def estimate(problem: Problem, state: State) -> Estimate:
    """Adjust, leave out what does not fit, and find the noise of the marks.

    Parameters
    ----------
    problem : Problem
        All marks; ``sigma_px`` is a first guess.
    state : State
        Where to start, such as the planar calibration.

    Returns
    -------
    Estimate

    Raises
    ------
    CalibrationError
        If the solution diverges or most boards contradict each other.

    """
    given = problem.observed_px
    boards = np.arange(len(given))
    bad_boards: dict[int, str] = {}
    settled, rounds = True, 0
    for _ in range(len(boards) + _ROUNDS):
        state = minimise(problem, state)
        fit = judge(problem, given[boards], state)
        worst, reason = _worst_board(fit)
        if worst is not None and len(boards) > MIN_BOARDS:
            bad_boards[int(boards[worst])] = reason
            keep = np.arange(len(boards)) != worst
            boards, state = boards[keep], state.select(keep)
            problem = replace(problem, observed_px=given[boards], sigma_px=fit.robust_sigma_px)
            rounds = 0
            continue
        rounds += 1
        following = _improved(problem, given[boards], fit, restore=rounds < _RESTORING_ROUNDS)
        if _settled(problem, following):
            break
        problem = following
    else:
        state = minimise(problem, state)
        fit = judge(problem, given[boards], state)
        settled = False
    for board in bad_boards:
        if contradiction := fault(state.calibration, problem.target.nominal_m, given[board]):
            bad_boards[board] = contradiction
    covariance, _ = normal_equations(problem, state).covariance()
    return Estimate(
        problem=problem,
        state=state,
        boards=tuple(boards.tolist()),
        outliers=~problem.seen & np.isfinite(fit.lengths),
        bad_boards=bad_boards,
        shared_covariance=covariance,
        settled=settled,
    )


def judge(problem: Problem, given_px: FloatArray, state: State) -> Fit:
    """Compare all marks given, (B, R, M, 4) px, with a state fitted to those in ``problem``."""
    everything = replace(problem, observed_px=given_px)
    used, seen = problem.seen, everything.seen
    predicted, jacobians = linearise(state, problem.target)
    residuals = everything.residuals(predicted)
    rods, shared = weighted_rows(everything, jacobians, seen.astype(np.float64))
    rows = np.concatenate([rods, shared], axis=-1)
    _, joint = normal_equations(problem, state).covariance()
    leverage = np.sum((rows @ joint) * rows, axis=-1).reshape(residuals.shape)
    # a mark that was used pulled the state towards it, another one did not
    variance = np.where(used[..., None], np.maximum(1 - leverage, 0.05), 1 + leverage)
    shape, floor_px = problem.sigma_px.shape, problem.floor_px
    typical = [
        np.median(np.abs(residuals[group] / np.sqrt(variance[group])), axis=0) / 0.6745
        for group in problem.sharing(seen)
    ]
    robust = np.maximum(np.reshape(typical, shape), floor_px / problem.sigma_px)
    components = np.reshape(
        [
            np.sqrt((residuals[group] ** 2).sum(axis=0) / variance[group].sum(axis=0))
            for group in problem.sharing(used)
        ],
        shape,
    )
    standardised = np.where(seen[..., None], residuals / np.sqrt(variance), np.nan)
    return Fit(
        lengths=np.linalg.norm(standardised / robust, axis=-1),
        errors_px=np.linalg.norm(standardised * problem.sigma_px, axis=-1),
        sigma_px=np.maximum(components * problem.sigma_px, floor_px),
        robust_sigma_px=robust * problem.sigma_px,
        placement_scale=_placement_scale(problem, state, joint),
    )


def _placement_scale(problem: Problem, state: State, joint: FloatArray) -> FloatArray:
    """Return the spread of the rods against the stated sigmas, (5,)."""
    scale = np.ones(5)
    free = problem.free_deviations
    count = int(free.sum())
    variances = np.einsum('brff->brf', joint[..., :count, :count]) / problem.rod_sigmas**2
    # a single rod that was knocked over says nothing about the others
    spread = np.minimum(problem.rod_residuals(state) ** 2, HUBER**2).sum(axis=(0, 1))
    redundancy = np.maximum((1 - variances).sum(axis=(0, 1)), 1.0)
    scale[free] = problem.placement_scale[free] * np.sqrt(spread / redundancy)
    return scale


def _improved(problem: Problem, given_px: FloatArray, fit: Fit, *, restore: bool) -> Problem:
    """Return the problem with outliers left out and the noise that was found.

    ``restore``: marks that were left out come back if they fit by now.
    """
    good = np.repeat(~fit.outliers & (problem.seen | restore), 2, axis=-1)
    first_guess = (np.maximum(fit.sigma_px, problem.sigma_px) > 1.5 * fit.robust_sigma_px).any()
    return replace(
        problem,
        observed_px=np.where(good, given_px, np.nan),
        sigma_px=fit.robust_sigma_px if first_guess else fit.sigma_px,
        placement_scale=np.where(fit.placement_scale > PLACEMENT_LIMIT, fit.placement_scale, 1.0),
    )


def _settled(problem: Problem, following: Problem) -> bool:
    return bool(
        np.array_equal(problem.seen, following.seen)
        and np.allclose(problem.sigma_px, following.sigma_px, rtol=0.01)
        and np.allclose(problem.placement_scale, following.placement_scale, rtol=0.03)
    )


def _worst_board(fit: Fit) -> tuple[int | None, str]:
    """Return the board that fits least and why, None if all fit."""
    count = len(fit.lengths)
    lengths, errors_px = (a.reshape(count, -1) for a in (fit.lengths, fit.errors_px))
    typical = np.minimum(
        np.nanmedian(lengths, axis=1) / (_MEDIAN_LENGTH * BOARD_LIMIT),
        np.nanmedian(errors_px, axis=1) / ERROR_FLOOR_PX,
    )
    lost = fit.outliers.reshape(count, -1).sum(axis=1) / np.isfinite(lengths).sum(axis=1)
    score = np.maximum(typical, lost / BOARD_MARK_LOSS)
    worst = int(np.argmax(score))
    if score[worst] > 1:
        return worst, _reason(fit, worst)
    good = np.isfinite(fit.lengths) & ~fit.outliers
    left = good.sum(axis=(1, 2)).min(axis=1)
    worst = int(np.argmin(left))
    if left[worst] < MIN_MARKS:
        return worst, (
            f'too few marks of one image fit: {left[worst]}, at least {MIN_MARKS} are needed'
        )
    return None, ''


def _reason(fit: Fit, board: int) -> str:
    errors_px = fit.errors_px[board][np.isfinite(fit.errors_px[board])]
    return (
        f'its marks are off by {significant(np.median(errors_px), 2)} px, those of all boards by'
        f' {significant(np.nanmedian(fit.errors_px), 2)} px; a rod moved between its two'
        ' images, or they are blurred'
    )
