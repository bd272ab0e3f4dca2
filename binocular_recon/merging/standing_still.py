# SPDX-License-Identifier: Apache-2.0
"""Whether the rig stood still: how far the images of its frames are shifted."""

from __future__ import annotations

import cv2
import numpy as np

from binocular_recon.camera import FloatArray
from binocular_recon.images import ByteImage

# Frames whose image is shifted farther from the median of all are left out.
MOST_SHIFT_PX = 0.5
# A shift is that of the scene if the images agree this well; 1 = the same image.
_RESPONSE = 0.05


class ShiftMeter:
    """Measures how far images are shifted, by phase correlation with the first one.

    Things that move in the scene hardly count, as long as most of it stands still. Shifts have a
    common offset, of up to 1 px: OpenCV's peak lies between pixels where nothing has moved.
    """

    def __init__(self) -> None:
        self._first: FloatArray | None = None
        self._window: FloatArray | None = None

    def __call__(self, bgr: ByteImage) -> FloatArray:
        """Return the shift of an image, (2,) px: to the right and down; NaN if it cannot be told.

        Parameters
        ----------
        bgr : (H, W, 3) uint8

        """
        grey = cv2.cvtColor(bgr, cv2.COLOR_BGR2GRAY)
        small = cv2.resize(grey, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
        image = small.astype(np.float64)
        if self._first is None:
            self._first = image
            self._window = cv2.createHanningWindow(image.shape[::-1], cv2.CV_64F)
        shift, response = cv2.phaseCorrelate(self._first, image, self._window)
        return 2 * np.array(shift) if response > _RESPONSE else np.full(2, np.nan)


def moved_px(shifts_px: FloatArray) -> FloatArray:
    """Return how far each image, (n, 2) shifts, lies from the median of all, (n,) px.

    Where the shift is not known, 0.
    """
    middle = np.nanmedian(shifts_px, axis=0)
    moved: FloatArray = np.nan_to_num(np.hypot(*(shifts_px - middle).T))
    return moved
