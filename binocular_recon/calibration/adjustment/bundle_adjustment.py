# SPDX-License-Identifier: Apache-2.0
"""Joint adjustment of both cameras, all boards and every rod (maximum a posteriori).

Minimises, over calibration, board poses and rod deviations q,

    sum_marks rho(|r| / sigma_px) + sum_rods rho(|q| / sigma_q) + calibration prior

and, for boards of points, over the warp that all of them share, with its prior;
with rho quadratic near 0 and linear far out (Huber), by Levenberg and Marquardt's method. The
spacing of the marks along a rod is exact; the arrangement of the rods is only a prior, since
crews place rods to millimetres at best. Source: Triggs et al., "Bundle Adjustment - A Modern
Synthesis" (2000), sections 3, 6 and 9.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field

import numpy as np

from binocular_recon.calibration.adjustment._normal_equations import NormalEquations
from binocular_recon.calibration.adjustment.linearisation import (
    Jacobians,
    State,
    linearise,
    predict,
)
from binocular_recon.calibration.model import (
    DEFAULT_LENS,
    StereoCalibration,
    check_finite,
    parameters_of,
)
from binocular_recon.calibration.target.target import Target
from binocular_recon.camera import FloatArray
from binocular_recon.images import Mask
from binocular_recon.lenses.registry import LENSES

# rho turns linear here: 99 % of Gaussian errors stay in the quadratic part, which keeps the
# estimate within 1 % of the best possible one.
HUBER = 3.0
# One standard deviation of what is known of every lens beforehand: the coefficients of a
# distortion-free lens, and square pixels. Wide enough for any lens the model suits; it only
# keeps few boards from being explained by one that does not invert.
DISTORTION_SIGMA, TANGENTIAL_SIGMA = 0.5, 0.005
ASPECT_SIGMA = 0.003
# Smallest noise of a mark that is believed, px (marks without noise would void the priors).
NOISE_FLOOR_PX = 1e-3
# Marks of a rod lie on a line fitted to its sides: the error of that line, px, is common to them
# and shows in no residual, because the rod may stand a little elsewhere.
ROD_ERROR_PX = 0.05
MAX_ITERATIONS = 100


def free_parameters(coefficients: Collection[str], lens: str = DEFAULT_LENS) -> Mask:
    """Return which parameters are estimated, (p,) bool, with these distortion terms of a lens."""
    fixed = {f'{name}_{side}' for name in LENSES[lens].COEFFICIENTS for side in ('left', 'right')}
    fixed -= {f'{name}_{side}' for name in coefficients for side in ('left', 'right')}
    return np.array([name not in fixed for name in parameters_of(lens)])


@dataclass(frozen=True, eq=False)
class Problem:
    """What is adjusted to what.

    Attributes
    ----------
    target : Target
        Rods, and how well their places are known.
    observed_px : (B, R, M, 4) float64
        Marks: left u, left v, right u, right v; NaN = not found.
    free : (p,) bool
        Parameters of the calibration that are estimated.
    sigma_px : (2,) or (2, 2) float64
        One standard deviation of a mark's u and v: of both cameras, or a row for each.
    pixel_px : (2,) float64
        Pixels of ``observed_px`` per pixel of each camera, where the cameras differ in size.
    placement_scale : (5,) float64
        Factor on each of the target's sigmas.

    """

    target: Target
    observed_px: FloatArray
    free: Mask
    sigma_px: FloatArray
    pixel_px: FloatArray = field(default_factory=lambda: np.ones(2))
    placement_scale: FloatArray = field(default_factory=lambda: np.ones(5))

    @property
    def seen(self) -> Mask:
        """Marks found, per camera: (B, R, M, 2)."""
        shape = (*self.observed_px.shape[:-1], 2, 2)
        seen: Mask = np.all(np.isfinite(self.observed_px).reshape(shape), axis=-1)
        return seen

    @property
    def free_deviations(self) -> Mask:
        """Deviations of a rod that are estimated, (5,)."""
        free: Mask = self.target.sigmas > 0
        return free

    @property
    def rod_sigmas(self) -> FloatArray:
        """One standard deviation of each free deviation of a rod, (f,)."""
        sigmas: FloatArray = (self.placement_scale * self.target.sigmas)[self.free_deviations]
        return sigmas

    @property
    def warp_information(self) -> FloatArray:
        """What is known of the warp beforehand, (w,) 1/m^2; w = 0 on boards that do not bend."""
        sigma = self.target.warp_sigma_m
        return np.full(2, sigma**-2) if self.target.bends else np.zeros(0)

    @property
    def floor_px(self) -> FloatArray:
        """Smallest noise of a mark that is believed, of the shape of ``sigma_px``.

        An error common to the M marks of a rod weighs as much as independent errors sqrt(M) as
        large.
        """
        floor = np.full(2, NOISE_FLOOR_PX)
        if self.target.has_rods:
            floor = ROD_ERROR_PX * np.array([np.sqrt(self.target.shape[1]), 1.0])
        return floor if self.sigma_px.ndim == 1 else np.outer(self.pixel_px, floor)

    def sharing(self, marks: Mask) -> tuple[Mask, ...]:
        """Return marks (B, R, M, 2) in groups of one noise: all, or those of each camera."""
        if self.sigma_px.ndim == 1:
            return (marks,)
        return tuple(marks & (np.arange(2) == camera) for camera in range(2))

    def residuals(self, predicted_px: FloatArray) -> FloatArray:
        """Return observed - predicted in standard deviations, (B, R, M, 2, 2); 0 = not found."""
        split = (*self.observed_px.shape[:-1], 2, 2)
        residuals = (self.observed_px - predicted_px).reshape(split) / self.sigma_px
        return np.where(self.seen[..., None], residuals, 0.0)

    def rod_residuals(self, state: State) -> FloatArray:
        """Return the rods' deviations in standard deviations, (B, R, f)."""
        deviations: FloatArray = state.deviations[..., self.free_deviations]
        return deviations / self.rod_sigmas


