# SPDX-License-Identifier: Apache-2.0
"""Disparity maps as 16-bit PNG in KITTI's convention: 1/256 px, 0 = none."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

from binocular_recon.errors import FileError
from binocular_recon.io.image_files import read_image_file, write_image_file

_STEPS_PER_PX = 256.0


def read_disparity_png(path: Path) -> npt.NDArray[np.float32]:
    """Read a disparity map.

    Returns
    -------
    disparity_px : (H, W) float32
        NaN = none.

    Raises
    ------
    FileError
        If the file cannot be read or is not a 16-bit grey image.

    """
    steps = read_image_file(path)
    if steps.dtype != np.uint16 or steps.ndim != 2:
        raise FileError(f'{path} is not a disparity map: 16-bit grey is needed, got {steps.dtype}')
    return disparity_from_steps(steps)


def disparity_from_steps(steps: npt.NDArray[np.uint16]) -> npt.NDArray[np.float32]:
    """Return (H, W) float32 disparities, px, NaN = none, of 1/256 px, 0 = none."""
    return np.where(steps > 0, steps / np.float32(_STEPS_PER_PX), np.float32(np.nan))


def write_disparity_png(path: Path, disparity_px: npt.NDArray[np.float32]) -> None:
    """Write a disparity map, rounded to 1/256 px; raises a FileError if it cannot be written.

    Parameters
    ----------
    path : Path
        File to write.
    disparity_px : (H, W) float32
        Within 1/256 to 255 px; NaN = none.

    """
    steps = np.rint(np.nan_to_num(disparity_px, nan=0.0) * _STEPS_PER_PX)
    write_image_file(path, np.clip(steps, 0, 65535).astype(np.uint16))
