# SPDX-License-Identifier: Apache-2.0
"""Simulated marks for the tests of calibration, and slow, obvious twins of its formulas."""

from __future__ import annotations

import functools
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np

from binocular_recon.calibration.adjustment.bundle_adjustment import Problem, free_parameters
from binocular_recon.calibration.adjustment.estimation import Estimate, estimate
from binocular_recon.calibration.adjustment.planar import calibrate_planar
from binocular_recon.calibration.adjustment.uncertainty import depth_sigma_m, field_of_view
from binocular_recon.calibration.model import StereoCalibration
from binocular_recon.calibration.result import CalibrationResult
from binocular_recon.calibration.screening import observations
from binocular_recon.calibration.solve import FIRST_SIGMA_PX, calibrate
from binocular_recon.calibration.target.capture import Capture
from binocular_recon.calibration.target.rods import RodBoard
from binocular_recon.calibration.target.target import Target
from binocular_recon.camera import FloatArray, StereoRig, parameter_names
from binocular_recon.evaluation.calibration.self_check import (
    simulated_boards,
    simulated_captures,
    true_calibration,
)
from binocular_recon.io.files import write_json
from binocular_recon.lenses.registry import LENSES
from binocular_recon.simulation.rig import RawRig, fisheye_rig, survey_rig
from binocular_recon.simulation.rods import (
    FACING_CAMERA,
    PlacedBoard,
    paper_board,
    place_board,
    with_placement,
)

DATA = Path(__file__).parent / 'data'
CHESSBOARD = DATA / 'chessboard_points.csv'
SIZE = (1920, 1200)


def board_of(placement_m: float) -> RodBoard:
    """Return the paper's board with a stated placement error."""
    return with_placement(paper_board(), placement_m)


def captures_of(
    placement_m: float = 0.005, boards: int = 11, *, seed: int = 0, noise_px: float = 0.2
) -> list[Capture]:
    """Simulate the marks of boards with the survey rig."""
    rig = survey_rig()
    placed = simulated_boards(rig, placement_m, boards, seed, 0)
    return simulated_captures(rig, placed, noise_px, (seed, 0))


def truth() -> StereoCalibration:
    """Return the survey rig."""
    return true_calibration(survey_rig())


def spoilt(change: Callable[[list[Capture]], None], seed: int = 2) -> list[Capture]:
    """Return simulated captures after a change."""
    captures = captures_of(seed=seed)
    change(captures)
    return captures


def captures_at(turns_rad: list[float], depths_m: list[float], board: RodBoard) -> list[Capture]:
    """Simulate boards that face the cameras up to a turn about their upright."""
    rng = np.random.default_rng(0)
    rig = survey_rig()
    captures = []
    for index, (turn, depth) in enumerate(zip(turns_rad, depths_m, strict=True)):
        middle = np.array([0.1 * depth * (index % 3 - 1), 1.2, depth])
        placed: PlacedBoard = place_board(board, np.array([0, turn, 0]), middle, rng)
        pixels = [placed.marks_px(view) for view in rig.views()]
        noisy = [px + rng.normal(0, 0.2, px.shape) for px in pixels]
        captures.append(Capture(f'{index}', *noisy))
    return captures


def wrong_board(**changes: object) -> RodBoard:
    """Return a board that is described otherwise than it stands."""
    return RodBoard.from_mapping({**board_of(0.005).to_mapping(), **changes})


def fisheye_captures(
    placement_m: float = 0.005,
    boards: int = 14,
    *,
    seed: int = 0,
    noise_px: float = 0.2,
    board: RodBoard | None = None,
    rig: RawRig | None = None,
) -> list[Capture]:
    """Simulate the marks of boards all over the view of a fisheye rig, 60 degrees off its axis.

    Marks outside of an image are NaN.
    """
    rig, rng = rig or fisheye_rig(), np.random.default_rng(seed)
    captures = []
    for index in range(boards):
        angle = np.radians(np.linspace(-50, 50, boards)[(5 * index) % boards])
        distance = np.geomspace(2.5, 10, boards)[index]
        middle = distance * np.array([np.sin(angle), 0.0, np.cos(angle)]) + [0.5, 1.0, 0.0]
        turn = np.array([0.0, angle + rng.uniform(-0.8, 0.8), rng.uniform(-0.1, 0.1)])
        placed = place_board(board or board_of(placement_m), turn, middle, rng)
        sides = []
        for view in rig.views():
            px = placed.marks_px(view)
            px = px + rng.normal(0, noise_px, px.shape)
            inside = ((px > 0) & (px < np.array(SIZE) - 1)).all(axis=-1, keepdims=True)
            sides.append(np.where(inside, px, np.nan))
        captures.append(Capture(f'{index:02d}', *sides))
    return captures


