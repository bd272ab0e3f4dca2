# SPDX-License-Identifier: Apache-2.0
"""Text in images."""

from __future__ import annotations

import cv2

from binocular_recon.images import ByteImage

_TEXT_BGR, _OUTLINE_BGR = (255, 255, 255), (0, 0, 0)
# Width of the outline and of the letters' strokes, px at scale 1.
_OUTLINE_PX, _STROKE_PX = 4, 1


def write_label(image: ByteImage, text: str, place: tuple[int, int], scale: float) -> None:
    """Write into an image, white with a dark outline, so that it is legible on any ground.

    Parameters
    ----------
    image : (H, W, 3) uint8
        BGR; changed in place.
    text : str
        One line; OpenCV's font has ASCII only.
    place : (int, int)
        Column and row of the lower left corner of the text.
    scale : float
        Size as a multiple of the font's own, about 22 px.

    """
    for colour, width in ((_OUTLINE_BGR, _OUTLINE_PX), (_TEXT_BGR, _STROKE_PX)):
        thickness = max(1, round(scale * width))
        cv2.putText(
            image, text, place, cv2.FONT_HERSHEY_SIMPLEX, scale, colour, thickness, cv2.LINE_AA
        )
