# SPDX-License-Identifier: Apache-2.0
"""Predicted marks of both cameras and their analytic derivatives.

The chain is board frame -> left camera -> (right camera) -> edge facing the camera -> pixel;
each function below is one link with its derivatives.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from binocular_recon.calibration.model import StereoCalibration
from binocular_recon.calibration.target.target import Target
from binocular_recon.camera import FloatArray
from binocular_recon.lenses.projection import project_derivatives
from binocular_recon.rotations import cross_matrix, rotation


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
    warp_m : (2,) float64
        Warp that all boards share, m (`Target.bumps`); 0 on boards that do not bend.

    """

    calibration: StereoCalibration
    rotations: FloatArray
    translations_m: FloatArray
    deviations: FloatArray
    warp_m: FloatArray = field(default_factory=lambda: np.zeros(2))

    def moved(
        self,
        calibration: FloatArray,
        boards: FloatArray,
        rods: FloatArray,
        warp_m: FloatArray | None = None,
    ) -> State:
        """Return the state after steps (p,), (B, 6) (turn, shift), (B, R, 5) and (2,) m."""
        return State(
            self.calibration.moved(calibration),
            rotation(boards[:, :3]) @ self.rotations,
            self.translations_m + boards[:, 3:],
            self.deviations + rods,
            self.warp_m if warp_m is None else self.warp_m + warp_m,
        )

    def select(self, boards: npt.NDArray[Any]) -> State:
        """Return the state of some of the boards."""
        return replace(
            self,
            rotations=self.rotations[boards],
            translations_m=self.translations_m[boards],
            deviations=self.deviations[boards],
        )


@dataclass(frozen=True, eq=False)
class Jacobians:
    """Derivatives of the predicted marks; rows are left u, left v, right u, right v.

    Attributes
    ----------
    calibration : (B, R, M, 4, p) float64
        By the ``parameters`` of the calibration.
    board : (B, R, M, 4, 6) float64
        By a turn (rad) and a shift (m) of the board in the left camera.
    rod : (B, R, M, 4, 5) float64
        By the rod's deviations.
    warp : (B, R, M, 4, w) float64
        By the warp of the boards; w is 2, or 0 on boards that do not bend.

    """

    calibration: FloatArray
    board: FloatArray
    rod: FloatArray
    warp: FloatArray


def predict(state: State, target: Target) -> FloatArray:
    """Return where the marks appear: (B, R, M, 4) px, left u, left v, right u, right v."""
    marks, directions = target.marks(state.deviations, state.warp_m)
    return np.concatenate(
        [
            state.calibration.lens_model.pixels(
                edge[..., :2] / edge[..., 2:], *state.calibration.side(side)[:2]
            )
            for side, edge in _visible_edges(state, target, marks, directions)
        ],
        axis=-1,
    )


def marks_in_left(state: State, target: Target) -> FloatArray:
    """Return the marks on the rods' axes in the left camera's frame, (B, R, M, 3) m."""
    marks, _ = target.marks(state.deviations, state.warp_m)
    return _to_left(state, marks)


def linearise(state: State, target: Target) -> tuple[FloatArray, Jacobians]:
    """Return the predicted marks, (B, R, M, 4) px, and their derivatives."""
    marks, directions = target.marks(state.deviations, state.warp_m)
    d_marks, d_directions = _target_derivatives(target, state.deviations, directions)
    axis = _to_left(state, marks)
    along = np.einsum('bij,brj->bri', state.rotations, directions)[:, :, None]
    # by (turn, shift) of the board: what is left of the camera is turned about its origin
    offset = axis - state.translations_m[:, None, None]
    d_axis_board = _hstack(-cross_matrix(offset), np.eye(3))
    d_along_board = _hstack(-cross_matrix(along), np.zeros((3, 3)))
    rotations = state.rotations[:, None, None]
    d_axis_rod, d_along_rod = rotations @ d_marks, rotations @ d_directions
    bumps = target.bumps if target.bends else np.zeros((target.shape[0], 0))
    d_axis_warp = rotations[..., 2:] * bumps[:, None, None]
    calibration = state.calibration
    pixels, by_calibration, by_board, by_rod, by_warp = [], [], [], [], []
    for side in ('left', 'right'):
        K, D, R, T = calibration.side(side)
        point, direction = axis @ R.T + T, along @ R.T
        edge, d_point, d_direction = _edge_derivatives(point, direction, target.radius_m)
        pixel, d_edge, d_intrinsics = project_derivatives(edge, calibration.lens_model, K, D)
        by_point, by_direction = d_edge @ d_point, d_edge @ d_direction
        to_point, to_direction = by_point @ R, by_direction @ R
        by_board.append(to_point @ d_axis_board + to_direction @ d_along_board)
        by_rod.append(to_point @ d_axis_rod + to_direction @ d_along_rod)
        by_warp.append(to_point @ d_axis_warp)
        by_turn = -by_point @ cross_matrix(point - T) - by_direction @ cross_matrix(direction)
        d_pose = _hstack(by_turn, by_point)
        block = np.zeros((*pixel.shape, len(calibration.parameters)))
        count = d_intrinsics.shape[-1]
        if side == 'left':
            block[..., :count] = d_intrinsics
        else:
            block[..., count : 2 * count], block[..., 2 * count :] = d_intrinsics, d_pose
        by_calibration.append(block)
        pixels.append(pixel)
    parts = by_calibration, by_board, by_rod, by_warp
    jacobians = Jacobians(*(np.concatenate(part, -2) for part in parts))
    return np.concatenate(pixels, axis=-1), jacobians


def _to_left(state: State, marks: FloatArray) -> FloatArray:
    left: FloatArray = (
        np.einsum('bij,brmj->brmi', state.rotations, marks) + state.translations_m[:, None, None]
    )
    return left


def _visible_edges(
    state: State, target: Target, marks: FloatArray, directions: FloatArray
) -> list[tuple[str, FloatArray]]:
    """Return the visible edge point of each mark in the frame of either camera."""
    axis = _to_left(state, marks)
    along = np.einsum('bij,brj->bri', state.rotations, directions)[:, :, None]
    edges = []
    for side in ('left', 'right'):
        _, _, R, T = state.calibration.side(side)
        point, direction = axis @ R.T + T, along @ R.T
        away = point - np.sum(point * direction, -1, keepdims=True) * direction
        away /= np.linalg.norm(away, axis=-1, keepdims=True)
        edges.append((side, point - target.radius_m * away))
    return edges


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


def _edge_derivatives(
    point: FloatArray, direction: FloatArray, radius: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the visible edge point and its derivatives by axis point and direction, (..., 3, 3).

    The camera is at the origin; it is the point of the ring around the axis that is
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


def _hstack(*blocks: FloatArray) -> FloatArray:
    shape = np.broadcast_shapes(*(block.shape[:-1] for block in blocks))
    return np.concatenate(
        [np.broadcast_to(block, (*shape, block.shape[-1])) for block in blocks], axis=-1
    )