def points_target(columns: int = 10, rows: int = 7, spacing_m: float = 0.1) -> Target:
    """Return a chessboard: inner corners, 0.9 x 0.6 m unless stated otherwise."""
    x, y = np.meshgrid(spacing_m * np.arange(columns), spacing_m * np.arange(rows))
    return Target.from_points(np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)]))


def chessboard_captures(
    boards: int = 20,
    *,
    seed: int = 0,
    bow_m: tuple[float, float] = (0.0, 0.0),
    noise_px: float = 0.15,
) -> list[Capture]:
    """Simulate corners of a chessboard at 1.8 to 5 m, seen by the survey rig.

    Its middle stands out along z (to the viewer) by ``bow_m`` of its bend along x and along y.
    Corners outside of an image are NaN.
    """
    rng, views = np.random.default_rng([seed, 7]), survey_rig().views()
    corners = points_target().anchors_m
    middle = corners.mean(axis=0)
    half = np.ptp(corners, axis=0)[:2] / 2
    bent = corners - middle
    bent[:, 2] = (1 - (bent[:, :2] / half) ** 2) @ bow_m
    captures: list[Capture] = []
    while len(captures) < boards:
        depth = 1.8 * (5 / 1.8) ** ((len(captures) + rng.uniform()) / boards)
        place = [0.5 + rng.uniform(-0.4, 0.4) * depth, rng.uniform(-0.3, 0.3) * depth, depth]
        turn = cv2.Rodrigues(rng.uniform([-0.6, -0.7, -0.3], [0.6, 0.7, 0.3]))[0]
        seen = bent @ (turn @ FACING_CAMERA).T + place
        pixels = [view.project(seen) for view in views]
        inside = [np.all((px > 0) & (px < np.array(SIZE) - 1), axis=1) for px in pixels]
        if min(share.mean() for share in inside) < 0.5:
            continue
        noisy = [
            np.where(found[:, None], px + rng.normal(0, noise_px, px.shape), np.nan)[:, None]
            for px, found in zip(pixels, inside, strict=True)
        ]
        captures.append(Capture(f'{len(captures) + 1:02d}', *noisy))
    return captures


def estimated(captures: list[Capture], target: Target, size: tuple[int, int] = SIZE) -> Estimate:
    """Adjust as `calibrate` does, without its other stages."""
    observed = observations(captures)
    free = free_parameters(LENSES['plumb_bob'].DEFAULT_COEFFICIENTS)
    problem = Problem(target, observed, free, np.full(2, FIRST_SIGMA_PX))
    return estimate(problem, calibrate_planar(observed, target, size))


def depth_rms_m(found: Estimate, depth_m: float, true: StereoCalibration | None = None) -> float:
    """Return the root mean square of depth errors over the field of view, m."""
    true = true or truth()
    points = field_of_view(true, depth_m)
    pixels = (true.project(points, side) for side in ('left', 'right'))
    errors = found.state.calibration.triangulate(*pixels)[:, 2] - depth_m
    return float(np.sqrt(np.mean(errors**2)))


def stated_rms_m(found: Estimate, depth_m: float) -> float:
    """Return the stated sigma of depth over the field of view, m, root mean square."""
    calibration = found.state.calibration
    points = field_of_view(calibration, depth_m)
    sigma = depth_sigma_m(calibration, found.problem.free, found.covariance, points)
    return float(np.sqrt(np.mean(sigma**2)))


@functools.cache
def solved(placement_m: float = 0.005) -> CalibrationResult:
    """Return a calibration of eleven boards; computed once for all tests."""
    return calibrate(captures_of(placement_m), board_of(placement_m), SIZE)


def check_sigmas(result: CalibrationResult, true: StereoCalibration) -> None:
    """Assert that parameters are as close to the truth as their stated sigmas say."""
    for name, value, wanted in (
        ('fx_left_px', result.calibration.K_left[0, 0], true.K_left[0, 0]),
        ('fy_right_px', result.calibration.K_right[1, 1], true.K_right[1, 1]),
        ('cx_left_px', result.calibration.K_left[0, 2], true.K_left[0, 2]),
        ('k1_right', result.calibration.D_right[0], true.D_right[0]),
        ('T_z_m', result.calibration.T[2], true.T[2]),
        ('baseline_m', result.calibration.baseline_m, true.baseline_m),
    ):
        assert abs(value - wanted) < 3.5 * result.sigma[name], name


