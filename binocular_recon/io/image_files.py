# SPDX-License-Identifier: Apache-2.0
"""Image files."""

from __future__ import annotations

import struct
from pathlib import Path

import cv2
import numpy as np

from binocular_recon.errors import FileError, ImageError
from binocular_recon.images import Image
from binocular_recon.inputs.camera_checks import check_image_size
from binocular_recon.io.files import complete_file
from binocular_recon.io.image_headers import MOST_BYTES, jpeg_segments, read_header
from binocular_recon.io.jpeg_check import loss
from binocular_recon.io.native_lines import native_lines_held
from binocular_recon.io.text_files import read_bytes

# Of the largest image, not compressed, with its header.
LARGEST_FILE = MOST_BYTES + (1 << 20)


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
    data = read_bytes(path, 'give a PNG, JPEG or TIFF file', LARGEST_FILE)
    try:
        return decoded_image(data, str(path))
    except ImageError as error:
        raise FileError(str(error)) from error


def decoded_image(data: bytes, name: str, size: tuple[int, int] | None = None) -> Image:
    """Decode an image file.

    Parameters
    ----------
    data : bytes
        The whole file.
    name : str
        What it is, in errors.
    size : (int, int), optional
        Width and height that it must have; no other one is decoded.

    Returns
    -------
    image : (H, W) or (H, W, C) uint8, uint16 or float32
        Grey, BGR or BGRA.

    Raises
    ------
    ImageError
        If the data are damaged, cut off or not an image, or claim another or an implausible size.

    """
    if not _is_whole(data):
        raise ImageError(
            f'{name} is truncated: {len(data)} bytes without an end marker; make the connection'
            ' reliable'
        )
    try:
        header = read_header(data)
    except ImageError as error:
        raise ImageError(f'{name} {error}') from error
    if size:
        check_image_size((header.width, header.height), size, name)
    try:
        with native_lines_held() as warnings:
            image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error:
        image = None
    if image is None:
        raise ImageError(
            f'{name} cannot be decoded: {len(data)} bytes of {header.format} are damaged or of an'
            ' unusual kind; send plain JPEG or PNG'
        )
    if header.format == 'JPEG' and (lost := loss(data, warnings)):
        raise ImageError(
            f'{name} is truncated: its {len(data)} bytes of JPEG {lost}; make the connection'
            ' reliable'
        )
    return np.asarray(image)


def _is_whole(data: bytes) -> bool:
    """Tell whether a JPEG or PNG file has its end marker; other formats are not checked."""
    if data.startswith(b'\x89PNG'):
        return data.rfind(b'IEND\xaeB`\x82') > 0
    if not data.startswith(b'\xff\xd8'):
        return True
    try:  # a thumbnail in a segment before the first scan has its own end marker
        scan = jpeg_segments(data)[-1][2]
    except (LookupError, ValueError, struct.error):
        return False
    return data.find(b'\xff\xd9', scan) > 0


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
