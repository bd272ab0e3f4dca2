# SPDX-License-Identifier: Apache-2.0
"""Reconstructed marks against what is known of them (the paper's Fig. 10 and 11)."""

from __future__ import annotations

import numpy as np

from binocular_recon.calibration.target.target import Target
from binocular_recon.camera import FloatArray
from binocular_recon.images import Mask
from binocular_recon.rotations import rigid_fit


def mark_errors_m(marks_m: FloatArray, target: Target) -> FloatArray:
    """Return how far reconstructed marks are from their known places.

    On rods: along the rod, after its marks have been aligned with their known heights. On a target
    of points: away from the board's middle, after the board has been aligned with the known
    points. Only the shape is compared, so the frame of the calibration does not matter.

    Parameters
    ----------
    marks_m : (B, R, M, 3) float64
        Reconstructed marks, m; NaN = not seen by both cameras.
    target : Target
        What is known.

    Returns
    -------
    (B, R, M) float64
        Errors, m, positive = too far from the middle; NaN = not seen, or too few to compare.

    """
    errors = np.full(marks_m.shape[:-1], np.nan)
    for board in range(len(marks_m)):
        if not target.has_rods:
            errors[board, :, 0] = _point_errors(marks_m[board, :, 0], target.anchors_m)
            continue
        for rod in range(marks_m.shape[1]):
            errors[board, rod] = _rod_errors(marks_m[board, rod], target.heights_m)
    return errors


def _rod_errors(marks: FloatArray, heights: FloatArray) -> FloatArray:
    seen, known, centred = _centred(marks, heights)
    errors = np.full(len(marks), np.nan)
    if len(known) < 2:
        return errors
    direction = known @ centred
    direction /= np.linalg.norm(direction)
    errors[seen] = np.sign(known) * (centred @ direction - known)
    return errors


def _point_errors(marks: FloatArray, points: FloatArray) -> FloatArray:
    seen, known, centred = _centred(marks, points)
    errors = np.full(len(marks), np.nan)
    if len(known) < 4:
        return errors
    turn = rigid_fit(known, centred)[0]
    distances = np.maximum(np.linalg.norm(known, axis=1), 1e-9)
    errors[seen] = np.sum((centred @ turn - known) * known, axis=1) / distances
    return errors


def _centred(marks: FloatArray, places: FloatArray) -> tuple[Mask, FloatArray, FloatArray]:
    """Return which marks were seen, and their places and themselves about their means."""
    seen: Mask = np.all(np.isfinite(marks), axis=-1)
    if not seen.any():
        return seen, places[seen], marks[seen]
    return seen, places[seen] - places[seen].mean(axis=0), marks[seen] - marks[seen].mean(axis=0)
