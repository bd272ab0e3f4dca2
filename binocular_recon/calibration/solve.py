# SPDX-License-Identifier: Apache-2.0
"""Rod calibration on one page: the steps of the paper's section 2.2, then the adjustment."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from binocular_recon.calibration._linearisation import State, predict
from binocular_recon.calibration.advice import advise
from binocular_recon.calibration.bundle_adjustment import Problem, free_parameters
from binocular_recon.calibration.distortion import (
    DEFAULT_MODEL,
    MODELS,
    Evidence,
    choose_model,
    compare_models,
)
from binocular_recon.calibration.estimation import Estimate, estimate
from binocular_recon.calibration.metric_rectification import check_order, correction_of, metric_rig
from binocular_recon.calibration.planar import calibrate_planar
from binocular_recon.calibration.polar import free_pair
from binocular_recon.calibration.recalibration import corrected_marks, recalibrate
from binocular_recon.calibration.result import CalibrationResult, Stage
from binocular_recon.calibration.rods import Capture, RodBoard
from binocular_recon.calibration.screening import (
    Rejected,
    check_count,
    check_spread,
    observations,
    usable_boards,
)
from binocular_recon.calibration.stereo_calibration import StereoCalibration
from binocular_recon.calibration.target import Target
from binocular_recon.calibration.verdict import check_result, warnings_of
from binocular_recon.camera import FloatArray, StereoRig

# Noise of a mark before anything is known, px.
FIRST_SIGMA_PX = 0.3

Progress = Callable[[str], None]


def solve(
    captures: Sequence[Capture],
    target: RodBoard | Target,
    image_size: tuple[int, int],
    *,
    rejected: Sequence[Rejected] = (),
    progress: Progress | None = None,
) -> CalibrationResult:
    """Calibrate a stereo rig from marks seen by both cameras.

    Parameters
    ----------
    captures : sequence of Capture
        Marks of each board; NaN = not found.
    target : RodBoard or Target
        Rods as in ``rods.yaml``, or exactly known points.
    image_size : (int, int)
        Width and height of every picture, px.
    rejected : sequence of Rejected
        Boards that were lost before, such as unreadable files; they are passed on.
    progress : callable
        Told each step in words.

    Returns
    -------
    CalibrationResult

    Raises
    ------
    CalibrationError
        If the boards are too few, all parallel or at one distance, contradict the description of
        the rods, or left and right are swapped; the message says what to do.

    """
    if isinstance(target, RodBoard):
        target = Target.from_rods(target)
    usable, lost = usable_boards(captures, target, image_size, rejected)
    check_spread(usable, target, image_size)
    observed = observations(usable)

    say = progress or _silent
    say('planar calibration (Zhang)')
    planar = calibrate_planar(observed, target, image_size)
    check_order(planar.calibration)

    say('joint adjustment of cameras and rods')
    problem = Problem(
        target, observed, free_parameters(MODELS[DEFAULT_MODEL]), np.full(2, FIRST_SIGMA_PX)
    )
    adjusted, evidence, model = _adjust(problem, planar)
    lost += [Rejected(usable[i].name, reason) for i, reason in adjusted.bad_boards.items()]
    check_count(len(adjusted.boards), lost)

    say('polar-line correction and recalibration')
    used = adjusted.problem.observed_px
    planar = calibrate_planar(used, target, image_size)
    recalibrated = recalibrate(used, target, planar.calibration)
    corrected = Stage(
        calibration=recalibrated.state.calibration,
        residuals_px=used - recalibrated.predicted_px,
        marks_m=triangulated(recalibrated.state.calibration, recalibrated.corrected_px),
        row_difference_px=_rows(
            corrected_marks(used, planar.calibration, free_pair(planar.calibration))
        ),
    )
    check_result(adjusted, [usable[i].name for i in adjusted.boards])
    rig = metric_rig(adjusted.state.calibration)
    return CalibrationResult(
        names=tuple(usable[i].name for i in adjusted.boards),
        rig=rig,
        planar=_stage(planar, target.as_drawn(), used, metric_rig(planar.calibration)),
        corrected=corrected,
        adjusted=_stage(adjusted.state, target, used, rig),
        uncorrected_rows_px=_rows(used),
        estimate=adjusted,
        evidence=evidence,
        model=model,
        rejected=tuple(lost),
        warnings=warnings_of(adjusted),
        advice=advise(adjusted),
    )


def triangulated(calibration: StereoCalibration, marks_px: FloatArray) -> FloatArray:
    """Return the points of marks (..., 4) px seen by both cameras, (..., 3) m, left frame."""
    seen = np.isfinite(marks_px).all(axis=-1)
    points = np.full((*seen.shape, 3), np.nan)
    points[seen] = calibration.triangulate(marks_px[seen][:, :2], marks_px[seen][:, 2:])
    return points


def _silent(_step: str) -> None:
    pass


def _adjust(problem: Problem, start: State) -> tuple[Estimate, tuple[Evidence, ...], str]:
    """Adjust with the default distortion model, and again if the marks call for another."""
    found = estimate(problem, start)
    evidence = compare_models(found.problem, found.state)
    model = choose_model(evidence)
    if model != DEFAULT_MODEL:
        boards = np.array(found.boards)
        again = estimate(
            replace(
                found.problem,
                observed_px=problem.observed_px[boards],
                free=free_parameters(MODELS[model]),
            ),
            found.state,
        )
        found = replace(
            again,
            boards=tuple(int(boards[i]) for i in again.boards),
            bad_boards=found.bad_boards
            | {int(boards[i]): reason for i, reason in again.bad_boards.items()},
        )
    return found, evidence, model


def _stage(state: State, target: Target, used: FloatArray, rig: StereoRig) -> Stage:
    return Stage(
        calibration=state.calibration,
        residuals_px=used - predict(state, target),
        marks_m=triangulated(state.calibration, used),
        row_difference_px=_rows(
            corrected_marks(used, state.calibration, correction_of(state.calibration, rig))
        ),
    )


def _rows(marks_px: FloatArray) -> FloatArray:
    rows: FloatArray = marks_px[..., 1] - marks_px[..., 3]
    return rows
