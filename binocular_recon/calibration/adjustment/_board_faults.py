# SPDX-License-Identifier: Apache-2.0
"""What is wrong with a board that the calibration of the others contradicts."""

from __future__ import annotations

import numpy as np

from binocular_recon.calibration.model import StereoCalibration
from binocular_recon.camera import FloatArray

# The marks of a board in both images meet this closely, px, and its size is right to this share.
MEETING_PX, SIZE_SHARE = 5.0, 0.05
EXCHANGED = 'its left and right image are exchanged; rename them'
MISTAKEN = (
    'its images do not agree on where the rods stand: in one of them rods or marks were taken'
    ' for others, or the rods were moved in between'
)


def fault(
    calibration: StereoCalibration, nominal_m: FloatArray, given_px: FloatArray
) -> str | None:
    """Say what contradicts a calibration, None if the two images of a board agree.

    Parameters
    ----------
    calibration : StereoCalibration
        Found without this board.
    nominal_m : (R, M, 3) float64
        The marks of the board, m.
    given_px : (R, M, 4) float64
        Where they were found: left u, left v, right u, right v; NaN = not found.

    """
    seen = np.isfinite(given_px).all(axis=-1)
    nominal, marks = nominal_m[seen], given_px[seen]
    if len(marks) < 2 or _agree(calibration, nominal, marks[:, :2], marks[:, 2:]):
        return None
    exchanged = _agree(calibration, nominal, marks[:, 2:], marks[:, :2])
    return EXCHANGED if exchanged else MISTAKEN


def _agree(
    calibration: StereoCalibration,
    nominal_m: FloatArray,
    left_px: FloatArray,
    right_px: FloatArray,
) -> bool:
    """Return whether the lines of sight (N, 2) px meet, in front, on a board of the right size."""
    points = calibration.triangulate(left_px, right_px)
    off_px = np.linalg.norm(calibration.project(points, 'right') - right_px, axis=1)
    size = np.linalg.norm(points - points.mean(axis=0))
    ratio = size / np.linalg.norm(nominal_m - nominal_m.mean(axis=0))
    return bool(
        np.median(off_px) < MEETING_PX
        and np.median(points[:, 2]) > 0
        and abs(np.log(ratio)) < SIZE_SHARE
    )
