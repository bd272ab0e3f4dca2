# SPDX-License-Identifier: Apache-2.0
"""Values with their sources of error, so that correlated errors cancel where they should.

A measured value is known with the effect of each independent source of error on it: the
parameters of the calibration, which all points share, the matching of a point, the pick of a
point. What is computed from several values keeps the sources apart (first-order propagation), so
that the covariance of any two values is exact. Source: Hartley and Zisserman, "Multiple View
Geometry" (2nd ed.), section 5.2.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from binocular_recon.camera import FloatArray

# Kind of a source, as in the shares of a result, and whose it is.
Source = tuple[str, str]
CALIBRATION: Source = ('calibration', '')
# Step of the differences that stand for derivatives, relative to the value and at least.
_STEP, _LEAST_STEP = 1e-6, 1e-6


@dataclass(frozen=True, eq=False)
class Uncertain:
    """Values and the effects of the sources of error on them.

    Attributes
    ----------
    values : (n,) float64
    effects : mapping of Source to (n, k) float64
        What one standard deviation of each of the k errors of a source changes. Errors are
        independent of each other.

    """

    values: FloatArray
    effects: Mapping[Source, FloatArray] = field(default_factory=dict)

    @property
    def covariance(self) -> FloatArray:
        """Covariance of the values, (n, n) float64."""
        covariance = np.zeros((len(self.values),) * 2)
        for effect in self.effects.values():
            covariance += effect @ effect.T
        return covariance

    @property
    def sigma(self) -> FloatArray:
        """One standard deviation of each value, (n,) float64."""
        sigma: FloatArray = np.sqrt(np.diag(self.covariance))
        return sigma

    @property
    def shares(self) -> dict[str, FloatArray]:
        """One standard deviation of each value by the kind of source, (n,) float64 each."""
        variances: dict[str, FloatArray] = {}
        for (kind, _), effect in self.effects.items():
            variances[kind] = variances.get(kind, 0.0) + np.sum(effect**2, axis=1)
        return {kind: np.sqrt(variance) for kind, variance in variances.items()}

    def with_effect(self, source: Source, effect: FloatArray) -> Uncertain:
        """Return the same values with one more source of error."""
        return Uncertain(self.values, {**self.effects, source: effect})


def propagate(function: Callable[..., object], *inputs: Uncertain) -> Uncertain:
    """Return a function of uncertain values with the effects of all their sources.

    Parameters
    ----------
    function : callable
        Takes the values of each input, (n,) float64, and returns numbers: (m,) or one.
    *inputs : Uncertain

    Returns
    -------
    Uncertain
        With derivatives by central differences.

    """
    values = [one.values for one in inputs]
    result = _numbers(function(*values))
    effects: dict[Source, FloatArray] = {}
    for index, one in enumerate(inputs):
        derivatives = np.empty((len(result), len(one.values)))
        for column, value in enumerate(one.values):
            step = max(_LEAST_STEP, _STEP * abs(value))
            ends = []
            for sign in (1, -1):
                moved = one.values.copy()
                moved[column] += sign * step
                ends.append(_numbers(function(*values[:index], moved, *values[index + 1 :])))
            derivatives[:, column] = (ends[0] - ends[1]) / (2 * step)
        for source, effect in one.effects.items():
            effects[source] = effects.get(source, 0.0) + derivatives @ effect
    return Uncertain(result, effects)


def joined(*inputs: Uncertain) -> Uncertain:
    """Return the values of several inputs one after the other."""
    sources = dict.fromkeys(source for one in inputs for source in one.effects)
    effects = {}
    for source in sources:
        width = next(one.effects[source].shape[1] for one in inputs if source in one.effects)
        parts = [one.effects.get(source, np.zeros((len(one.values), width))) for one in inputs]
        effects[source] = np.concatenate(parts)
    return Uncertain(np.concatenate([one.values for one in inputs]), effects)


def root_of(covariance: FloatArray) -> FloatArray:
    """Return a matrix (n, n) whose product with its transpose is a covariance (n, n).

    Parameters that are exactly known, with rows and columns of 0, are allowed.
    """
    scale = np.sqrt(np.abs(np.diag(covariance)))
    scale[scale == 0] = 1.0
    strength, axes = np.linalg.eigh(covariance / np.outer(scale, scale))
    root: FloatArray = scale[:, None] * axes * np.sqrt(np.maximum(strength, 0.0))
    return root


def _numbers(value: object) -> FloatArray:
    return np.atleast_1d(np.asarray(value, np.float64)).ravel()
