# SPDX-License-Identifier: Apache-2.0
"""Predicted marks of both cameras and their analytic derivatives.

The chain is board frame -> left camera -> (right camera) -> border facing the camera -> pixel;
each function below is one link with its derivatives.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from binocular_recon.calibration.model import (
    StereoCalibration,
    cross_matrix,
    rotation,
)
from binocular_recon.calibration.target.target import Target
from binocular_recon.camera import FloatArray


@dataclass(frozen=True, eq=False)
class State:
    """Everything that the adjustment estimates.

    Attributes
    ----------
    calibration : StereoCalibration
        Both cameras.
    rotations : (B, 3, 3) float64
        From each board's frame to the left camera.
    translations_m : (B, 3) float64
        Origin of each board in the left camera, m.
    deviations : (B, R, 5) float64
        Displacement of every rod from its nominal place (`target.DEVIATIONS`).

    """

    calibration: StereoCalibration
    rotations: FloatArray
    translations_m: FloatArray
    deviations: FloatArray

    def moved(self, calibration: FloatArray, boards: FloatArray, rods: FloatArray) -> State:
        """Return the state after steps (30,), (B, 6) (turn, shift) and (B, R, 5)."""
        return State(
            self.calibration.moved(calibration),
            rotation(boards[:, :3]) @ self.rotations,
            self.translations_m + boards[:, 3:],
            self.deviations + rods,
        )

    def select(self, boards: npt.NDArray[Any]) -> State:
        """Return the state of some of the boards."""
        return State(
            self.calibration,
            self.rotations[boards],
            self.translations_m[boards],
            self.deviations[boards],
        )


@dataclass(frozen=True, eq=False)
class Jacobians:
    """Derivatives of the predicted marks; rows are left u, left v, right u, right v.

    Attributes
    ----------
    calibration : (B, R, M, 4, 30) float64
        By the parameters of `stereo_calibration.PARAMETERS`.
    board : (B, R, M, 4, 6) float64
        By a turn (rad) and a shift (m) of the board in the left camera.
    rod : (B, R, M, 4, 5) float64
        By the rod's deviations.

    """

    calibration: FloatArray
    board: FloatArray
    rod: FloatArray


def predict(state: State, target: Target) -> FloatArray:
    """Return where the marks appear: (B, R, M, 4) px, left u, left v, right u, right v."""
    marks, directions = target.marks(state.deviations)
    return np.concatenate(
        [
            project(border, *state.calibration.side(side)[:2])
            for side, border in _borders(state, target, marks, directions)
        ],
        axis=-1,
    )


def marks_in_left(state: State, target: Target) -> FloatArray:
    """Return the marks on the rods' axes in the left camera's frame, (B, R, M, 3) m."""
    marks, _ = target.marks(state.deviations)
    return _to_left(state, marks)


def linearise(state: State, target: Target) -> tuple[FloatArray, Jacobians]:
    """Return the predicted marks, (B, R, M, 4) px, and their derivatives."""
    marks, directions = target.marks(state.deviations)
    d_marks, d_directions = _target_derivatives(target, state.deviations, directions)
    axis = _to_left(state, marks)
    along = np.einsum('bij,brj->bri', state.rotations, directions)[:, :, None]
    # by (turn, shift) of the board: what is left of the camera is turned about its origin
    offset = axis - state.translations_m[:, None, None]
    d_axis_board = _hstack(-cross_matrix(offset), np.eye(3))
    d_along_board = _hstack(-cross_matrix(along), np.zeros((3, 3)))
    rotations = state.rotations[:, None, None]
    d_axis_rod, d_along_rod = rotations @ d_marks, rotations @ d_directions
    calibration = state.calibration
    pixels, by_calibration, by_board, by_rod = [], [], [], []
    for side in ('left', 'right'):
        K, D, R, T = calibration.side(side)
        point, direction = axis @ R.T + T, along @ R.T
        border, d_point, d_direction = _border_derivatives(point, direction, target.radius_m)
        pixel, d_border, d_intrinsics = _project_derivatives(border, K, D)
        by_point, by_direction = d_border @ d_point, d_border @ d_direction
        to_point, to_direction = by_point @ R, by_direction @ R
        by_board.append(to_point @ d_axis_board + to_direction @ d_along_board)
        by_rod.append(to_point @ d_axis_rod + to_direction @ d_along_rod)
        by_turn = -by_point @ cross_matrix(point - T) - by_direction @ cross_matrix(direction)
        d_pose = _hstack(by_turn, by_point)
        block = np.zeros((*pixel.shape, 30))
        if side == 'left':
            block[..., :12] = d_intrinsics
        else:
            block[..., 12:24], block[..., 24:] = d_intrinsics, d_pose
        by_calibration.append(block)
        pixels.append(pixel)
    jacobians = Jacobians(*(np.concatenate(p, -2) for p in (by_calibration, by_board, by_rod)))
    return np.concatenate(pixels, axis=-1), jacobians


def project(points: FloatArray, K: FloatArray, D: FloatArray) -> FloatArray:
    """Project points of the camera's frame, (..., 3) m, to (..., 2) px (OpenCV's model)."""
    x, y = points[..., 0] / points[..., 2], points[..., 1] / points[..., 2]
    k1, k2, p1, p2, k3, k4, k5, k6 = D
    r2 = x * x + y * y
    radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
    u = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    v = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    return np.stack([K[0, 0] * u + K[0, 2], K[1, 1] * v + K[1, 2]], axis=-1)


def _to_left(state: State, marks: FloatArray) -> FloatArray:
    left: FloatArray = (
        np.einsum('bij,brmj->brmi', state.rotations, marks) + state.translations_m[:, None, None]
    )
    return left


def _borders(
    state: State, target: Target, marks: FloatArray, directions: FloatArray
) -> list[tuple[str, FloatArray]]:
    """Return the visible border of each mark in the frame of either camera."""
    axis = _to_left(state, marks)
    along = np.einsum('bij,brj->bri', state.rotations, directions)[:, :, None]
    borders = []
    for side in ('left', 'right'):
        _, _, R, T = state.calibration.side(side)
        point, direction = axis @ R.T + T, along @ R.T
        away = point - np.sum(point * direction, -1, keepdims=True) * direction
        away /= np.linalg.norm(away, axis=-1, keepdims=True)
        borders.append((side, point - target.radius_m * away))
    return borders


def _target_derivatives(
    target: Target, deviations: FloatArray, directions: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return derivatives of marks (B, R, M, 3, 5) and directions (B, R, 1, 3, 5)."""
    length = np.sqrt(1 + deviations[..., 3] ** 2 + deviations[..., 4] ** 2)[..., None, None]
    across = (np.eye(3) - directions[..., :, None] * directions[..., None, :]) / length
    d_directions = np.concatenate(
        [np.zeros((*across.shape[:-1], 3)), across[..., [0, 2]]], axis=-1
    )[:, :, None]
    d_marks = target.heights_m[:, None, None] * d_directions
    d_marks[..., :3] += np.eye(3)
    return d_marks, d_directions