def numeric_jacobian(
    function: Callable[[FloatArray], FloatArray], at: FloatArray, step: float = 1e-6
) -> FloatArray:
    """Return derivatives by central differences, (values, parameters)."""
    columns = []
    for index in range(at.size):
        move = np.zeros_like(at)
        move[index] = step * max(1.0, abs(at[index]))
        difference = function(at + move) - function(at - move)
        columns.append(difference.ravel() / (2 * move[index]))
    return np.stack(columns, axis=-1)


def naive_marks(
    calibration: StereoCalibration,
    pose: FloatArray,
    deviations: FloatArray,
    board: RodBoard,
) -> FloatArray:
    """Project every mark of a board one by one: (R, M, 4) px.

    ``pose`` is a rotation vector and a translation, ``deviations`` (R, 5) are x, y, z of the foot
    and the lean towards x and z.
    """
    turn = cv2.Rodrigues(pose[:3])[0]
    pixels = np.empty((board.count, board.marks_per_rod, 4))
    for r, (x, z) in enumerate(board.rods_xz_m):
        direction = np.array([deviations[r, 3], 1.0, deviations[r, 4]])
        direction /= np.sqrt(direction @ direction)
        foot = np.array([x, 0.0, z]) + deviations[r, :3]
        for m, height in enumerate(board.marks_m):
            mark = turn @ (foot + height * direction) + pose[3:]
            along = turn @ direction
            for k, side in enumerate(('left', 'right')):
                K, D, R, T = calibration.side(side)
                sight = -R.T @ T - mark
                sight = sight - (sight @ along) * along
                border = mark + board.rod_diameter_m / 2 * sight / np.sqrt(sight @ sight)
                projected = cv2.projectPoints(border[None], cv2.Rodrigues(R)[0], T, K, D)[0]
                pixels[r, m, 2 * k : 2 * k + 2] = projected.ravel()
    return pixels


def naive_bound_m(captured: list[tuple[FloatArray, RodBoard]], noise_px: float) -> FloatArray:
    """Return the Cramer-Rao bound of depth at 10, 15, 20 m by dense numerical derivatives.

    ``captured`` holds each board's pose and description. Returns one standard deviation, (3, 35).
    """
    start = truth()
    free = [*range(8), *range(12, 20), *range(24, 30)]

    def moved(step: FloatArray) -> StereoCalibration:
        full = np.zeros(30)
        full[free] = step
        return start.moved(full)

    information = np.zeros((22, 22))
    for pose, board in captured:
        rods = 5 * board.count

        def marks(values: FloatArray, board: RodBoard = board) -> FloatArray:
            return naive_marks(
                moved(values[:22]), values[22:28], values[28:].reshape(-1, 5), board
            )

        J = numeric_jacobian(marks, np.r_[np.zeros(22), pose, np.zeros(rods)]) / noise_px
        N = J.T @ J
        p, h, t = board.placement_sigma_m, board.height_sigma_m, board.tilt_sigma_rad
        sigmas = np.maximum(np.tile([p, h, p, t, t], board.count), 1e-7)
        N[28:, 28:] += np.diag(1 / sigmas**2)
        information += N[:22, :22] - N[:22, 22:] @ np.linalg.solve(N[22:, 22:], N[22:, :22])

    x, y = np.meshgrid(np.linspace(-0.3, 0.3, 7), np.linspace(-0.2, 0.2, 5))
    rays = np.column_stack([x.ravel(), y.ravel(), np.ones(35)])
    points = np.array([10.0, 15, 20])[:, None, None] * rays
    left, right = (start.project(points, side) for side in ('left', 'right'))
    J = numeric_jacobian(
        lambda step: moved(step).triangulate(left, right)[..., 2], np.zeros(22), 1e-5
    )
    covariance = np.linalg.inv(information)
    return np.asarray(np.sqrt(np.einsum('ij,jk,ik->i', J, covariance, J)).reshape(3, 35))


def write_covariance(folder: Path, rig: StereoRig) -> None:
    """Write a ``calibration.json`` beside the camera files of a rig, with small uncertainties."""
    names = parameter_names(('k1', 'k2', 'p1', 'p2', 'k3'))
    cameras = {
        side: {'K': camera.K.tolist(), 'D': camera.D.tolist()}
        for side, camera in (('left', rig.left), ('right', rig.right))
    }
    # 0.01 px and 10 mm; 1e-4 of distortion and rad
    matrix = np.diag([1e-8 if name[0] in 'kpt' else 1e-4 for name in names])
    content = {**cameras, 'parameters': list(names), 'covariance': matrix.tolist()}
    write_json(folder / 'calibration.json', content)
