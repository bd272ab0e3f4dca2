# SPDX-License-Identifier: Apache-2.0
"""Which board to capture next: the one whose marks would improve depth most.

The information of a board about the calibration does not depend on what is measured, only on
where it stands. So boards all over the view are tried out in advance, and the one that lowers
the predicted depth sigma most is advised; then the next one, given the first.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from binocular_recon.calibration.adjustment.bundle_adjustment import normal_equations
from binocular_recon.calibration.adjustment.estimation import Estimate
from binocular_recon.calibration.adjustment.linearisation import State, marks_in_left, predict
from binocular_recon.calibration.adjustment.uncertainty import depth_derivatives, field_of_view
from binocular_recon.camera import FloatArray
from binocular_recon.number_text import significant
from binocular_recon.rotations import rotation

# Boards tried out: distances, columns and rows of their middle in the image, turns.
_DISTANCES = 6
_COLUMNS = (-0.6, -0.3, 0.0, 0.3, 0.6)
_ROWS = (-0.4, 0.0, 0.4)
_TURNS_DEG = (-50.0, -25.0, 0.0, 25.0, 50.0)
_PITCHES_DEG = (-30.0, 0.0, 30.0)
# Marks this close to the border, as a share of the width, are taken as lost; a board needs most.
_MARGIN = 0.02
_VISIBLE_SHARE = 0.8


@dataclass(frozen=True)
class Advice:
    """One board worth capturing.

    Attributes
    ----------
    distance_m : float
        Distance of the board's middle along the left camera's axis, m.
    column : float
        Its place in the left image, -1 at the left border to 1 at the right one.
    turn_deg : float
        How far it is turned, degrees; positive = its right end away from the cameras.
    depth_m : float
        Depth that the sigmas are for, m.
    sigma_before_m, sigma_after_m : float
        The calibration's share of the depth sigma without and with this board, m.

    """

    distance_m: float
    column: float
    turn_deg: float
    depth_m: float
    sigma_before_m: float
    sigma_after_m: float

    @property
    def gain(self) -> float:
        """Share by which the depth sigma falls."""
        return 1 - self.sigma_after_m / self.sigma_before_m

    def __str__(self) -> str:
        """Say where to put the board and what it would gain."""
        places = ('far left', 'left', 'middle', 'right', 'far right')
        place = places[int(np.clip((self.column + 1) * 2.5, 0, 4))]
        end = 'right' if self.turn_deg > 0 else 'left'
        turned = (
            f'turned by {abs(self.turn_deg):.0f} degrees, its {end} end away from the cameras'
            if abs(self.turn_deg) > 5
            else 'facing the cameras'
        )
        before, after = (
            significant(1e3 * sigma_m) for sigma_m in (self.sigma_before_m, self.sigma_after_m)
        )
        return (
            f'a board at {significant(self.distance_m)} m, {place} of the image, {turned}:'
            f' depth sigma at {significant(self.depth_m)} m falls from {before} to {after} mm'
            f' (-{100 * self.gain:.0f} %)'
        )


def advise(found: Estimate, count: int = 3) -> tuple[Advice, ...]:
    """Return the boards to capture next, best first, each given those before it.

    Parameters
    ----------
    found : Estimate
        Finished adjustment.
    count : int
        Number of boards to advise.

    """
    candidates = _candidates(found)
    if not len(candidates.rotations):
        return ()
    target = found.problem.target
    predicted = _visible(candidates, found)
    problem = replace(found.problem, observed_px=predicted)
    information = normal_equations(problem, candidates).board_information()
    middles = marks_in_left(candidates, target).reshape(len(predicted), -1, 3).mean(axis=1)
    depth = float(np.quantile(marks_in_left(found.state, target)[..., 2], 0.9))
    points = field_of_view(found.state.calibration, depth)
    if not len(points):
        return ()
    derivatives = depth_derivatives(found.state.calibration, found.problem.free, points)
    warp = len(found.shared_covariance) - derivatives.shape[1]
    derivatives = found.inflation * np.pad(derivatives, ((0, 0), (0, warp)))
    covariance, advised = found.shared_covariance, []
    for _ in range(count):
        before = _rms(derivatives, covariance)
        updated = np.linalg.inv(np.linalg.inv(covariance) + information)
        sigmas = np.array([_rms(derivatives, each) for each in updated])
        best = int(np.argmin(sigmas))
        covariance = updated[best]
        advised.append(
            Advice(
                distance_m=float(middles[best, 2]),
                column=_column(found, middles[best]),
                turn_deg=_turn_deg(candidates.rotations[best]),
                depth_m=depth,
                sigma_before_m=before,
                sigma_after_m=float(sigmas[best]),
            )
        )
    return tuple(advised)


def _candidates(found: Estimate) -> State:
    """Return boards all over the view, standing as upright and as high as those captured."""
    state, target = found.state, found.problem.target
    centre = target.nominal_m.reshape(-1, 3).mean(axis=0)
    middles = marks_in_left(state, target).mean(axis=(1, 2))
    up = np.array([0.0, -1.0, 0.0])
    if target.has_rods:
        up = state.rotations[:, :, 1].mean(axis=0)
        up /= np.linalg.norm(up)
    forward = np.array([0, 0, 1.0]) - up[2] * up
    forward /= np.linalg.norm(forward)
    facing = np.stack([np.cross(up, -forward), up, -forward], axis=1)
    calibration = state.calibration
    half_x = calibration.image_size[0] / 2 / calibration.K_left[0, 0]
    half_y = calibration.image_size[1] / 2 / calibration.K_left[1, 1]
    height = float(np.median(middles @ up))
    pitches = (0.0,) if target.has_rods else _PITCHES_DEG
    turned = [
        rotation(turn * up) @ facing @ rotation(np.array([pitch, 0, 0]))
        for turn in np.radians(_TURNS_DEG)
        for pitch in np.radians(pitches)
    ]
    rotations, translations = [], []
    for depth in np.geomspace(middles[:, 2].min(), 1.2 * middles[:, 2].max(), _DISTANCES):
        for column in _COLUMNS:
            heights = [height] if target.has_rods else [depth * half_y * row for row in _ROWS]
            for lift in heights:
                middle = depth * forward + depth * half_x * column * facing[:, 0] + lift * up
                rotations += turned
                translations += [middle - R @ centre for R in turned]
    boards = State(
        calibration,
        np.array(rotations),
        np.array(translations),
        np.zeros((len(rotations), target.shape[0], 5)),
        state.warp_m,
    )
    in_front = marks_in_left(boards, target)[..., 2].min(axis=(1, 2)) > 0
    boards = boards.select(in_front)
    seen = np.isfinite(_visible(boards, found)[..., 0]).mean(axis=(1, 2))
    return boards.select(seen >= _VISIBLE_SHARE)


def _visible(boards: State, found: Estimate) -> FloatArray:
    """Return the marks that both cameras would see, (B, R, M, 4) px; NaN = outside."""
    predicted = predict(boards, found.problem.target)
    size = np.array(boards.calibration.image_size * 2)
    margin = _MARGIN * size[0]
    inside = ((predicted > margin) & (predicted < size - 1 - margin)).all(axis=-1)
    return np.where(inside[..., None], predicted, np.nan)


def _rms(derivatives: FloatArray, covariance: FloatArray) -> float:
    variance = np.einsum('ni,ij,nj->n', derivatives, covariance, derivatives)
    return float(np.sqrt(np.mean(variance)))


def _column(found: Estimate, middle: FloatArray) -> float:
    pixel = found.state.calibration.project(middle, 'left')
    return float(2 * pixel[0] / (found.state.calibration.image_size[0] - 1) - 1)


def _turn_deg(board_R: FloatArray) -> float:
    """Return the turn about the board's own upright: positive = right end away."""
    return float(np.degrees(np.arctan2(board_R[2, 0], board_R[0, 0])))
