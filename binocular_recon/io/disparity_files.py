# SPDX-License-Identifier: Apache-2.0
"""Disparity maps in the formats of other programs: PFM, 16-bit PNG, TIFF and npy."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from binocular_recon.errors import FileError, shortened
from binocular_recon.images import FloatImage
from binocular_recon.io.disparity_png import disparity_from_steps, read_disparity_png
from binocular_recon.io.image_files import read_image_file
from binocular_recon.io.pfm import read_pfm
from binocular_recon.io.text_files import open_file

# How npy files and archives of them begin.
_NPY, _ZIP = b'\x93NUMPY', b'PK'


def read_disparity_file(path: Path) -> FloatImage:
    """Read a disparity map in the format of its ending.

    Parameters
    ----------
    path : Path
        ``.pfm``; ``.png``, 16 bit in KITTI's convention (1/256 px, 0 = none); ``.tif`` and
        ``.tiff``, float32 px or 16 bit as in PNG; ``.npy``, px, (H, W) with or without further
        axes of length 1.

    Returns
    -------
    disparity_px : (H, W) float32
        x_left - x_right; NaN = none (in the file NaN or infinite).

    Raises
    ------
    FileError
        If the file cannot be read, is damaged or is not a disparity map.

    """
    reader = READERS.get(path.suffix.lower())
    if reader is None:
        raise FileError(
            f'{path}: {path.suffix!r} is not a format of disparity maps; it must be one of'
            f' {", ".join(READERS)}'
        )
    return reader(path)


def _read_tiff(path: Path) -> FloatImage:
    values = read_image_file(path)
    if values.ndim != 2 or values.dtype not in (np.uint16, np.float32):
        raise FileError(
            f'{path} is not a disparity map: one channel of float32 px, or of 16 bit in steps of'
            f' 1/256 px, is needed, got {values.dtype} of shape {values.shape}'
        )
    return disparity_from_steps(values) if values.dtype == np.uint16 else _finite(values)


def _read_npy(path: Path) -> FloatImage:
    try:
        with open_file(path) as file:
            magic = file.read(len(_NPY))
        if magic.startswith(_ZIP):
            raise FileError(f'{path} holds several arrays (npz); save the disparity alone as npy')
        if magic != _NPY:  # not even a pickle, which numpy would look for
            raise FileError(f'{path} is not an npy file')
        # mapped: a header may promise any size
        values = np.load(path, mmap_mode='r', allow_pickle=False)
    except FileError:
        raise
    except OSError as error:
        raise FileError(f'{path} cannot be read: {error.strerror}; give an npy file') from error
    except Exception as error:  # whatever the parser of its header meets
        raise FileError(f'{path} is not an npy file of numbers: {shortened(error)}') from error
    image = values.reshape([length for length in values.shape if length != 1])
    if image.ndim != 2 or image.dtype.kind not in 'fiu':
        raise FileError(
            f'{path} is not a disparity map: numbers of shape (rows, columns) are needed, got'
            f' {values.dtype} of shape {values.shape}'
        )
    return _finite(image)


def _finite(values: FloatImage) -> FloatImage:
    """Return float32, NaN for all that is not finite."""
    return np.where(np.isfinite(values), values, np.nan).astype(np.float32)


# By the ending of the file's name.
READERS: dict[str, Callable[[Path], FloatImage]] = {
    '.pfm': read_pfm,
    '.png': read_disparity_png,
    '.tif': _read_tiff,
    '.tiff': _read_tiff,
    '.npy': _read_npy,
}
