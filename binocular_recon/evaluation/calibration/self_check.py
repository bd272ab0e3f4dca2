# SPDX-License-Identifier: Apache-2.0
"""How good the calibration is: against the best possible one, and the paper's Tables 1 and 2.

Marks are simulated as numbers, without images: a survey rig, boards at 5-16 m whose rods stand
as exactly as stated, Gaussian noise on every mark. The Cramer-Rao bound is what no unbiased
estimator can beat with the same boards and noise.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass

import cv2
import numpy as np

from binocular_recon.calibration.adjustment.bundle_adjustment import (
    Problem,
    free_parameters,
    normal_equations,
)
from binocular_recon.calibration.adjustment.linearisation import State, predict
from binocular_recon.calibration.adjustment.uncertainty import depth_sigma_m
from binocular_recon.calibration.model import DEFAULT_LENS, StereoCalibration
from binocular_recon.calibration.rectification.epipolar import free_pair
from binocular_recon.calibration.rectification.metric_rectification import (
    correction_of,
    metric_rig,
)
from binocular_recon.calibration.rectification.recalibration import corrected_marks
from binocular_recon.calibration.result import DEPTHS_M, CalibrationResult, row_statistics
from binocular_recon.calibration.screening import observations
from binocular_recon.calibration.solve import calibrate
from binocular_recon.calibration.target.capture import Capture
from binocular_recon.calibration.target.target import Target
from binocular_recon.camera import FloatArray
from binocular_recon.evaluation.calibration.opencv_calibration import calibrate_in_two_steps
from binocular_recon.lenses.registry import LENSES
from binocular_recon.simulation.rig import TABLE_1_PITCH_RAD, RawRig, survey_rig
from binocular_recon.simulation.rods import (
    FACING_CAMERA,
    PlacedBoard,
    draw_board,
    paper_board,
    place_board,
    with_placement,
)

PLACEMENTS_M = (0.0, 0.002, 0.005, 0.010)
BOUND_NOISE_PX, ROWS_NOISE_PX = 0.2, 0.12


@dataclass(frozen=True)
class AccuracyRow:
    """Depth over the field of view (X within 0.3 Z, Y within 0.2 Z) at one placement error.

    Attributes
    ----------
    placement_m : float
        One standard deviation of a rod's x and z, m.
    bound_ratio, worst_ratio : float
        Root mean square of depth error over Cramer-Rao bound: all runs, the worst one.
    error_over_sigma : float
        Root mean square of depth error over stated sigma; 1 if sigma is calibrated.
    opencv_m, planar_m, adjusted_m, bound_m : tuple of float
        Mean absolute depth error at 10, 15, 20 m of OpenCV's two steps, of both of our methods,
        and of the bound, m.
    planar_px, corrected_px, adjusted_px : float
        Reprojection error (Table 2), px.

    """

    placement_m: float
    bound_ratio: float
    worst_ratio: float
    error_over_sigma: float
    opencv_m: tuple[float, ...]
    planar_m: tuple[float, ...]
    adjusted_m: tuple[float, ...]
    bound_m: tuple[float, ...]
    planar_px: float
    corrected_px: float
    adjusted_px: float


@dataclass(frozen=True)
class RowsRow:
    """Mean row difference of marks on boards that were not used to calibrate (Table 1), px."""

    placement_m: float
    uncorrected_px: float
    corrected_px: float
    adjusted_px: float


def check_accuracy(
    *,
    boards: int = 11,
    sets: int = 20,
    draws: int = 5,
    placements_m: Iterable[float] = PLACEMENTS_M,
) -> Iterable[AccuracyRow]:
    """Compare the calibration with the Cramer-Rao bound; yields a row per placement.

    Parameters
    ----------
    boards : int
        Boards of a calibration.
    sets : int
        Sets of board poses.
    draws : int
        Draws of placement errors and of noise for each set.
    placements_m : iterable of float
        Placement errors; feet stand twice as unevenly, rods lean by as much per metre.

    """
    rig = survey_rig()
    for placement in placements_m:
        runs = [
            _accuracy_run(rig, placement, boards, (set_, draw))
            for set_ in range(sets)
            for draw in range(draws)
        ]
        errors, bounds, stated, planar, opencv, pixels = (
            np.array(part) for part in zip(*runs, strict=True)
        )
        squares = np.mean((errors / bounds) ** 2, axis=(1, 2))
        yield AccuracyRow(
            placement,
            float(np.sqrt(squares.mean())),
            float(np.sqrt(squares.max())),
            float(np.sqrt(np.mean((errors / stated) ** 2))),
            _per_depth(np.abs(opencv)),
            _per_depth(np.abs(planar)),
            _per_depth(np.abs(errors)),
            # mean of the absolute value of a Gaussian
            _per_depth(bounds * np.sqrt(2 / np.pi)),
            *(float(value) for value in pixels.mean(axis=0)),
        )


def check_rows(
    *, boards: int = 11, sets: int = 10, placements_m: Iterable[float] = PLACEMENTS_M
) -> Iterable[RowsRow]:
    """Measure row differences on held-out boards of a rig that pitches (Table 1)."""
    rig = survey_rig(pitch_rad=TABLE_1_PITCH_RAD)
    for placement in placements_m:
        means = []
        for set_ in range(sets):
            placed = simulated_boards(rig, placement, 2 * boards, set_, 0)
            captures = simulated_captures(rig, placed, ROWS_NOISE_PX, (set_, 0))
            result = calibrate(captures[:boards], placed[0].board, rig.left.size)
            means.append(_held_out_rows(result, captures[boards:]))
        yield RowsRow(placement, *(float(value) for value in np.mean(means, axis=0)))


def self_check(
    sets: int, draws: int, report: Callable[[str], None]
) -> dict[str, list[dict[str, object]]]:
    """Run both checks, report each row, and return all rows."""
    accuracy, rows = [], []
    report(
        'depth at 15 m, mean |error|: OpenCV in two steps, planar, adjusted, bound; error / bound'
        ' (worst run); error / stated sigma'
    )
    for row in check_accuracy(sets=sets, draws=draws):
        accuracy.append(asdict(row))
        all_m = row.opencv_m, row.planar_m, row.adjusted_m, row.bound_m
        depths = (f'{1e3 * depth_m[1]:5.0f}' for depth_m in all_m)
        report(
            f'  placement {1e3 * row.placement_m:4.1f} mm: {", ".join(depths)} mm;'
            f' {row.bound_ratio:.2f} ({row.worst_ratio:.2f}); {row.error_over_sigma:.2f};'
            f' Table 2: {row.planar_px:.3f}, {row.corrected_px:.3f}, {row.adjusted_px:.3f} px'
        )
    total = np.sqrt(np.mean([row['bound_ratio'] ** 2 for row in accuracy]))
    report(f'  all: error / bound {total:.3f}')
    report('mean row difference on held-out boards (Table 1): uncorrected, corrected, adjusted')
    for difference in check_rows(sets=max(1, sets // 2)):
        rows.append(asdict(difference))
        report(
            f'  placement {1e3 * difference.placement_m:4.1f} mm: {difference.uncorrected_px:.2f},'
            f' {difference.corrected_px:.3f}, {difference.adjusted_px:.3f} px'
        )
    return {'accuracy': accuracy, 'rows': rows}


def true_calibration(rig: RawRig) -> StereoCalibration:
    """Return a simulated rig as a calibration."""
    return StereoCalibration(
        rig.left.size, rig.left.K, rig.left.D, rig.right.K, rig.right.D, rig.R, rig.T,
        rig.left.distortion_model,
    )  # fmt: skip


def depth_errors_m(calibration: StereoCalibration, truth: StereoCalibration) -> FloatArray:
    """Return triangulated minus true depth of true pixels, (depths, points) m."""
    points = _points()
    pixels = (truth.project(points, side) for side in ('left', 'right'))
    errors: FloatArray = calibration.triangulate(*pixels)[..., 2] - points[..., 2]
    return errors


def bound_m(rig: RawRig, placed: list[PlacedBoard], noise_px: float) -> FloatArray:
    """Return the Cramer-Rao bound of depth, (depths, points) m: one standard deviation."""
    truth, target = true_calibration(rig), Target.from_rods(placed[0].board)
    state = State(
        truth,
        np.array([board.rotation for board in placed]),
        np.array([board.translation_xyz for board in placed]),
        np.zeros((len(placed), target.shape[0], 5)),
    )
    free = free_parameters(LENSES[DEFAULT_LENS].DEFAULT_COEFFICIENTS)
    problem = Problem(target, predict(state, target), free, np.full(2, noise_px))
    information = normal_equations(problem, state).board_information().sum(axis=0)
    sigma = depth_sigma_m(truth, free, np.linalg.inv(information), _points().reshape(-1, 3))
    return sigma.reshape(len(DEPTHS_M), -1)


def _accuracy_run(
    rig: RawRig, placement_m: float, boards: int, seed: tuple[int, int]
) -> tuple[FloatArray, ...]:
    """Return depth error, bound, stated sigma, depth errors of peers, Table 2's averages."""
    placed = simulated_boards(rig, placement_m, boards, *seed)
    captures = simulated_captures(rig, placed, BOUND_NOISE_PX, seed)
    result = calibrate(captures, placed[0].board, rig.left.size)
    opencv = calibrate_in_two_steps(captures, result.estimate.problem.target, rig.left.size)
    truth = true_calibration(rig)
    stated = depth_sigma_m(
        result.calibration,
        result.estimate.problem.free,
        result.estimate.covariance,
        _points().reshape(-1, 3),
    )
    stages = (result.planar, result.corrected, result.adjusted)
    return (
        depth_errors_m(result.calibration, truth),
        bound_m(rig, placed, BOUND_NOISE_PX),
        stated.reshape(len(DEPTHS_M), -1),
        depth_errors_m(result.planar.calibration, truth),
        depth_errors_m(opencv, truth),
        np.array([stage.board_error_px.mean() for stage in stages]),
    )


