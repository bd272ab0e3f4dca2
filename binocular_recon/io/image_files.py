# SPDX-License-Identifier: Apache-2.0
"""Pictures as files."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from binocular_recon.errors import FileError
from binocular_recon.images import Image
from binocular_recon.io.files import complete_file


def read_image_file(path: Path) -> Image:
    """Read a picture without changing its depth or channels.

    Parameters
    ----------
    path : Path
        PNG, JPEG, TIFF or whatever else OpenCV reads.

    Returns
    -------
    image : (H, W) or (H, W, C) uint8, uint16 or float32
        Grey, BGR or BGRA.

    Raises
    ------
    FileError
        If the file cannot be read or holds no picture.

    """
    try:
        data = np.fromfile(path, np.uint8)
    except OSError as error:
        raise FileError(f'{path} cannot be read: {error.strerror}') from error
    image = decoded_image(data)
    if image is None:
        raise FileError(f'{path} is no picture ({data.size} bytes); give a PNG, JPEG or TIFF file')
    return image


def decoded_image(data: npt.NDArray[np.uint8]) -> Image | None:
    """Return the picture that the bytes of a file hold, or None if they hold none."""
    try:
        image = cv2.imdecode(data, cv2.IMREAD_UNCHANGED) if data.size else None
    except cv2.error:  # the file asks for more pixels than OpenCV takes
        return None
    return None if image is None else np.asarray(image)


def write_image_file(path: Path, image: Image) -> None:
    """Write a picture in the format of its suffix, complete or not at all.

    Raises
    ------
    FileError
        If the file cannot be written, or not as this kind of picture.

    """
    try:
        data = cv2.imencode(path.suffix, image)[1]
    except cv2.error as error:
        raise FileError(
            f'{path} cannot be written: no format of pictures of {image.dtype} ends in'
            f' {path.suffix!r}; choose .png or .tiff'
        ) from error
    with complete_file(path) as file:
        file.write(data.tobytes())
