# SPDX-License-Identifier: Apache-2.0
"""Images of a report, small enough for a page."""

from __future__ import annotations

import cv2
import numpy as np

from binocular_recon.camera import FloatArray
from binocular_recon.drawing.page import embedded_image, figure
from binocular_recon.images import ByteImage
from binocular_recon.stereo.rectification import LARGEST_SIDE_PX

# Width of an image over the whole page, and of one of two beside each other, px.
_WIDE_PX, _HALF_PX = 1500, 960
_QUALITY = 82
# A part around picks: its size, its width over that of the picks, and its least width, px.
_PART_PX, _PART_MARGIN, _LEAST_PART_PX = (480, 360), 1.7, 160


def photo(image: ByteImage, caption: str, *, kind: str = '') -> str:
    """Return a figure of a BGR image as JPEG; ``kind`` as for `figure`, caption HTML."""
    return figure(
        embedded_image(jpeg(image, wide=kind == 'wide'), 'jpeg', caption), caption, kind=kind
    )


def jpeg(image: ByteImage, *, wide: bool = True) -> bytes:
    """Return a BGR image as JPEG, no larger than a page needs."""
    width = min(image.shape[1], _WIDE_PX if wide else _HALF_PX)
    height = max(1, round(image.shape[0] * width / image.shape[1]))
    small = cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)
    data: np.ndarray = cv2.imencode('.jpg', small, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])[1]
    return data.tobytes()


def cut_out(image: ByteImage, places_px: FloatArray) -> tuple[ByteImage, FloatArray]:
    """Return the part of an image around some places, enlarged, and where they are in it.

    Parameters
    ----------
    image : (H, W, 3) uint8
    places_px : (N, 2) float64

    Returns
    -------
    part : (360, 480, 3) uint8
    places_px : (N, 2) float64

    """
    width, height = _PART_PX
    # an image is smaller
    places_px = places_px.clip(-LARGEST_SIDE_PX, LARGEST_SIDE_PX)
    low, high = places_px.min(axis=0), places_px.max(axis=0)
    wide = max((high - low) * [1, width / height]) * _PART_MARGIN
    scale = width / max(wide, _LEAST_PART_PX)
    shift = np.array([width, height]) / 2 - scale * (low + high) / 2
    turn = np.array([[scale, 0, shift[0]], [0, scale, shift[1]]])
    # averaging first, where many pixels become one
    blurred = cv2.GaussianBlur(image, (0, 0), 0.5 / scale) if scale < 0.7 else image
    part = cv2.warpAffine(
        blurred, turn, _PART_PX, flags=cv2.INTER_LINEAR, borderValue=(255, 255, 255)
    )
    return np.asarray(part, np.uint8), scale * places_px + shift
