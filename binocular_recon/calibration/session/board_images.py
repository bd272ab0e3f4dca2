# SPDX-License-Identifier: Apache-2.0
"""Images of the boards for the calibration report: small, with the marks drawn in."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from binocular_recon.calibration.report.report import BoardImage
from binocular_recon.calibration.result import CalibrationResult
from binocular_recon.calibration.session.captures import BoardFiles, find_boards
from binocular_recon.camera import FloatArray
from binocular_recon.errors import BinocularReconError
from binocular_recon.images import ByteImage, to_bgr8
from binocular_recon.inputs.common_size import CommonSize
from binocular_recon.io.image_files import read_image_file

# Boards shown at most: those left out first, then evenly chosen ones.
MOST_BOARDS = 16
# Width of one image, px, and its quality as a JPEG.
WIDTH_PX, JPEG_QUALITY = 640, 80
_USED, _LEFT_OUT = (80, 220, 60), (40, 40, 230)


def draw_boards(result: CalibrationResult, folder: Path) -> tuple[BoardImage, ...]:
    """Draw the marks that a calibration used into the images they were found in.

    Parameters
    ----------
    result : CalibrationResult
        What `solve` returned for these boards.
    folder : Path
        Holds ``left_NAME`` and ``right_NAME``; boards whose images are not there are skipped.

    """
    boards = {files.name: files for files in find_boards(folder)}
    reasons = {board.name: board.reason for board in result.rejected}
    used = list(result.names)
    rest = max(1, MOST_BOARDS - len(reasons))
    chosen = [used[i] for i in np.unique(np.linspace(0, len(used) - 1, rest).astype(int))]
    images = []
    for name in [*list(reasons)[:MOST_BOARDS], *chosen]:
        if name not in boards:
            continue
        jpeg = _pair(boards[name], _marks(result, name))
        if jpeg is not None:
            images.append(BoardImage(name, jpeg, reasons.get(name, '')))
    return tuple(images)


def _marks(result: CalibrationResult, name: str) -> tuple[FloatArray, FloatArray] | None:
    """Return a board's marks (N, 4) px used and the places of those left out; None if unknown."""
    if name not in result.names:
        return None
    board = result.names.index(name)
    found = result.estimate.problem.observed_px[board].reshape(-1, 4)
    out = np.repeat(result.estimate.outliers[board].reshape(-1, 2), 2, axis=1)
    left_out = np.where(out, result.predicted_px[board].reshape(-1, 4), np.nan)
    return _own(found, result.sizes), _own(left_out, result.sizes)


def _own(marks_px: FloatArray, sizes: CommonSize) -> FloatArray:
    """Return marks (N, 4) px of the common grid as those of the images."""
    if not sizes.differs:
        return marks_px
    return np.column_stack([marks_px[:, :2], sizes.to_right(marks_px[:, 2:])])


def _pair(files: BoardFiles, marks: tuple[FloatArray, FloatArray] | None) -> bytes | None:
    """Return both images side by side as a JPEG, None if none can be read."""
    sides = []
    for path, columns in ((files.left, slice(0, 2)), (files.right, slice(2, 4))):
        try:
            image = None if path is None else to_bgr8(read_image_file(path))
        except BinocularReconError:
            image = None
        if image is not None:
            sides.append(_small(image, [] if marks is None else [m[:, columns] for m in marks]))
    if not sides:
        return None
    height = max(side.shape[0] for side in sides)
    padded = [np.pad(side, ((0, height - len(side)), (0, 0), (0, 0))) for side in sides]
    quality = [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY]
    return bytes(cv2.imencode('.jpg', np.hstack(padded), quality)[1])


def _small(image: ByteImage, marks: list[FloatArray]) -> ByteImage:
    """Return a image ``WIDTH_PX`` wide with circles at the marks used and left out."""
    scale = WIDTH_PX / image.shape[1]
    small = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    for points, color in zip(marks, (_USED, _LEFT_OUT), strict=False):
        for x, y in points[np.isfinite(points[:, 0])]:
            # pixel centres are at integers in both images
            centre = round((x + 0.5) * scale - 0.5), round((y + 0.5) * scale - 0.5)
            cv2.circle(small, centre, 5, color, 2, cv2.LINE_AA)
    return np.asarray(small)