def minimise(problem: Problem, state: State) -> State:
    """Return the state with the least cost near ``state``.

    Raises
    ------
    CalibrationError
        If the solution diverges.

    """
    damping, least = 1e-4, cost(problem, state)
    for _ in range(MAX_ITERATIONS):
        equations = normal_equations(problem, state)
        improved = False
        while not improved and damping < 1e8:
            candidate = _moved(problem, state, equations.solve(damping))
            candidate_cost = cost(problem, candidate)
            improved = candidate_cost < least  # False for NaN
            damping *= 0.1 if improved else 10.0
        if not improved:
            break
        gain, state, least = least - candidate_cost, candidate, candidate_cost
        if gain <= 1e-9 * least + 1e-12:
            break
    check_finite(state.calibration)
    return state


def cost(problem: Problem, state: State) -> float:
    """Return the value that `minimise` minimises."""
    residuals = np.linalg.norm(problem.residuals(predict(state, problem.target)), axis=-1)
    rods = np.abs(problem.rod_residuals(state))
    prior, _ = _calibration_prior(state.calibration)
    values = _parameters(state.calibration)
    warp = problem.warp_information
    bent = 0.5 * warp @ state.warp_m[: len(warp)] ** 2
    known = 0.5 * values @ prior @ values
    return float(_loss(residuals).sum() + _loss(rods).sum() + known + bent)


def normal_equations(problem: Problem, state: State) -> NormalEquations:
    """Return the normal equations at ``state``, with the weights of the robust loss.

    The block of the calibration holds its n free parameters and then the w parts of the warp.
    """
    predicted, jacobians = linearise(state, problem.target)
    residuals = problem.residuals(predicted)
    rod_residuals = problem.rod_residuals(state)
    weights = _weights(np.linalg.norm(residuals, axis=-1)) * problem.seen
    rods, shared = weighted_rows(problem, jacobians, np.sqrt(weights))
    errors = (np.sqrt(weights)[..., None] * residuals).reshape(*rods.shape[:3])
    rod_weights = _weights(np.abs(rod_residuals))
    sigmas = problem.rod_sigmas
    rods_T = np.swapaxes(rods, -1, -2)
    rod = rods_T @ rods
    free = range(rod.shape[-1])
    rod[..., free, free] += rod_weights / sigmas**2
    rod_rhs = (rods_T @ errors[..., None])[..., 0] - rod_weights * rod_residuals / sigmas
    shared_rows = shared.reshape(len(shared), -1, shared.shape[-1])
    shared_T = np.swapaxes(shared_rows, -1, -2)
    prior, prior_rhs = _shared_prior(problem, state)
    return NormalEquations(
        rod=rod,
        rod_shared=rods_T @ shared,
        shared=shared_T @ shared_rows,
        rod_rhs=rod_rhs,
        shared_rhs=(shared_T @ errors.reshape(len(errors), -1, 1))[..., 0],
        prior=prior,
        prior_rhs=prior_rhs,
    )


