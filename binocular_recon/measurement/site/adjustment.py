# SPDX-License-Identifier: Apache-2.0
"""Tie a rig to control points, check the result, and name a control point that is wrong.

Source: Baarda, "A testing procedure for use in geodetic networks" (1968).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import special

from binocular_recon.camera import FloatArray
from binocular_recon.errors import MeasurementError
from binocular_recon.measurement.frame import MeasuredFrame
from binocular_recon.measurement.site.control_points import ControlPoint
from binocular_recon.measurement.site.fitting import LEAST_POINTS, PointError, Problem
from binocular_recon.measurement.site.tie import SiteTie
from binocular_recon.measurement.uncertain import Uncertain
from binocular_recon.number_text import fixed, significant

# Control points must be off a line by this share of their extent, and this many sigma.
LEAST_SPREAD, LEAST_SPREAD_SIGMAS = 0.02, 5.0
# Chance that right control points are refused.
FALSE_ALARM = 0.001


@dataclass(frozen=True, eq=False)
class Adjustment:
    """The result of `adjust`.

    Attributes
    ----------
    tie : SiteTie
    residuals : dict of str to PointError
        Of the control points.
    left_out : dict of str to PointError
        Of each control point, from the others alone; empty if there are three.
    checks : dict of str to PointError
        Of the check points.
    scale, scale_sigma : float
        Lengths on the site over those of the rig, and one standard deviation; nan if it was held.

    """

    tie: SiteTie
    residuals: dict[str, PointError]
    left_out: dict[str, PointError]
    checks: dict[str, PointError]
    scale: float
    scale_sigma: float


def adjust(
    points: Sequence[Uncertain],
    control: Sequence[ControlPoint],
    frame: MeasuredFrame,
    *,
    free_scale: bool = False,
    scale: float = 1.0,
) -> Adjustment:
    """Return the transformation to the frame of the site.

    Parameters
    ----------
    points : sequence of Uncertain
        The picked points, (3,) m each, in the rectified frame.
    control : sequence of ControlPoint
        What is known of them; those with ``check`` only check.
    frame : MeasuredFrame
        A frame with the rig's calibration.
    free_scale : bool
        Whether the scale is estimated too.
    scale : float
        Scale that is held otherwise, or at the start: 1, or that of a map's grid.

    Raises
    ------
    MeasurementError
        If there are less than three control points, they are on one line, or one of them is
        wrong; the message names it.

    """
    problem = Problem(points, control, free_scale, scale)
    used = problem.control
    _check_spread(problem, used)
    fit = problem.fit(used)
    freedom = 3 * len(used) - problem.parameters
    misfit = problem.misfit(fit, used)
    left_out = {}
    if len(used) > LEAST_POINTS:
        for index in used:
            others = [one for one in used if one != index]
            if not _on_a_line(problem, others):
                error = problem.error(problem.fit(others), others, index)
                left_out[control[index].name] = error
    if misfit > special.chdtri(freedom, FALSE_ALARM):
        raise MeasurementError(_blunder(problem, control, used, misfit / freedom))
    residuals = {control[i].name: problem.error(fit, used, i) for i in used}
    checks = {one.name: problem.error(fit, used, i) for i, one in enumerate(control) if one.check}
    tie = problem.tie(fit, frame)
    variance = tie.covariance[6, 6]
    if frame.rig.covariance is not None and tie.calibration.size:
        gradient = tie.calibration[6]
        variance = variance + gradient @ frame.rig.covariance.matrix @ gradient
    return Adjustment(
        tie,
        residuals,
        left_out,
        checks,
        fit.scale,
        float(fit.scale * np.sqrt(variance)) if free_scale else float('nan'),
    )


def _on_a_line(problem: Problem, used: Sequence[int]) -> bool:
    return bool(_spread(problem, used)[1] < _least_spread(problem, used))


def _spread(problem: Problem, used: Sequence[int]) -> FloatArray:
    """Return how far points reach along and across the line that fits them best, RMS, m."""
    places = problem.site[list(used)]
    spread = np.linalg.svd(places - places.mean(axis=0), compute_uv=False) / np.sqrt(len(places))
    return np.append(spread, 0.0) if len(spread) < 3 else spread


def _least_spread(problem: Problem, used: Sequence[int]) -> float:
    along = float(_spread(problem, used)[0])
    sigma = float(problem.sigma[list(used)].max())
    return max(LEAST_SPREAD * along, LEAST_SPREAD_SIGMAS * sigma)


def _check_spread(problem: Problem, used: Sequence[int]) -> None:
    if _on_a_line(problem, used):
        spread = _spread(problem, used)
        raise MeasurementError(
            f'the {len(used)} control points lie on one line, {significant(spread[0])} m along it'
            f' and {significant(spread[1])} m off it (RMS;'
            f' {significant(_least_spread(problem, used))} m is the least), so the turn about it'
            ' is unknown; add one to the side of it'
        )


def _blunder(
    problem: Problem, control: Sequence[ControlPoint], used: Sequence[int], factor: float
) -> str:
    """Return which control point is wrong, as far as that can be known."""
    off = f'residuals are {factor**0.5:.1f} times as large as the sigmas say'
    if len(used) == LEAST_POINTS:
        return (
            f'the three control points contradict each other ({off}); check their coordinates,'
            ' names and picks; a fourth tells which one is wrong'
        )
    suspects = []
    for index in used:
        others = [one for one in used if one != index]
        if not _on_a_line(problem, others):
            fit = problem.fit(others)
            error = problem.error(fit, others, index)
            suspects.append((problem.misfit(fit, others), index, error))
    limit = special.chdtri(3 * (len(used) - 1) - problem.parameters, FALSE_ALARM)
    if not suspects or min(suspects, key=lambda one: one[0])[0] > limit:
        return (
            f'the control points contradict each other ({off}), and more than one is wrong; check'
            ' coordinates, names and picks'
        )
    _, index, error = min(suspects, key=lambda one: one[0])
    place = ', '.join(
        f'{axis} {fixed(value, 3)} +- {fixed(sigma, 3)} m'
        for axis, value, sigma in zip('xyz', error.off_m, error.sigma_m, strict=True)
    )
    return (
        f'control point {control[index].name} is {np.linalg.norm(error.off_m):.3f} m from where'
        f' the others put it ({place}); correct its coordinates, name or pick, or leave it out'
        f' (--leave-out {control[index].name})'
    )
