# SPDX-License-Identifier: Apache-2.0
"""Images in memory: grey levels for matching, BGR for colour."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from binocular_recon.errors import ImageError
from binocular_recon.inputs.levels import Levels, find_levels

Image = npt.NDArray[Any]
FloatImage = npt.NDArray[np.float32]
ByteImage = npt.NDArray[np.uint8]
Mask = npt.NDArray[np.bool_]

# Smallest region of one level at the image border that is padding and not a dark object, px.
LEAST_PADDING = 100
_TYPES = ('uint8', 'uint16', 'float32', 'float64')
# Grey levels beyond white and below black are kept up to here: overshoot of interpolation.
_OVERSHOOT = 127.0


def to_grey(image: Image, levels: Levels | None = None) -> FloatImage:
    """Return grey levels on the scale 0..255, not rounded.

    Parameters
    ----------
    image : (H, W) or (H, W, C), uint8, uint16 or float
        Grey (C = 1), BGR or BGRA.
    levels : Levels, optional
        Black and white of the image; by default found from it. Those of 8-bit images are 0, 255.

    Returns
    -------
    grey : (H, W) float32
        Rec. 601 luminance; NaN where a float image is NaN or infinite (no data). At most 127
        levels below black or above white.

    Raises
    ------
    ImageError
        If the shape or the dtype is not one of these.

    """
    channels = _check(image)
    grey = image.reshape(image.shape[:2]) if channels == 1 else image
    scaled = _scaled(grey, levels)
    if channels > 1:
        code = cv2.COLOR_BGR2GRAY if channels == 3 else cv2.COLOR_BGRA2GRAY
        scaled = np.asarray(cv2.cvtColor(scaled, code))
    if image.dtype.kind == 'f':
        scaled[~np.isfinite(scaled)] = np.nan
    if image.dtype != np.uint8:  # also keeps NaN
        np.clip(scaled, -_OVERSHOOT, 255 + _OVERSHOOT, out=scaled)
    return scaled


def _scaled(image: Image, levels: Levels | None) -> FloatImage:
    """Return an image with black at 0 and white at 255; no data of 16-bit images stays 0."""
    if image.dtype == np.uint8:
        return np.asarray(image, np.float32)
    black, white = levels or find_levels(image)
    scaled: FloatImage = np.asarray(image, np.float32)
    if black:
        scaled = scaled - np.float32(black)
        if image.dtype.kind == 'u':
            np.maximum(scaled, 0, out=scaled)
    return scaled * np.float32(255.0 / (white - black))


def mark_empty(grey: FloatImage) -> None:
    """Set padding to NaN, in place: uniform regions at the border, blank rows and columns.

    Rectification and recorders leave regions of black, or of another level in the corners, and
    incomplete transfers leave blank lines. Without this, their outlines would be matched.

    Parameters
    ----------
    grey : (H, W) float32
        Grey levels from `to_grey`; becomes NaN where there is no data.

    """
    black = grey == 0
    border = np.concatenate([black[0], black[-1], black[:, 0], black[:, -1]])
    if border.any() and not black.all():
        grey[connected_to_border(black, LEAST_PADDING)] = np.nan
    height, width = grey.shape
    for corner in ((0, 0), (width - 1, 0), (0, height - 1), (width - 1, height - 1)):
        level = grey[corner[::-1]]
        if np.isnan(level):
            continue
        mask = np.zeros((height + 2, width + 2), np.uint8)
        area = cv2.floodFill(grey, mask, corner, 0, 0, 0, 4 | cv2.FLOODFILL_MASK_ONLY)[0]
        if LEAST_PADDING <= area < grey.size:
            grey[mask[1:-1, 1:-1] > 0] = np.nan
    for lines in (grey, grey.T):
        # fmin and fmax ignore NaN
        blank = np.fmin.reduce(lines, axis=1) == np.fmax.reduce(lines, axis=1)
        if blank.any() and not blank.all():
            lines[blank] = np.nan


def connected_to_border(region: Mask, least_pixels: int = 1) -> Mask:
    """Return the 4-connected parts of a region, (H, W) bool, that reach the image border.

    Parts of fewer than ``least_pixels`` are left out.
    """
    _, labels = cv2.connectedComponents(region.astype(np.uint8), connectivity=4)
    reaching = np.zeros(labels.max() + 1, np.bool_)
    reaching[np.concatenate([labels[0], labels[-1], labels[:, 0], labels[:, -1]])] = True
    if least_pixels > 1:
        reaching &= np.bincount(labels.ravel()) >= least_pixels
    reaching[0] = False  # label 0 is all that is outside the region
    connected: Mask = reaching[labels]
    return connected


def to_bgr8(image: Image, levels: Levels | None = None) -> npt.NDArray[np.uint8]:
    """Return an image for display and for the colour of points.

    Parameters
    ----------
    image, levels
        As for `to_grey`.

    Returns
    -------
    bgr : (H, W, 3) uint8
        Black where a float image has no data; the input itself if it is 8-bit BGR already.

    Raises
    ------
    ImageError
        If the shape or the dtype is not one of these.

    """
    channels = _check(image)
    if image.dtype != np.uint8:
        scaled = np.nan_to_num(_scaled(image, levels), nan=0.0, posinf=0.0, neginf=0.0)
        image = np.clip(np.rint(scaled), 0, 255).astype(np.uint8)
    if channels == 3:
        return image
    code = cv2.COLOR_GRAY2BGR if channels == 1 else cv2.COLOR_BGRA2BGR
    bgr: npt.NDArray[np.uint8] = cv2.cvtColor(image, code)
    return bgr


def window_mean(image: FloatImage, side: int) -> FloatImage:
    """Return the mean of the ``side`` x ``side`` window around each pixel of an image (H, W)."""
    mean: FloatImage = cv2.blur(image, (side, side), borderType=cv2.BORDER_REFLECT_101)
    return mean


def window_range(image: FloatImage, side: int) -> tuple[FloatImage, FloatImage]:
    """Return the smallest and the largest finite value of the window around each pixel.

    Of an image (H, W); the smallest is above the largest where the window has none.
    """
    known, window = np.isfinite(image), np.ones((side, side), np.uint8)
    smallest = cv2.erode(np.where(known, image, np.float32(np.inf)), window)
    largest = cv2.dilate(np.where(known, image, np.float32(-np.inf)), window)
    return np.asarray(smallest, np.float32), np.asarray(largest, np.float32)


def _check(image: Image) -> int:
    """Return the number of channels of an accepted image."""
    channels = 1 if image.ndim == 2 else image.shape[-1]
    if image.ndim not in (2, 3) or channels not in (1, 3, 4) or image.size == 0:
        raise ImageError(
            f'image has shape {image.shape}; it must be (rows, columns) or (rows, columns,'
            ' channels) with 1, 3 or 4 channels'
        )
    if image.dtype.name not in _TYPES:
        raise ImageError(
            f'image has dtype {image.dtype}; convert it to one of {", ".join(_TYPES)}'
        )
    return channels