def simulated_boards(
    rig: RawRig, placement_m: float, count: int, set_: int, draw: int
) -> list[PlacedBoard]:
    """Draw boards of the paper; their poses depend on ``set_`` only, their errors on both."""
    board = with_placement(paper_board(), placement_m)
    exact, poses = with_placement(board, 0.0), np.random.default_rng(set_)
    errors = np.random.default_rng([set_, draw, 1])
    middle = np.array([board.rods_xz_m[:, 0].mean(), 0, 0])
    boards = []
    for _ in range(count):
        placed = draw_board(exact, rig, poses)
        turn = cv2.Rodrigues(placed.rotation @ FACING_CAMERA.T)[0].ravel()
        place = placed.translation_xyz + placed.rotation @ middle
        boards.append(place_board(board, turn, place, errors))
    return boards


def simulated_captures(
    rig: RawRig, placed: list[PlacedBoard], noise_px: float, seed: Sequence[int]
) -> list[Capture]:
    """Return the marks of boards as both cameras see them, with Gaussian noise on u and v."""
    rng = np.random.default_rng([*seed, 2])
    captures = []
    for index, board in enumerate(placed):
        left, right = (board.marks_px(view) for view in rig.views())
        left, right = (px + rng.normal(0, noise_px, px.shape) for px in (left, right))
        captures.append(Capture(f'{index + 1:02d}', left, right))
    return captures


def _held_out_rows(result: CalibrationResult, captures: list[Capture]) -> tuple[float, ...]:
    """Return the mean row difference as seen, after correction, after adjustment, px."""
    seen = observations(captures)
    planar, adjusted = result.planar.calibration, result.calibration
    corrections = (
        seen,
        corrected_marks(seen, planar, free_pair(planar)),
        corrected_marks(seen, adjusted, correction_of(adjusted, metric_rig(adjusted))),
    )
    return tuple(row_statistics(marks[..., 1] - marks[..., 3])['mean'] for marks in corrections)


def _points() -> FloatArray:
    """Return the grid over the field of view, (depths, points, 3) m."""
    x, y = np.meshgrid(np.linspace(-0.3, 0.3, 7), np.linspace(-0.2, 0.2, 5))
    rays = np.column_stack([x.ravel(), y.ravel(), np.ones(x.size)])
    points: FloatArray = np.array(DEPTHS_M)[:, None, None] * rays
    return points


def _per_depth(values: FloatArray) -> tuple[float, ...]:
    return tuple(float(value) for value in values.mean(axis=(0, 2)))
