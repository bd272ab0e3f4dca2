# SPDX-License-Identifier: Apache-2.0
"""Pictures in memory: grey levels for matching, BGR for colour."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from binocular_recon.errors import ImageError

Image = npt.NDArray[Any]
FloatImage = npt.NDArray[np.float32]
ByteImage = npt.NDArray[np.uint8]
Mask = npt.NDArray[np.bool_]

# Largest value of each accepted type: white.
# Fewer pixels of one level in one piece at the border are a thing in the picture.
LEAST_PADDING = 100
_WHITE = {'uint8': 255.0, 'uint16': 65535.0, 'float32': 1.0, 'float64': 1.0}


def to_grey(image: Image) -> FloatImage:
    """Return grey levels of 255 without rounding.

    Parameters
    ----------
    image : (H, W) or (H, W, C), uint8, uint16 or float
        Grey (C = 1), BGR or BGRA. White is 255, 65535 or 1.0.

    Returns
    -------
    grey : (H, W) float32
        Rec. 601 luminance; NaN where the picture has no data (a float image's NaN or infinity).

    Raises
    ------
    ImageError
        If the type or the number of channels is another.

    """
    channels = _check(image)
    grey = image.reshape(image.shape[:2]) if channels == 1 else image
    scaled: FloatImage = np.asarray(grey, np.float32) * np.float32(
        255.0 / _WHITE[image.dtype.name]
    )
    if channels > 1:
        code = cv2.COLOR_BGR2GRAY if channels == 3 else cv2.COLOR_BGRA2GRAY
        scaled = np.asarray(cv2.cvtColor(scaled, code))
    if image.dtype.kind == 'f':
        scaled[~np.isfinite(scaled)] = np.nan
    return scaled


def mark_empty(grey: FloatImage) -> None:
    """Mark as no data, in place, what an image only pads: black borders, blank rows and columns.

    Rectification and recorders leave black, or another level in the corners, where they have
    nothing to show, and broken transfers blank lines. Their edges would be matched like any other.

    Parameters
    ----------
    grey : (H, W) float32
        Grey levels, `to_grey`; becomes NaN where there is no data.

    """
    black = grey == 0
    border = np.concatenate([black[0], black[-1], black[:, 0], black[:, -1]])
    if border.any() and not black.all():
        _, labels = cv2.connectedComponents(black.astype(np.uint8), connectivity=4)
        touching = np.concatenate([labels[0], labels[-1], labels[:, 0], labels[:, -1]])
        padding = np.zeros(labels.max() + 1, np.bool_)
        padding[touching] = True
        padding &= np.bincount(labels.ravel()) >= LEAST_PADDING
        padding[0] = False  # what is not black
        grey[padding[labels]] = np.nan
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
        # fmin and fmax pass over NaN
        blank = np.fmin.reduce(lines, axis=1) == np.fmax.reduce(lines, axis=1)
        if blank.any() and not blank.all():
            lines[blank] = np.nan


def to_bgr8(image: Image) -> npt.NDArray[np.uint8]:
    """Return a picture for the eye and for the colour of points.

    Parameters
    ----------
    image : (H, W) or (H, W, C), uint8, uint16 or float
        As for `to_grey`.

    Returns
    -------
    bgr : (H, W, 3) uint8
        Black where a float image has no data; the input itself where it is such a picture.

    Raises
    ------
    ImageError
        If the type or the number of channels is another.

    """
    channels = _check(image)
    if image.dtype != np.uint8:
        levels = np.nan_to_num(image, nan=0.0, posinf=0.0, neginf=0.0).astype(np.float32)
        scaled = np.rint(levels * np.float32(255.0 / _WHITE[image.dtype.name]))
        image = np.clip(scaled, 0, 255).astype(np.uint8)
    if channels == 3:
        return image
    code = cv2.COLOR_GRAY2BGR if channels == 1 else cv2.COLOR_BGRA2BGR
    bgr: npt.NDArray[np.uint8] = cv2.cvtColor(image, code)
    return bgr


def _check(image: Image) -> int:
    """Return the number of channels of an accepted picture."""
    channels = 1 if image.ndim == 2 else image.shape[-1]
    if image.ndim not in (2, 3) or channels not in (1, 3, 4) or image.size == 0:
        raise ImageError(
            f'picture has shape {image.shape}; it must be (rows, columns) or (rows, columns,'
            ' channels) with 1, 3 or 4 channels'
        )
    if image.dtype.name not in _WHITE:
        raise ImageError(
            f'picture has type {image.dtype}; convert it to one of {", ".join(_WHITE)}'
        )
    return channels