def weighted_rows(
    problem: Problem, jacobians: Jacobians, weights: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the rows of the rods' and of the shared Jacobian in standard deviations.

    Parameters
    ----------
    weights : (B, R, M, 2) float64
        Factor of each mark of each camera; 0 = not found.

    Returns
    -------
    rods : (B, R, 4 M, f) float64
        By the rod's free deviations.
    shared : (B, R, 4 M, 6 + n + w) float64
        By the board's pose, the free parameters of the calibration and the warp.

    """
    scale = (weights[..., None] / problem.sigma_px).reshape(*weights.shape[:-1], 4, 1)
    shape = (*weights.shape[:2], 4 * weights.shape[2], -1)
    rods = jacobians.rod[..., problem.free_deviations] * scale
    calibration = jacobians.calibration[..., problem.free]
    shared = np.concatenate([jacobians.board, calibration, jacobians.warp], axis=-1) * scale
    return rods.reshape(*shape[:-1], rods.shape[-1]), shared.reshape(*shape[:-1], shared.shape[-1])


def _loss(residuals: FloatArray) -> FloatArray:
    linear = HUBER * (residuals - 0.5 * HUBER)
    return np.where(residuals <= HUBER, 0.5 * residuals**2, linear)


def _weights(residuals: FloatArray) -> FloatArray:
    return HUBER / np.maximum(residuals, HUBER)


def _parameters(calibration: StereoCalibration) -> FloatArray:
    """Return the intrinsics as the prior sees them, (p,): fx, fy, 0, 0, distortion; then 0."""
    values = np.zeros(len(calibration.parameters))
    for index, side in enumerate(('left', 'right')):
        K, D, _, _ = calibration.side(side)
        start = index * (4 + D.size)
        values[start : start + 2] = K[0, 0], K[1, 1]
        values[start + 4 : start + 4 + D.size] = D
    return values


def _calibration_prior(calibration: StereoCalibration) -> tuple[FloatArray, FloatArray]:
    """Return the prior's information (p, p) and right-hand side (p,)."""
    lens = calibration.lens_model
    names, tangential = lens.COEFFICIENTS, lens.TANGENTIAL
    sigmas = np.array([TANGENTIAL_SIGMA if n in tangential else DISTORTION_SIGMA for n in names])
    count = len(calibration.parameters)
    prior = np.zeros((count, count))
    for start, K in ((0, calibration.K_left), (4 + len(names), calibration.K_right)):
        # square pixels: (fx - fy) / f ~ N(0, ASPECT_SIGMA)
        difference = np.array([1.0, -1.0]) / (ASPECT_SIGMA * np.sqrt(K[0, 0] * K[1, 1]))
        prior[start : start + 2, start : start + 2] = np.outer(difference, difference)
        terms = np.arange(start + 4, start + 4 + len(names))
        prior[terms, terms] = 1 / sigmas**2
    return prior, -prior @ _parameters(calibration)


def _shared_prior(problem: Problem, state: State) -> tuple[FloatArray, FloatArray]:
    """Return the prior of free parameters and warp: (n + w, n + w), right-hand side (n + w,)."""
    free, warp = problem.free, problem.warp_information
    calibration, calibration_rhs = _calibration_prior(state.calibration)
    count = int(free.sum())
    prior = np.zeros((count + len(warp),) * 2)
    prior[:count, :count] = calibration[np.ix_(free, free)]
    prior[range(count, len(prior)), range(count, len(prior))] = warp
    return prior, np.r_[calibration_rhs[free], -warp * state.warp_m[: len(warp)]]


def _moved(
    problem: Problem, state: State, steps: tuple[FloatArray, FloatArray, FloatArray]
) -> State:
    calibration, count = np.zeros(len(problem.free)), int(problem.free.sum())
    calibration[problem.free] = steps[0][:count]
    rods = np.zeros_like(state.deviations)
    rods[..., problem.free_deviations] = steps[2]
    warp_m = steps[0][count:] if problem.target.bends else None
    return state.moved(calibration, steps[1], rods, warp_m)
