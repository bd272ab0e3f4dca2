# SPDX-License-Identifier: Apache-2.0
"""Steps of the calibration services: detect the rods, check the capture, describe the result."""

from __future__ import annotations

import numpy as np

from binocular_recon.calibration.detection.detect import Detection, detect_rods
from binocular_recon.calibration.holding import check_holding
from binocular_recon.calibration.result import CalibrationResult
from binocular_recon.calibration.screening import displacement_px
from binocular_recon.calibration.target.capture import Capture
from binocular_recon.calibration.target.rods import RodBoard
from binocular_recon.camera import StereoRig
from binocular_recon.errors import CalibrationError
from binocular_recon.inputs.common_size import CommonSize
from binocular_recon.nodes.calibration.newest_pair import ImagePair
from binocular_recon.number_text import counted, significant

# Marks that move by more (median, px) between two pairs belong to rods or a rig that moves.
STILL_PX = 0.5


def detect_pair(pair: ImagePair, board: RodBoard) -> tuple[Detection, Detection]:
    """Detect the rods in the left and the right image."""
    left, right = (
        detect_rods(image[..., :3] if image.ndim == 3 else image, board)
        for image in (pair.left, pair.right)
    )
    return left, right


def check_still(
    pair: ImagePair, capture: Capture, later: ImagePair | None, board: RodBoard
) -> str:
    """Compare the marks of a capture with those of a later pair, None if none arrived.

    Returns
    -------
    remark : str
        Empty if nothing has moved; otherwise why that is unknown.

    Raises
    ------
    CalibrationError
        If the marks have moved or are not found any more.

    """
    if later is None:
        return '; no further pair arrived, so it is unknown whether rods and cameras stood still'
    seconds = later.arrived_s - pair.arrived_s
    left, right = detect_pair(later, board)
    moved_px = displacement_px(capture, Capture('later', left.marks_px, right.marks_px))
    if moved_px <= STILL_PX:
        return ''
    finding = (
        f'the marks were not found again {seconds:.2f} s later'
        if np.isnan(moved_px)
        else f'the marks moved by {moved_px:.1f} px within {seconds:.2f} s'
    )
    raise CalibrationError(f'not captured: {finding}; wait until rods and cameras stand still')


def describe_size_change(sizes: CommonSize, stored: CommonSize) -> str:
    """Say that images differ in size from those of earlier boards, '' if they do not."""
    if sizes == stored:
        return ''
    return (
        f'the images are {sizes}, those of earlier boards {stored}; restore the camera settings,'
        ' or reset and start again'
    )


def describe_missing_marks(found: tuple[Detection, Detection]) -> str:
    """Say which marks were not found in the left and the right image, '' if all were."""
    messages = [
        f'{side} image: {message}'
        for side, detection in zip(('left', 'right'), found, strict=True)
        for message in detection.messages
    ]
    return f'; {"; ".join(messages)}' if messages else ''


def describe_holding(
    rig: StereoRig | None, capture: Capture, sizes: CommonSize, board: RodBoard
) -> str:
    """Say how well the calibration in use explains the marks, '' if there is none."""
    if rig is None:
        return ''
    try:
        holding = check_holding(rig, [capture], board, sizes.left, sizes.right)
    except CalibrationError as error:
        return f'; the calibration in use cannot be checked: {error}'
    return '; '.join(['', f'with the calibration in use, {holding}', *holding.faults])


def describe_result(result: CalibrationResult) -> str:
    """Return the figures of a calibration, its warnings and the next advice in one sentence."""
    calibration, sigma = result.calibration, result.sigma
    depth_mm = 1e3 * result.depth_sigma_m(15.0)
    figures = (
        f'{counted(len(result.names), "board")}: reprojection error {result.adjusted.error_px:.2f}'
        f' px, baseline {1e3 * calibration.baseline_m:.1f} +-'
        f' {significant(1e3 * sigma["baseline_m"], 2)} mm, depth sigma {depth_mm:.0f} mm at 15 m'
    )
    parts = [figures]
    parts += [f'{board.name} left out: {board.reason}' for board in result.rejected]
    parts += [f'warning: {warning}' for warning in result.warnings]
    parts += [f'next: {advice}' for advice in result.advice[:1]]
    return '; '.join(parts)


def describe_next_step(result: CalibrationResult) -> str:
    """Say whether a calibration is ready to be saved."""
    if not result.warnings:
        return 'call save to keep it'
    count = len(result.warnings)
    what = 'the warning' if count == 1 else f'the {count} warnings'
    return f'settle {what} and calibrate again, or call save to keep it as it is'
