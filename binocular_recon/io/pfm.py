# SPDX-License-Identifier: Apache-2.0
"""Disparity maps as PFM files: float32, rows bottom to top, inf = none."""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import BinaryIO

import numpy as np

from binocular_recon.errors import FileError
from binocular_recon.images import FloatImage
from binocular_recon.io.files import complete_file
from binocular_recon.io.text_files import open_file
from binocular_recon.stereo.rectification import LARGEST_SIDE_PX

# Longest header line accepted, bytes: a file that is not a PFM is not searched for a line end.
_LINE_LIMIT = 128


def write_pfm(path: Path, disparity_px: FloatImage) -> None:
    """Write a disparity map.

    Parameters
    ----------
    path : Path
        File to write; its folder must exist.
    disparity_px : (H, W) float32
        x_left - x_right; values that are not finite mean none.

    Raises
    ------
    FileError
        If the file cannot be written.

    """
    height, width = disparity_px.shape
    values = np.where(np.isfinite(disparity_px), disparity_px, np.inf)
    with complete_file(path) as file:
        file.write(f'Pf\n{width} {height}\n-1.0\n'.encode())
        file.write(np.ascontiguousarray(values[::-1], '<f4').data)


def read_pfm(path: Path, rows: slice = slice(None)) -> FloatImage:
    """Read a disparity map, or some rows of it.

    Parameters
    ----------
    path : Path
        Grey PFM of either byte order.
    rows : slice
        The rows to read, next to each other.

    Returns
    -------
    disparity_px : (h, W) float32
        x_left - x_right; NaN = none.

    Raises
    ------
    FileError
        If the file cannot be read or is not a grey PFM.

    Notes
    -----
    The sign of the scale gives the byte order. Its magnitude is ignored, as in the Middlebury
    tools, which write disparities in pixels whatever the scale.

    """
    try:
        with open_file(path) as file:
            width, height, byte_order = _read_header(path, file)
            # a header may promise any size: nothing is allocated that the file does not hold
            begin = file.tell()
            held = os.fstat(file.fileno()).st_size - begin
            first, last, _ = rows.indices(height)
            if held == 4 * width * height:
                file.seek(begin + 4 * width * (height - last))
                data = file.read(4 * width * (last - first))
    except OSError as error:
        if isinstance(error, FileError):
            raise
        raise FileError(f'{path} cannot be read: {error.strerror}; give a PFM file') from error
    if held != 4 * width * height:
        surplus = 'more' if held > 4 * width * height else f'{max(0, held)}'
        raise FileError(
            f'{path} is damaged: {width}x{height} px need {4 * width * height} bytes,'
            f' it has {surplus}'
        )
    values = np.frombuffer(data, byte_order + 'f4').reshape(last - first, width)[::-1]
    return np.where(np.isfinite(values), values, np.nan).astype(np.float32)


def _read_header(path: Path, file: BinaryIO) -> tuple[int, int, str]:
    """Return width, height and byte order (``<`` or ``>``)."""
    kind = file.readline(_LINE_LIMIT).strip()
    if kind == b'PF':
        raise FileError(
            f'{path} has three channels (PF); give a disparity map, which has one (Pf)'
        )
    try:
        if kind != b'Pf':
            raise ValueError
        width, height = map(int, file.readline(_LINE_LIMIT).split())
        scale = float(file.readline(_LINE_LIMIT))
        if width <= 0 or height <= 0 or not 0 < abs(scale) < math.inf:
            raise ValueError
    except ValueError:
        raise FileError(
            f'{path} is not a PFM file: expected the lines "Pf", "WIDTH HEIGHT" and a scale'
        ) from None
    if max(width, height) > LARGEST_SIDE_PX:
        raise FileError(
            f'{path} has {width}x{height} px; a disparity map has at most {LARGEST_SIDE_PX} px a'
            ' side'
        )
    return width, height, '<' if scale < 0 else '>'