def _border_derivatives(
    point: FloatArray, direction: FloatArray, radius: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the visible border and its derivatives by axis point and direction, (..., 3, 3).

    The camera is at the origin; the border is the point of the ring around the axis that is
    nearest to it (`mark_types.visible_edges`).
    """
    along = np.sum(point * direction, axis=-1, keepdims=True)
    away = point - along * direction
    distance = np.linalg.norm(away, axis=-1, keepdims=True)
    away = away / distance
    unit = np.eye(3)
    across = (radius / distance)[..., None] * (unit - away[..., :, None] * away[..., None, :])
    outer = direction[..., :, None] * direction[..., None, :]
    d_point = unit - across @ (unit - outer)
    d_direction = across @ (
        direction[..., :, None] * point[..., None, :] + along[..., None] * unit
    )
    return point - radius * away, d_point, d_direction


def _project_derivatives(
    points: FloatArray, K: FloatArray, D: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return pixels and their derivatives by point (..., 2, 3) and intrinsics (..., 2, 12)."""
    inverse_z = 1 / points[..., 2]
    x, y = points[..., 0] * inverse_z, points[..., 1] * inverse_z
    k1, k2, p1, p2, k3, k4, k5, k6 = D
    r2 = x * x + y * y
    r4 = r2 * r2
    inverse = 1 / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
    radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) * inverse
    slope = inverse * (k1 + 2 * k2 * r2 + 3 * k3 * r4 - radial * (k4 + 2 * k5 * r2 + 3 * k6 * r4))
    u = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    v = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    u_x = radial + 2 * x * x * slope + 2 * p1 * y + 6 * p2 * x
    v_y = radial + 2 * y * y * slope + 6 * p1 * y + 2 * p2 * x
    mixed = 2 * x * y * slope + 2 * p1 * x + 2 * p2 * y
    fx, fy = K[0, 0], K[1, 1]
    rows = (
        (fx * u_x, fx * mixed, -fx * (u_x * x + mixed * y)),
        (fy * mixed, fy * v_y, -fy * (mixed * x + v_y * y)),
    )
    by_point = np.stack([np.stack(row, -1) for row in rows], -2) * inverse_z[..., None, None]
    factors = np.stack([inverse * r2, inverse * r4, inverse * r2 * r4], -1)
    factors = np.concatenate([factors, -radial[..., None] * factors], -1)
    by_intrinsics = np.zeros((*x.shape, 2, 12))
    by_intrinsics[..., 0, 0], by_intrinsics[..., 1, 1] = u, v
    by_intrinsics[..., 0, 2] = by_intrinsics[..., 1, 3] = 1
    for row, (focal, value) in enumerate(((fx, x), (fy, y))):
        by_intrinsics[..., row, [4, 5, 8, 9, 10, 11]] = focal * value[..., None] * factors
    by_intrinsics[..., 0, 6], by_intrinsics[..., 0, 7] = fx * 2 * x * y, fx * (r2 + 2 * x * x)
    by_intrinsics[..., 1, 6], by_intrinsics[..., 1, 7] = fy * (r2 + 2 * y * y), fy * 2 * x * y
    return np.stack([fx * u + K[0, 2], fy * v + K[1, 2]], axis=-1), by_point, by_intrinsics


def _hstack(*blocks: FloatArray) -> FloatArray:
    shape = np.broadcast_shapes(*(block.shape[:-1] for block in blocks))
    return np.concatenate(
        [np.broadcast_to(block, (*shape, block.shape[-1])) for block in blocks], axis=-1
    )
