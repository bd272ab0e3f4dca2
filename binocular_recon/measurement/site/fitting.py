# SPDX-License-Identifier: Apache-2.0
"""The rigid transformation between points of two frames, by generalised least squares.

All errors count with their correlation: of the control points, of picks and matching, and of the
calibration, which all points share.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy import special

from binocular_recon.camera import FloatArray
from binocular_recon.errors import MeasurementError
from binocular_recon.io.exports.placement import PARAMETERS
from binocular_recon.measurement.frame import MeasuredFrame
from binocular_recon.measurement.site.control_points import ControlPoint
from binocular_recon.measurement.site.tie import SiteTie
from binocular_recon.measurement.uncertain import CALIBRATION, Uncertain, joined
from binocular_recon.number_text import counted
from binocular_recon.rotations import rigid_fit, rotation, similarity_derivatives

LEAST_POINTS = 3
_ITERATIONS = 20
# Share of right points that are called odd: those beyond 3 sigma of one value.
_ODD_SHARE = special.erfc(3 / np.sqrt(2))
# Directions of a covariance with less than this of its largest variance have no error at all, as
# those of residuals that the fit takes up.
_LEAST_VARIANCE = 1e-9


class PointError(NamedTuple):
    """What a point is off, given minus transformed (3,), m, and one standard deviation of it."""

    off_m: FloatArray
    sigma_m: FloatArray
    covariance: FloatArray

    @property
    def is_odd(self) -> bool:
        """Whether the error is larger than its covariance explains, as beyond 3 sigma.

        The one rule for control and check points: messages and reports take it from here.
        """
        variances, axes = np.linalg.eigh(self.covariance)
        free = variances > _LEAST_VARIANCE * variances[-1]
        squared = (self.off_m @ axes[:, free]) ** 2 / variances[free]
        return bool(squared.sum() > special.chdtri(np.count_nonzero(free), _ODD_SHARE))


class Fit(NamedTuple):
    """A transformation and how it moves with errors of given minus transformed places (7, 3 n)."""

    R: FloatArray
    scale: float
    pivot: FloatArray
    pivot_site: FloatArray
    gain: FloatArray


class Problem:
    """The points of both frames, and the covariance of their differences."""

    def __init__(
        self,
        points: Sequence[Uncertain],
        control: Sequence[ControlPoint],
        free_scale: bool,
        scale: float,
    ) -> None:
        self.free_scale, self._scale = free_scale, scale
        self.parameters = PARAMETERS if free_scale else PARAMETERS - 1
        self.control = [i for i, one in enumerate(control) if not one.check]
        if len(self.control) < LEAST_POINTS:
            raise MeasurementError(
                f'the table has {counted(len(self.control), "control point")}, {LEAST_POINTS} that'
                ' are not on one line are the least; without them --level makes the vertical'
                ' right'
            )
        self.all = joined(*points)
        self.places = self.all.values.reshape(-1, 3)
        self._spread = self.all.covariance
        self.site = np.stack([one.place for one in control])
        self.sigma = np.stack([one.sigma_m for one in control])

    def fit(self, used: Sequence[int]) -> Fit:
        """Return the best transformation of some points."""
        here, there = self.places[used], self.site[used]
        pivot, pivot_site = here.mean(axis=0), there.mean(axis=0)
        R = rigid_fit(here, there)[0]
        scale = self._scale
        for _ in range(_ITERATIONS):
            weight = np.linalg.inv(self.covariance(R, scale, used))
            turned = scale * (here - pivot) @ R.T
            design = self.design(turned)[:, : self.parameters]
            gain = np.linalg.solve(design.T @ weight @ design, design.T @ weight)
            step = np.zeros(PARAMETERS)
            step[: self.parameters] = gain @ (there - pivot_site - turned).ravel()
            R = rotation(step[:3]) @ R
            pivot_site = pivot_site + step[3:6]
            scale *= 1 + step[6]
            if np.abs(step).max() < 1e-12:
                break
        full = np.zeros((PARAMETERS, 3 * len(used)))
        full[: self.parameters] = gain
        return Fit(R, float(scale), pivot, pivot_site, full)

    def covariance(self, R: FloatArray, scale: float, used: Sequence[int]) -> FloatArray:
        """Return that of given minus transformed places of some points, (3 n, 3 n), m^2."""
        rows = (3 * np.asarray(used)[:, None] + np.arange(3)).ravel()
        turn = np.kron(np.eye(len(used)), scale * R)
        covariance: FloatArray = turn @ self._spread[np.ix_(rows, rows)] @ turn.T
        return covariance + np.diag(self.sigma[used].ravel() ** 2)

    @staticmethod
    def design(turned: FloatArray) -> FloatArray:
        """Return how places (n, 3) about the pivot move with the parameters, (3 n, 7)."""
        return similarity_derivatives(turned).reshape(-1, PARAMETERS)

    def off(self, fit: Fit, used: Sequence[int]) -> FloatArray:
        """Return given minus transformed places, (n, 3) m."""
        turned = fit.scale * (self.places[used] - fit.pivot) @ fit.R.T
        off: FloatArray = self.site[used] - fit.pivot_site - turned
        return off

    def misfit(self, fit: Fit, used: Sequence[int]) -> float:
        """Return the squared sum of residuals in units of their covariance."""
        off = self.off(fit, used).ravel()
        return float(off @ np.linalg.solve(self.covariance(fit.R, fit.scale, used), off))

    def error(self, fit: Fit, used: Sequence[int], index: int) -> PointError:
        """Return the error of a point by the fit to the points ``used``."""
        both = [*used, index]
        turned = fit.scale * (self.places[[index]] - fit.pivot) @ fit.R.T
        effect = np.hstack([-self.design(turned) @ fit.gain, np.eye(3)])
        covariance = effect @ self.covariance_of(fit, both) @ effect.T
        sigma = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        return PointError(self.off(fit, [index])[0], sigma, covariance)

    def covariance_of(self, fit: Fit, both: Sequence[int]) -> FloatArray:
        """Return that of points, of which the last may be one of the others again."""
        covariance = self.covariance(fit.R, fit.scale, both)
        last = both[-1]
        for position, one in enumerate(both[:-1]):
            if one == last:  # its given place is the same, with the same error
                rows = 3 * position + np.arange(3)
                shared = self.sigma[last] ** 2
                covariance[rows, 3 * (len(both) - 1) + np.arange(3)] += shared
                covariance[3 * (len(both) - 1) + np.arange(3), rows] += shared
        return covariance

    def tie(self, fit: Fit, frame: MeasuredFrame) -> SiteTie:
        """Return a fit to all control points with what its errors come from."""
        rows = (3 * np.asarray(self.control)[:, None] + np.arange(3)).ravel()
        turn = np.kron(np.eye(len(self.control)), fit.scale * fit.R)
        rest = Uncertain(
            self.all.values[rows],
            {s: e[rows] for s, e in self.all.effects.items() if s != CALIBRATION},
        )
        covariance = turn @ rest.covariance @ turn.T
        covariance += np.diag(self.sigma[self.control].ravel() ** 2)
        by_calibration = np.empty((PARAMETERS, 0))
        derivatives = frame.calibration_derivatives(self.places[self.control])
        if derivatives is not None:
            by_calibration = -fit.gain @ turn @ derivatives
        return SiteTie(
            fit.R, fit.scale, fit.pivot, fit.pivot_site,
            fit.gain @ covariance @ fit.gain.T, by_calibration,
        )  # fmt: skip
