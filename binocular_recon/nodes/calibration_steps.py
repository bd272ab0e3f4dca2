# SPDX-License-Identifier: Apache-2.0
"""Parts of the calibration services that need no ROS."""

from __future__ import annotations

import itertools
import threading

import numpy as np

from binocular_recon.calibration.detection.detect import Detection, detect_rods
from binocular_recon.calibration.result import CalibrationResult
from binocular_recon.calibration.screening import displacement_px
from binocular_recon.calibration.target.capture import Capture
from binocular_recon.calibration.target.rods import RodBoard
from binocular_recon.camera import StereoRig
from binocular_recon.errors import BinocularReconError, CalibrationError
from binocular_recon.nodes.newest_pair import ImagePair
from binocular_recon.stereo.rectification import rectified_points

# Marks that move by more (median, px) between two pairs belong to rods or a rig that moves.
STILL_PX = 0.5


class Alone:
    """Hold a lock, or refuse where another service does."""

    def __init__(self, lock: threading.Lock) -> None:
        self._lock = lock

    def __enter__(self) -> None:
        """Take the lock, or raise a BusyError."""
        if not self._lock.acquire(blocking=False):
            raise BusyError('busy with another call; try again when it has answered')

    def __exit__(self, *_error: object) -> None:
        """Release the lock."""
        self._lock.release()


class BusyError(BinocularReconError):
    """A service is at work on the same thing."""


def compile_kernels(board: RodBoard) -> None:
    """Find the rods in a drawing of them."""
    scale = 500 / np.max(board.marks_m)
    columns = 60 + 40 * np.arange(board.count)
    image = np.full((600, columns[-1] + 60), 128, np.uint8)
    edges = 550 - np.r_[0, board.marks_m * scale, 530].astype(int)
    for column in columns:
        for index, (bottom, top) in enumerate(itertools.pairwise(edges)):
            image[top:bottom, column - 4 : column + 4] = 20 if index % 2 == 0 else 235
    detect_rods(image, board)


def summary(result: CalibrationResult) -> str:
    """Return what a crew wants to know of a calibration, in one sentence."""
    calibration, sigma = result.calibration, result.sigma
    depth_mm = 1e3 * result.depth_sigma_m(15.0)
    left_out = '; '.join(f'{board.name} left out: {board.reason}' for board in result.rejected)
    advice = f'; next: {result.advice[0]}' if result.advice else ''
    return (
        f'{len(result.names)} boards: reprojection error {result.adjusted.error_px:.2f} px,'
        f' baseline {1e3 * calibration.baseline_m:.1f} +- {1e3 * sigma["baseline_m"]:.2g} mm,'
        f' depth sigma {depth_mm:.0f} mm at 15 m'
        f'{"; " + left_out if left_out else ""}{advice}'
    )


def detect_pair(pair: ImagePair, board: RodBoard) -> tuple[Detection, Detection]:
    """Find the rods in both pictures."""
    left, right = (
        detect_rods(image[..., :3] if image.ndim == 3 else image, board)
        for image in (pair.left, pair.right)
    )
    return left, right


def check_still(
    pair: ImagePair, capture: Capture, later: ImagePair | None, board: RodBoard
) -> str:
    """Compare the marks of a capture with those of a later pair, None if none came.

    Returns
    -------
    words : str
        Empty if everything stands still, or that this could not be seen.

    Raises
    ------
    CalibrationError
        If the marks have moved or are not found any more.

    """
    if later is None:
        return '; no other pair came, so whether rods and cameras stood still was not seen'
    seconds = later.arrived_s - pair.arrived_s
    left, right = detect_pair(later, board)
    moved_px = displacement_px(capture, Capture('later', left.marks_px, right.marks_px))
    if moved_px <= STILL_PX:
        return ''
    what = (
        f'the marks were not found again {seconds:.2f} s later'
        if np.isnan(moved_px)
        else f'the marks moved by {moved_px:.1f} px within {seconds:.2f} s'
    )
    raise CalibrationError(f'not captured: {what}; wait until rods and cameras stand still')


def size_words(size: tuple[int, int], stored: tuple[int, int]) -> str:
    """Say that pictures differ in size from those of the boards before; empty if they do not."""
    if size == stored:
        return ''
    return (
        '{}x{} px, but the boards before have {}x{} px; set the cameras as they were, or reset and'
        ' begin again'
    ).format(*size, *stored)


def missing_words(found: tuple[Detection, Detection]) -> str:
    """Return what is missing in the left and the right picture; empty if nothing is."""
    words = [
        f'{side} image: {message}'
        for side, detection in zip(('left', 'right'), found, strict=True)
        for message in detection.messages
    ]
    return f'; {"; ".join(words)}' if words else ''


def row_words(rig: StereoRig | None, capture: Capture) -> str:
    """Say how well the calibration in use rectifies the marks; empty if there is none."""
    if rig is None:
        return ''
    rows = [
        rectified_points(camera, pixels.reshape(-1, 2))[:, 1]
        for camera, pixels in ((rig.left, capture.left_px), (rig.right, capture.right_px))
    ]
    return (
        '; rows of the calibration in use differ by'
        f' {np.nanmean(np.abs(rows[0] - rows[1])):.2f} px'
    )
