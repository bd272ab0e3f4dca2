# SPDX-License-Identifier: Apache-2.0
"""Which boards can be used at all, and whether together they determine a calibration."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from binocular_recon.calibration.adjustment.fisheye_start import fisheye_guess, pinhole_pixels
from binocular_recon.calibration.adjustment.planar import MIN_MARKS, first_guess
from binocular_recon.calibration.model import DEFAULT_LENS
from binocular_recon.calibration.target.board_plane import fit_camera, project
from binocular_recon.calibration.target.capture import Capture
from binocular_recon.calibration.target.rods import row_of
from binocular_recon.calibration.target.target import Target
from binocular_recon.camera import FloatArray
from binocular_recon.errors import CalibrationError
from binocular_recon.lenses.registry import LENSES
from binocular_recon.number_text import counted

# Two boards determine a pinhole camera just so; a third one checks them.
MIN_BOARDS = 3
# What the paper used; fewer are accepted with a warning.
RECOMMENDED_BOARDS = 11
# Largest misfit of a board: this many px plus this share of its size in the image, which
# leaves room for lens distortion and for rods that stand a few centimetres off.
FLATNESS_PX, FLATNESS_SHARE = 4.0, 0.04
# Boards whose marks all lie this close (median, px) to those of another one show the same scene.
REPEATED_PX = 1.0
# Less spread makes focal length and baseline depend on each other.
MIN_DISTANCE_RATIO = 1.1
MIN_ANGLE_DEG = 6.0


@dataclass(frozen=True)
class Rejected:
    """A board that was left out and why."""

    name: str
    reason: str


def usable_boards(
    captures: Sequence[Capture],
    target: Target,
    image_size: tuple[int, int],
    rejected: Sequence[Rejected] = (),
    lens: str = DEFAULT_LENS,
) -> tuple[list[Capture], list[Rejected]]:
    """Separate boards that can be used from those that cannot.

    Parameters
    ----------
    captures : sequence of Capture
        Marks of each board.
    target : Target
        What was captured.
    image_size : (int, int)
        Width and height, px.
    rejected : sequence of Rejected
        Boards that were lost before, such as unreadable files.
    lens : str
        Lens of both cameras, one of `model.calibrated_lenses`.

    Returns
    -------
    usable : list of Capture
    rejected : list of Rejected
        Including those given.

    Raises
    ------
    CalibrationError
        If too few boards are usable, or the target's description contradicts most images.

    """
    usable: list[Capture] = []
    lost = list(rejected)
    misfits: list[Rejected] = []
    for capture in captures:
        _check_shape(capture, target)
        reason = _too_few_marks(capture, target)
        if reason is None and (reason := _misfit(capture, target, image_size, lens)):
            misfits.append(Rejected(capture.name, reason))
        reason = reason or _repetition(capture, usable)
        if reason is None:
            usable.append(capture)
        else:
            lost.append(Rejected(capture.name, reason))
    if len(misfits) > len(captures) / 2:
        raise CalibrationError(
            f'the marks of {len(misfits)} of {len(captures)} boards do not lie as described (such'
            f' as {_listed(misfits[:1])}); check the positions of the rods and the heights of the'
            ' marks'
        )
    check_count(len(usable), lost)
    _check_rods(usable, target)
    return usable, lost


def rejection_reason(
    capture: Capture,
    target: Target,
    image_size: tuple[int, int],
    others: Sequence[Capture],
    lens: str = DEFAULT_LENS,
) -> str | None:
    """Return why a board cannot be used with the others, None if it can; see `usable_boards`."""
    return (
        _too_few_marks(capture, target)
        or _misfit(capture, target, image_size, lens)
        or _repetition(capture, others)
    )


def displacement_px(capture: Capture, other: Capture) -> float:
    """Return by how much the marks of two captures differ (median), px; NaN if none is common."""
    moves = np.linalg.norm(
        [capture.left_px - other.left_px, capture.right_px - other.right_px], axis=-1
    )
    common = np.isfinite(moves)
    return float(np.median(moves[common])) if common.any() else float('nan')


def check_count(usable: int, rejected: Sequence[Rejected]) -> None:
    """Raise a CalibrationError that says how many boards are missing and why."""
    if usable >= MIN_BOARDS:
        return
    given = usable + len(rejected)
    why = f'; left out: {_listed(rejected)}' if rejected else ''
    raise CalibrationError(
        f'{usable} of {given} boards can be used and at least {MIN_BOARDS} are needed; capture'
        f' {MIN_BOARDS - usable} more, better {RECOMMENDED_BOARDS - usable}, at different'
        f' distances and angles{why}'
    )


def check_spread(
    captures: Sequence[Capture],
    target: Target,
    image_size: tuple[int, int],
    lens: str = DEFAULT_LENS,
) -> None:
    """Raise a CalibrationError if the boards are parallel or all at one distance.

    Parallel boards leave the focal length open whatever their number: every plane with the same
    normal has the same vanishing line. Boards at one distance leave baseline and the angle
    between the cameras to be told apart by the boards' own depth.
    """
    points = target.nominal_m.reshape(-1, 3)
    pixels = np.stack([capture.left_px.reshape(-1, 2) for capture in captures])
    if LENSES[lens].WIDE_ANGLE:
        K = fisheye_guess(points, pixels, image_size, LENSES[lens])[0]
        pixels = pinhole_pixels(pixels, K, LENSES[lens])
    else:
        K = first_guess(points, pixels, image_size)
    normals, centres = [], []
    for board in pixels:
        seen = np.isfinite(board).all(axis=-1)
        if seen.sum() < MIN_MARKS:
            continue
        # a wrong K turns all parallel planes alike and scales all distances alike
        _, turn, shift = cv2.solvePnP(points[seen], board[seen], K, None)
        R = cv2.Rodrigues(turn)[0]
        normals.append(R[:, 2])
        centres.append(R @ points.mean(axis=0) + shift.ravel())
    distances = np.linalg.norm(centres, axis=1), np.abs(np.array(centres)[:, 2])
    if min(values.max() / values.min() for values in distances) < MIN_DISTANCE_RATIO:
        raise CalibrationError(
            f'all {len(captures)} boards stand at one distance (nearest and farthest differ by'
            f' less than {100 * (MIN_DISTANCE_RATIO - 1):.0f} %), which leaves depth undetermined;'
            ' spread them over the whole working distance'
        )
    mean = np.mean(normals, axis=0) / np.linalg.norm(np.mean(normals, axis=0))
    angles = np.degrees(np.arccos(np.clip(normals @ mean, -1, 1)))
    spread = float(np.sqrt(np.mean(angles**2)))
    if spread < MIN_ANGLE_DEG:
        raise CalibrationError(
            f'all {len(captures)} boards are parallel (their directions scatter by'
            f' {spread:.1f} degrees, at least {MIN_ANGLE_DEG:g} are needed), which leaves the'
            ' focal length undetermined; turn boards by 20 to 50 degrees to either side'
        )


def _check_shape(capture: Capture, target: Target) -> None:
    expected = (*target.shape, 2)
    for side, pixels in (('left', capture.left_px), ('right', capture.right_px)):
        if pixels.shape != expected:
            raise CalibrationError(
                f'{side} marks of {capture.name} have shape {pixels.shape}, expected {expected}'
                ' (rods, marks per rod, 2); detect them with the same rods.yaml'
            )


def _check_rods(captures: Sequence[Capture], target: Target) -> None:
    """Raise a CalibrationError if rods are described that no image shows."""
    if not target.has_rods:
        return
    seen = np.any(np.isfinite(observations(captures)), axis=(0, 2, 3))
    if not seen.all():
        absent = ', '.join(str(rod + 1) for rod in np.flatnonzero(~seen))
        raise CalibrationError(
            f'rods.yaml describes {counted(len(seen), "rod")}, but rod {absent} was found on none'
            f' of the {len(captures)} boards; describe the rods that stand there'
        )


def _too_few_marks(capture: Capture, target: Target) -> str | None:
    found = [np.isfinite(px).all(axis=-1) for px in (capture.left_px, capture.right_px)]
    both = found[0] & found[1]
    total = both.size
    if both.sum() < MIN_MARKS:
        left, right = (int(seen.sum()) for seen in found)
        return (
            f'{both.sum()} of {total} marks found in both images (left {left}, right {right}),'
            f' at least {MIN_MARKS} are needed'
        )
    points = target.nominal_m[both][:, :2]
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    if spread[1] < 0.02 * spread[0]:
        return 'the marks found in both images lie on one line; at least two rods are needed'
    return None


def _misfit(
    capture: Capture, target: Target, image_size: tuple[int, int], lens: str
) -> str | None:
    """Say by how much the marks miss any board as described, None if they fit."""
    points = target.nominal_m.reshape(-1, 3)
    points[:, [0, 2]] = row_of(points[:, [0, 2]])
    for side, given in (('left', capture.left_px), ('right', capture.right_px)):
        pixels = given.reshape(-1, 2)
        seen = np.isfinite(pixels).all(axis=-1)
        if (pixels[seen] < -0.5).any() or (pixels[seen] > np.array(image_size) - 0.5).any():
            width, height = image_size
            return f'marks of the {side} image lie outside its {width}x{height} px'
        error = _board_error_px(points[seen], pixels[seen], image_size, lens)
        if error is None:
            return f'the marks of the {side} image do not form a board'
        size = float(np.linalg.norm(np.ptp(pixels[seen], axis=0)))
        if error > FLATNESS_PX + FLATNESS_SHARE * size:
            return (
                f'the marks of the {side} image miss a board as described by {error:.0f} px; a'
                ' rod or a mark was taken for another one, or stands elsewhere'
            )
    return None


def _board_error_px(
    points: FloatArray, pixels: FloatArray, image_size: tuple[int, int], lens: str
) -> float | None:
    """Return by how much marks (N, 2) px miss the board that fits best, None if none fits."""
    if LENSES[lens].WIDE_ANGLE:
        try:
            return float(fisheye_guess(points, pixels[None], image_size, LENSES[lens])[1][0])
        except CalibrationError:
            return None
    camera = fit_camera(points, pixels, image_size)
    if camera is None:
        return None
    errors = np.linalg.norm(pixels - project(camera, points), axis=1)
    return float(np.sqrt(np.mean(errors**2)))


def _repetition(capture: Capture, others: Sequence[Capture]) -> str | None:
    for other in others:
        if displacement_px(capture, other) < REPEATED_PX:
            return f'it repeats board {other.name}: the rods were not moved in between'
    return None


def _listed(rejected: Sequence[Rejected]) -> str:
    return '; '.join(f'{board.name}: {board.reason}' for board in rejected)


def observations(captures: Sequence[Capture]) -> FloatArray:
    """Return the marks of all boards, (B, R, M, 4) px: left u, left v, right u, right v."""
    return np.stack(
        [np.concatenate([capture.left_px, capture.right_px], axis=-1) for capture in captures]
    )
