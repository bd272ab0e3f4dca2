# SPDX-License-Identifier: Apache-2.0
"""Whether the rig stood still: how far corners in its images are from where they mostly are."""

from __future__ import annotations

import cv2
import numpy as np

from binocular_recon.camera import FloatArray
from binocular_recon.images import ByteImage

# Frames of which most corners are farther from their median place are left out.
MOST_SHIFT_PX = 0.5
# Corners that are followed, and how far they lie apart, as a share of the width.
_CORNERS, _APART = 400, 0.02
_WINDOW = (15, 15)


class Corners:
    """Corners of the first image, and where the later ones show them (Lucas and Kanade)."""

    def __init__(self) -> None:
        self._first: ByteImage | None = None
        self._places = np.empty((0, 1, 2), np.float32)

    def follow(self, bgr: ByteImage) -> FloatArray:
        """Return the places of the corners in an image, (n, 2) px; NaN = lost.

        Parameters
        ----------
        bgr : (H, W, 3) uint8

        """
        grey: ByteImage = np.asarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2GRAY), np.uint8)
        if self._first is None:
            self._first = grey
            apart = max(1.0, _APART * grey.shape[1])
            corners = cv2.goodFeaturesToTrack(grey, _CORNERS, 0.01, apart)
            if corners is not None:
                self._places = corners
            return self._places[:, 0].astype(np.float64)
        if not len(self._places):
            return np.empty((0, 2))
        places, seen, _ = cv2.calcOpticalFlowPyrLK(
            self._first, grey, self._places, self._places.copy(), winSize=_WINDOW,
            flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
        )  # fmt: skip
        return np.where(seen > 0, places[:, 0].astype(np.float64), np.nan)


def moved_px(places: FloatArray) -> FloatArray:
    """Return how far the corners of each image lie from their median place in all, (n,) px.

    Parameters
    ----------
    places : (n, m, 2) float64
        Places of m corners in n images, px; NaN = lost.

    Returns
    -------
    moved_px : (n,) float64
        The median over the corners, so that things which move do not count as long as most of the
        scene stands still; 0 where no corner is seen.

    """
    moved = np.zeros(len(places))
    found = np.isfinite(places).all(axis=-1)
    places = places[:, found.any(axis=0)]
    if not places.size:
        return moved
    away = np.linalg.norm(places - np.nanmedian(places, axis=0), axis=-1)
    seen = np.isfinite(away).any(axis=1)
    moved[seen] = np.nanmedian(away[seen], axis=1)
    return moved
