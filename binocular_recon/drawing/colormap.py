# SPDX-License-Identifier: Apache-2.0
"""Disparity and depth maps as colour or grey images."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

# Share of the values, %, beyond each end of the colours when no limits are given.
_CLIPPED_PERCENT = 1.0
# The ends of the colour scale beyond these are too dark to tell from black, which means none.
_FIRST_LEVEL, _LAST_LEVEL = 20, 240
# Colours of a map: red, yellow, green, blue; or white to dark grey.
TURBO, GREY = cv2.COLORMAP_TURBO, None
# Smaller spans of values have one colour.
_LEAST_SPAN = 1e-6
# Values written beside a colour bar.
_TICKS = 5


def heat_map(
    disparity_px: npt.NDArray[np.float32],
    limits_px: tuple[float, float] | None = None,
    colours: int | None = TURBO,
) -> npt.NDArray[np.uint8]:
    """Colour a disparity map: near is red, far is blue, none is black.

    Parameters
    ----------
    disparity_px : (H, W) float32
        Disparity; values that are not finite mean none.
    limits_px : (float, float), optional
        Disparities at the blue and the red end; values beyond take the end's colour. By
        default the range of the map, without one per cent of the values at each end. With the
        larger one first, as for depths, low values are red.
    colours : int, optional
        `TURBO`, or `GREY`: near is white, far is dark.

    Returns
    -------
    image : (H, W, 3) uint8
        BGR; black (0, 0, 0) stands for none and for nothing else.

    """
    valid = np.isfinite(disparity_px)
    if limits_px is None:
        limits_px = own_limits(disparity_px)
    low, high = limits_px
    span = high - low if abs(high - low) > _LEAST_SPAN else _LEAST_SPAN
    share = np.clip((disparity_px - low) / span, 0, 1)
    scaled = _FIRST_LEVEL + share * (_LAST_LEVEL - _FIRST_LEVEL)
    levels = np.where(valid, scaled, 0).astype(np.uint8)
    if colours is GREY:
        return cv2.cvtColor(levels, cv2.COLOR_GRAY2BGR)  # type: ignore[no-any-return]
    image: Any = cv2.applyColorMap(levels, colours)
    image[~valid] = 0
    return image  # type: ignore[no-any-return]


def heat_map_with_scale(
    disparity_px: npt.NDArray[np.float32],
    unit: str,
    colours: int | None = TURBO,
    *,
    near_is_low: bool = False,
) -> Any:
    """Return a heat map with its colour bar and the values at the bar's ends to the right.

    Parameters
    ----------
    disparity_px : (H, W) float32
        Values; those that are not finite mean none.
    unit : str
        Their unit.
    colours : int, optional
        `TURBO` or `GREY`.
    near_is_low : bool
        Whether low values are near, as depths are, and so red or white.

    Returns
    -------
    image : (H, W + bar, 3) uint8
        BGR.

    """
    low, high = own_limits(disparity_px)
    height = len(disparity_px)
    limits = (high, low) if near_is_low else (low, high)
    heat = heat_map(disparity_px, limits, colours)
    scale = max(0.35, height / 1200)
    texts = [f'{value:.1f} {unit}' for value in np.linspace(high, low, _TICKS)]
    sizes = [cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, scale, 1)[0] for text in texts]
    margin, bar = round(12 * scale), max(6, round(30 * scale))
    width = bar + 3 * margin + max(size[0] for size in sizes)
    panel = np.full((height, width, 3), 255, np.uint8)
    levels = np.linspace(high, low, height, dtype=np.float32)[:, None].repeat(bar, axis=1)
    panel[:, margin : margin + bar] = heat_map(levels, limits, colours)
    for text, place, size in zip(texts, np.linspace(0, 1, _TICKS), sizes, strict=True):
        y = round(size[1] + 2 + place * (height - size[1] - 5))
        origin = (2 * margin + bar, y)
        cv2.putText(
            panel, text, origin, cv2.FONT_HERSHEY_SIMPLEX, scale, (0, 0, 0), 1, cv2.LINE_AA
        )
    return np.hstack([heat, panel])


def own_limits(values: npt.NDArray[np.float32]) -> tuple[float, float]:
    """Return the range of a map's finite values without one per cent at each end."""
    finite = values[np.isfinite(values)]
    if finite.size == 0:
        return 0.0, 1.0
    low, high = np.percentile(finite, [_CLIPPED_PERCENT, 100 - _CLIPPED_PERCENT])
    return float(low), float(high)
