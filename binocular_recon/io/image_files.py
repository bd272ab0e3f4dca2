# SPDX-License-Identifier: Apache-2.0
"""Image files."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from binocular_recon.errors import FileError
from binocular_recon.images import Image
from binocular_recon.io.files import complete_file


def read_image_file(path: Path) -> Image:
    """Read an image without changing its type or channels.

    Parameters
    ----------
    path : Path
        PNG, JPEG, TIFF or another format that OpenCV reads.

    Returns
    -------
    image : (H, W) or (H, W, C) uint8, uint16 or float32
        Grey, BGR or BGRA.

    Raises
    ------
    FileError
        If the file cannot be read or is not an image.

    """
    try:
        data = np.fromfile(path, np.uint8)
    except OSError as error:
        raise FileError(f'{path} cannot be read: {error.strerror}') from error
    image = decoded_image(data)
    if image is None:
        raise FileError(
            f'{path} is not an image ({data.size} bytes); give a PNG, JPEG or TIFF file'
        )
    return image


def decoded_image(data: npt.NDArray[np.uint8]) -> Image | None:
    """Return the image that the bytes of a file hold, or None if they are not an image."""
    try:
        image = cv2.imdecode(data, cv2.IMREAD_UNCHANGED) if data.size else None
    except cv2.error:  # the file claims more pixels than OpenCV accepts
        return None
    return None if image is None else np.asarray(image)


def write_image_file(path: Path, image: Image) -> None:
    """Write an image in the format of its suffix, completely or not at all.

    Raises
    ------
    FileError
        If the file cannot be written, or its format cannot hold the image.

    """
    try:
        data = cv2.imencode(path.suffix, image)[1]
    except cv2.error as error:
        raise FileError(
            f'{path} cannot be written: {path.suffix!r} is not a format for images of'
            f' {image.dtype}; choose .png or .tiff'
        ) from error
    with complete_file(path) as file:
        file.write(data.tobytes())
