# SPDX-License-Identifier: Apache-2.0
"""Which terms of lens distortion the marks call for: by evidence, not by habit.

A model with more terms always fits better; it is taken only if the misfit falls by more than
the terms would win by chance (Bayesian information criterion; Schwarz 1978). Those simpler than
the default are compared for the report, never chosen. Few boards leave
the image's corners empty, where superfluous terms do their harm unseen.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from binocular_recon.calibration.adjustment.bundle_adjustment import (
    Problem,
    cost,
    free_parameters,
    minimise,
)
from binocular_recon.calibration.adjustment.linearisation import State
from binocular_recon.calibration.model import DEFAULT_LENS
from binocular_recon.errors import CalibrationError
from binocular_recon.lenses.registry import LENSES

# "Very strong" evidence on Kass and Raftery's scale (1995).
STRONG_EVIDENCE = 10.0


@dataclass(frozen=True)
class Evidence:
    """How well one distortion model explains the marks.

    Attributes
    ----------
    model : str
        Key of `Lens.models`.
    chi2 : float
        Sum of squared residuals in standard deviations (robust, priors included).
    parameters : int
        Free parameters of the calibration.
    bic : float
        Bayesian information criterion relative to the default model; lower is better.

    """

    model: str
    chi2: float
    parameters: int
    bic: float


def compare_models(problem: Problem, state: State) -> tuple[Evidence, ...]:
    """Fit every model of the lens to the same marks with the same noise.

    Parameters
    ----------
    problem : Problem
        Marks without outliers and their noise.
    state : State
        Solution of the default model.

    """
    found, lens = [], state.calibration.lens_model
    for model, coefficients in lens.models.items():
        candidate = replace(problem, free=free_parameters(coefficients, lens.name))
        try:
            chi2 = 2 * cost(candidate, minimise(candidate, _restricted(state, coefficients)))
        except CalibrationError:
            chi2 = np.inf
        found.append((model, chi2, int(candidate.free.sum())))
    penalty = np.log(2 * problem.seen.sum())
    reference = next(
        chi2 + count * penalty for model, chi2, count in found if model == lens.default_model
    )
    return tuple(
        Evidence(model, chi2, count, chi2 + count * penalty - reference)
        for model, chi2, count in found
    )


def choose_model(evidence: tuple[Evidence, ...], lens: str = DEFAULT_LENS) -> str:
    """Return the default model, or a larger one that the marks strongly call for."""
    names, default = list(LENSES[lens].models), LENSES[lens].default_model
    larger = [e for e in evidence if names.index(e.model) > names.index(default)]
    best = min(larger, key=lambda e: e.bic, default=None)
    return best.model if best and best.bic < -STRONG_EVIDENCE else default


def _restricted(state: State, coefficients: tuple[str, ...]) -> State:
    """Return the state with every other coefficient at zero."""
    calibration = state.calibration
    free = free_parameters(coefficients, calibration.lens)
    count = 4 + calibration.D_left.size
    return replace(
        state,
        calibration=replace(
            calibration,
            D_left=calibration.D_left * free[4:count],
            D_right=calibration.D_right * free[count + 4 : 2 * count],
        ),
    )
