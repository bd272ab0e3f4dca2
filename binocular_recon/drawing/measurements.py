# SPDX-License-Identifier: Apache-2.0
"""Measurements drawn into an image: the line between the picks, and the value beside it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from binocular_recon.drawing.labels import write_label
from binocular_recon.images import ByteImage

LINE_BGR = (60, 230, 255)
# Size of letters and of a cross, as shares of the image's height.
_TEXT_SHARE, _CROSS_SHARE = 1 / 45, 1 / 80
_FONT_PX = 22


class Drawn(NamedTuple):
    """A measurement to be drawn: picks (N, 2) px, whether they enclose something, and the text."""

    outline_px: npt.NDArray[np.float64]
    closed: bool
    label: str


def draw_measurements(image: ByteImage, measured: Iterable[Drawn]) -> ByteImage:
    """Draw measurements.

    Parameters
    ----------
    image : (H, W, 3) uint8
        BGR; it stays as it is.
    measured : iterable of Drawn

    Returns
    -------
    image : (H, W, 3) uint8

    """
    drawn = image.copy()
    for one in measured:
        draw_measurement(drawn, one)
    return drawn


def draw_measurement(image: ByteImage, one: Drawn) -> None:
    """Draw a measurement into an image, in place."""
    height = image.shape[0]
    width = max(1, round(height / 600))
    points = np.rint(one.outline_px).astype(int)
    pairs: Sequence[tuple[int, int]] = [(i, i + 1) for i in range(len(points) - 1)]
    if one.closed and len(points) > 2:
        pairs = [*pairs, (len(points) - 1, 0)]
    for i, j in pairs:
        cv2.line(image, points[i].tolist(), points[j].tolist(), LINE_BGR, width, cv2.LINE_AA)
    cross = max(7, round(height * _CROSS_SHARE))
    for point in points:
        cv2.drawMarker(
            image, point.tolist(), LINE_BGR, cv2.MARKER_CROSS, cross, width, cv2.LINE_AA
        )
    scale = max(0.4, height * _TEXT_SHARE / _FONT_PX)
    place = points.mean(axis=0) if one.closed else (points[0] + points[-1]) / 2
    room = cv2.getTextSize(one.label, cv2.FONT_HERSHEY_SIMPLEX, scale, 1)[0]
    column = np.clip(place[0] + cross, 0, max(0, image.shape[1] - room[0] - 2))
    row = np.clip(place[1], room[1] + 2, height - 4)
    write_label(image, one.label, (int(column), int(row)), scale)
