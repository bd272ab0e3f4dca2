# SPDX-License-Identifier: Apache-2.0
"""Rod calibration on one page: the steps of the paper's section 2.2, then the adjustment."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from binocular_recon.calibration.adjustment.bundle_adjustment import Problem, free_parameters
from binocular_recon.calibration.adjustment.distortion import (
    Evidence,
    choose_model,
    compare_models,
)
from binocular_recon.calibration.adjustment.estimation import Estimate, estimate
from binocular_recon.calibration.adjustment.linearisation import State, predict
from binocular_recon.calibration.adjustment.planar import calibrate_planar
from binocular_recon.calibration.adjustment.split_halves import compare_halves
from binocular_recon.calibration.adjustment.tone_curve import find_tone_curve
from binocular_recon.calibration.advice import advise
from binocular_recon.calibration.model import DEFAULT_LENS, StereoCalibration, check_lens
from binocular_recon.calibration.rectification.epipolar import free_pair
from binocular_recon.calibration.rectification.metric_rectification import (
    check_order,
    correction_of,
    metric_rig,
)
from binocular_recon.calibration.rectification.recalibration import corrected_marks, recalibrate
from binocular_recon.calibration.result import CalibrationResult, Stage, scaled_covariance
from binocular_recon.calibration.screening import (
    Rejected,
    check_count,
    check_spread,
    observations,
    usable_boards,
)
from binocular_recon.calibration.target.capture import Capture
from binocular_recon.calibration.target.rods import RodBoard
from binocular_recon.calibration.target.target import Target
from binocular_recon.calibration.verdict import check_result, warnings_of
from binocular_recon.camera import Camera, FloatArray, RigCovariance, StereoRig
from binocular_recon.errors import CalibrationError
from binocular_recon.inputs.common_size import CommonSize
from binocular_recon.lenses.registry import LENSES

# Noise of a mark before anything is known, px.
FIRST_SIGMA_PX = 0.3

Progress = Callable[[str], None]


def calibrate(
    captures: Sequence[Capture],
    target: RodBoard | Target,
    image_size: tuple[int, int],
    *,
    right_size: tuple[int, int] | None = None,
    lens: str = DEFAULT_LENS,
    rejected: Sequence[Rejected] = (),
    progress: Progress | None = None,
) -> CalibrationResult:
    """Calibrate a stereo rig from marks seen by both cameras.

    Parameters
    ----------
    captures : sequence of Capture
        Marks of each board; NaN = not found.
    target : RodBoard or Target
        Rods as in ``rods.yaml``, or the points of a board.
    image_size : (int, int)
        Width and height of every image, px.
    right_size : (int, int), optional
        That of the right images, where they differ from the left ones.
    lens : str
        Lens of both cameras, one of `model.calibrated_lenses`: ``plumb_bob`` (which takes rational
        terms where the marks call for them), ``equidistant`` (fisheye), or a lens of your own.
    rejected : sequence of Rejected
        Boards that were lost before, such as unreadable files; they are passed on.
    progress : callable
        Called with a description of each step.

    Returns
    -------
    CalibrationResult

    Raises
    ------
    CalibrationError
        If the boards are too few, all parallel or at one distance, contradict the description of
        the rods, left and right are swapped, or the lens cannot be calibrated; the message says
        what to do.

    """
    check_lens(lens)
    if isinstance(target, RodBoard):
        target = Target.from_rods(target)
    sizes = CommonSize(image_size, right_size or image_size)
    captures = [capture.on_common(sizes) for capture in captures]
    usable, lost = usable_boards(captures, target, image_size, rejected, lens)
    check_spread(usable, target, image_size, lens)
    observed = observations(usable)

    report = progress or _silent
    report('planar calibration (Zhang)')
    planar = calibrate_planar(observed, target, image_size, lens)

    report('joint adjustment of cameras and rods')
    free = free_parameters(LENSES[lens].DEFAULT_COEFFICIENTS, lens)
    problem = Problem(target, observed, free, np.full(2, FIRST_SIGMA_PX))
    if sizes.differs:
        pixel_px = np.array([1.0, sizes.scale])
        problem = replace(
            problem, pixel_px=pixel_px, sigma_px=FIRST_SIGMA_PX * np.outer(pixel_px, np.ones(2))
        )
    adjusted, evidence, model = _adjust(problem, planar)
    tone = find_tone_curve(adjusted)
    if tone.cause == 'tone':
        report('adjustment without the shift of edges by the tone curve')
        observed = tone.corrected(observed)
        planar = calibrate_planar(observed, target, image_size, lens)
        adjusted, evidence, model = _adjust(replace(problem, observed_px=observed), planar)
    lost += [Rejected(usable[i].name, reason) for i, reason in adjusted.bad_boards.items()]
    check_count(len(adjusted.boards), lost)
    check_order(adjusted.state.calibration)

    report('comparison of halves of the boards')
    halves = compare_halves(adjusted)
    adjusted = replace(adjusted, inflation=halves.factor)

    report('epipolar correction and recalibration')
    used = adjusted.problem.observed_px
    planar, notes = _planar(adjusted, planar)
    rig = metric_rig(adjusted.state.calibration)
    rectified = corrected_marks(
        used, adjusted.state.calibration, correction_of(adjusted.state.calibration, rig)
    )
    across = 0 if rig.turns else 1
    final = _stage(adjusted.state, target, used, _differences(rectified, across))
    corrected, more = _corrected(used, target, planar, final)
    parameters = adjusted.state.calibration.parameters
    right = _own_camera(rig.right, sizes)
    known = RigCovariance(
        rig.left, right, parameters, scaled_covariance(adjusted, parameters, sizes)
    )
    return CalibrationResult(
        names=tuple(usable[i].name for i in adjusted.boards),
        sizes=sizes,
        rig=StereoRig(rig.left, right, covariance=known),
        planar=_stage(planar, target.exact(), used, _differences(used, across)),
        corrected=corrected,
        adjusted=final,
        estimate=adjusted,
        halves=halves,
        evidence=evidence,
        model=model,
        rejected=tuple(lost),
        warnings=warnings_of(adjusted, halves, tone) + notes + more,
        advice=advise(adjusted),
    )


def _own_camera(right: Camera, sizes: CommonSize) -> Camera:
    """Return the right camera of the common grid as that of its own images."""
    width, height = sizes.right
    return replace(right, width=width, height=height, K=np.linalg.inv(sizes.matrix) @ right.K)


def _planar(adjusted: Estimate, first: State) -> tuple[State, tuple[str, ...]]:
    """Return the planar calibration of the marks that were used, and notes on it."""
    if not adjusted.bad_boards and not adjusted.outliers.any():
        return first, ()
    problem, calibration = adjusted.problem, first.calibration
    try:
        again = calibrate_planar(
            problem.observed_px, problem.target, calibration.image_size, calibration.lens
        )
    except CalibrationError as error:
        note = f'the planar calibration is that of all marks, outliers too: {error}'
        return first.select(np.array(adjusted.boards)), (note,)
    return again, ()


def _corrected(
    used: FloatArray, target: Target, planar: State, adjusted: Stage
) -> tuple[Stage, tuple[str, ...]]:
    """Calibrate again after correction with the planar calibration; return notes on it too."""
    notes: tuple[str, ...] = ()
    # few boards of carelessly placed rods: the adjustment still works, Zhang's method does not
    for start in (planar.calibration, adjusted.calibration):
        try:
            again, pair = recalibrate(used, target, start), free_pair(start)
            break
        except CalibrationError as error:
            odd = 'epipolar correction {}: ' + str(error)
            notes = (odd.format('started from the adjusted calibration'),)
    else:
        return adjusted, (odd.format('was not possible, its column repeats the adjustment'),)
    stage = Stage(
        calibration=again.state.calibration,
        residuals_px=used - again.predicted_px,
        marks_m=triangulated(again.state.calibration, again.corrected_px),
        # of images that are turned already
        row_difference_px=_differences(corrected_marks(used, start, pair), across=1),
    )
    return stage, notes


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
    lens = start.calibration.lens_model
    found = estimate(problem, start)
    check_result(found)
    evidence = compare_models(found.problem, found.state)
    model = choose_model(evidence, lens.name)
    if model != lens.default_model:
        boards = np.array(found.boards)
        again = estimate(
            replace(
                found.problem,
                observed_px=problem.observed_px[boards],
                free=free_parameters(lens.models[model], lens.name),
            ),
            found.state,
        )
        found = replace(
            again,
            boards=tuple(int(boards[i]) for i in again.boards),
            bad_boards=found.bad_boards
            | {int(boards[i]): reason for i, reason in again.bad_boards.items()},
        )
        check_result(found)
    return found, evidence, model


def _stage(state: State, target: Target, used: FloatArray, rows: FloatArray) -> Stage:
    return Stage(
        calibration=state.calibration,
        residuals_px=used - predict(state, target),
        marks_m=triangulated(state.calibration, used),
        row_difference_px=rows,
    )


def _differences(marks_px: FloatArray, across: int) -> FloatArray:
    """Return how far marks of both images differ across the baseline: 1 = rows, 0 = columns."""
    differences: FloatArray = marks_px[..., across] - marks_px[..., 2 + across]
    return differences
