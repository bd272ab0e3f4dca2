# SPDX-License-Identifier: Apache-2.0
"""Disparity maps as pictures."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

# Share of the values, %, beyond each end of the colours when no limits are given.
_CLIPPED_PERCENT = 1.0
# The ends of the colour scale beyond these are too dark to be told from none.
_FIRST_LEVEL, _LAST_LEVEL = 20, 240


def heat_map(
    disparity_px: npt.NDArray[np.float32], limits_px: tuple[float, float] | None = None
) -> npt.NDArray[np.uint8]:
    """Colour a disparity map: near is red, far is blue, none is black.

    Parameters
    ----------
    disparity_px : (H, W) float32
        Disparity; values that are not finite mean none.
    limits_px : (float, float), optional
        Disparities at the blue and the red end; values beyond take the end's colour. Without them
        the map's own range is used, less one percent at each end.

    Returns
    -------
    picture : (H, W, 3) uint8
        BGR; black (0, 0, 0) stands for none and for nothing else.

    """
    valid = np.isfinite(disparity_px)
    if limits_px is None:
        limits_px = _own_limits(disparity_px[valid])
    low, high = limits_px
    share = np.clip((disparity_px - low) / max(high - low, 1e-6), 0, 1)
    scaled = _FIRST_LEVEL + share * (_LAST_LEVEL - _FIRST_LEVEL)
    levels = np.where(valid, scaled, 0).astype(np.uint8)
    picture: Any = cv2.applyColorMap(levels, cv2.COLORMAP_TURBO)
    picture[~valid] = 0
    return picture  # type: ignore[no-any-return]


def _own_limits(values: npt.NDArray[np.float32]) -> tuple[float, float]:
    if values.size == 0:
        return 0.0, 1.0
    low, high = np.percentile(values, [_CLIPPED_PERCENT, 100 - _CLIPPED_PERCENT])
    return float(low), float(high)
