# SPDX-License-Identifier: Apache-2.0
"""What was detected, drawn into the images, for the crew that puts up the rods."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import cv2
import numpy as np
import numpy.typing as npt

from binocular_recon.drawing.labels import write_label
from binocular_recon.images import ByteImage

_FOUND = (80, 220, 60)
# Size of a mark and of letters, as a share of the image's height.
_MARK_SHARE, _TEXT_SHARE = 1 / 120, 1 / 30


class DetectedMarks(Protocol):
    """The marks of a board in one image, such as `calibration.Detection`."""

    @property
    def marks_px(self) -> npt.NDArray[np.float64]:
        """Positions, (R, M, 2) px; NaN = not found."""

    @property
    def found(self) -> npt.NDArray[np.bool_]:
        """Whether each mark was found, (R, M)."""

    @property
    def messages(self) -> Sequence[str]:
        """What is missing, as text."""


def draw_detections(
    images: tuple[ByteImage, ByteImage], found: tuple[DetectedMarks, DetectedMarks]
) -> ByteImage:
    """Draw the marks of both images, side by side.

    Parameters
    ----------
    images : pair of (H, W, 3) uint8
        Left and right, BGR.
    found : pair of DetectedMarks
        What was found in them.

    Returns
    -------
    image : (H, 2 W, 3) uint8
        A line along each rod with its number, a circle at each mark, and what is missing as text.

    """
    drawn = [_drawn(*side) for side in zip(images, found, strict=True)]
    height = max(map(len, drawn))
    return np.hstack([np.pad(side, ((0, height - len(side)), (0, 0), (0, 0))) for side in drawn])


def _drawn(source: ByteImage, detection: DetectedMarks) -> ByteImage:
    image = source.copy()
    height = image.shape[0]
    radius, scale = max(2, round(height * _MARK_SHARE)), height * _TEXT_SHARE / 30
    for number, (marks, present) in enumerate(
        zip(detection.marks_px, detection.found, strict=True), start=1
    ):
        points = [(round(x), round(y)) for x, y in marks[present]]
        if not points:
            continue
        cv2.line(image, points[0], points[-1], _FOUND, 1, cv2.LINE_AA)
        for point in points:
            cv2.circle(image, point, radius, _FOUND, 1, cv2.LINE_AA)
        top = min(points, key=lambda point: point[1])
        write_label(image, str(number), (top[0] - radius, top[1] - 2 * radius), scale)
    total = detection.found
    lines = [f'{total.sum()} of {total.size} marks', *detection.messages]
    for row, line in enumerate(lines, start=1):
        write_label(image, line, (2 * radius, round(35 * scale * row)), scale)
    return image
