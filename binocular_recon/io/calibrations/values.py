# SPDX-License-Identifier: Apache-2.0
"""Values of calibration files: numbers, matrices and poses of the shapes that they must have."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import numpy as np

from binocular_recon.camera import FloatArray
from binocular_recon.errors import CalibrationError
from binocular_recon.number_text import plain, significant
from binocular_recon.rotations import rotation

# No entry that is read has more numbers.
_MOST_NUMBERS, _MOST_STEPS = 256, 4096
# Nothing that a calibration states is larger.
_LARGEST = 1e12
# Largest element of R R^T - I in a rotation: files may hold few digits.
_ROTATION_TOLERANCE = 1e-3


def numbers(value: Any, where: str, *counts: int) -> FloatArray:
    """Return the numbers of an entry in the order of the file, nested lists flattened.

    Parameters
    ----------
    value : object
        A number, lists of numbers, or a matrix with ``rows``, ``cols`` and ``data``.
    where : str
        File and entry, for errors.
    *counts : int
        How many numbers there may be; any number without it.

    Raises
    ------
    CalibrationError
        If there are others, or one is not finite.

    """
    if isinstance(value, dict):
        value = _matrix_data(value, where)
    found: list[float] = []
    waiting, steps = [value], 0
    while waiting:
        one = waiting.pop()
        steps += 1
        if isinstance(one, list | tuple | np.ndarray) and steps < _MOST_STEPS:
            waiting.extend(reversed(one))
        else:
            found.append(_number(one, where))
        if steps > _MOST_STEPS or len(found) > _MOST_NUMBERS:
            raise CalibrationError(f'{where} has more than {_MOST_NUMBERS} values; check the file')
    if counts and len(found) not in counts:
        raise CalibrationError(
            f'{where} must have {" or ".join(map(str, counts))} values, got {len(found)};'
            ' check the file'
        )
    return np.array(found, np.float64)


def _number(value: Any, where: str) -> float:
    try:
        # text: PyYAML does not know 1e-05, nor OpenCV's .Nan
        number = float(value) if not isinstance(value, bool | bytes) else math.nan
    except (TypeError, ValueError, OverflowError):
        number = math.nan
    if not abs(number) < _LARGEST:
        raise CalibrationError(
            f'{where} holds {str(value)[:40]!r}, which is not a number below {plain(_LARGEST)};'
            ' check the file, or calibrate again'
        )
    return number


def _matrix_data(value: dict[Any, Any], where: str) -> Any:
    """Return the data of a matrix, checked against its rows and columns."""
    if 'data' not in value:
        raise CalibrationError(f'{where} has no data, only {_keys(value)}; check the file')
    data = value['data']
    if isinstance(data, bytes) or (isinstance(data, str) and 'base64' in data):
        raise CalibrationError(
            f'{where} is stored in base64; write the file without cv::FileStorage::BASE64'
        )
    if 'rows' in value and 'cols' in value and isinstance(data, list):
        rows, columns = numbers([value['rows'], value['cols']], where, 2)
        if rows * columns != len(data) and not any(isinstance(one, list) for one in data):
            raise CalibrationError(
                f'{where} must have {rows:g} x {columns:g} values, got {len(data)}; the file is'
                ' cut off or was edited, write it again'
            )
    return data


def entry(content: Any, key: str, where: str, remedy: str) -> Any:
    """Return an entry of a mapping; raises a CalibrationError with the remedy if it is missing."""
    if not isinstance(content, dict):
        raise CalibrationError(f'{where} holds no names with values; {remedy}')
    if content.get(key) is None:
        raise CalibrationError(f'{where} has no {key}, only {_keys(content)}; {remedy}')
    return content[key]


def _keys(content: dict[Any, Any]) -> str:
    names = [str(key)[:30] for key in content]
    return ', '.join(names[:8]) + (', ...' if len(names) > 8 else '') if names else 'nothing'


def matrix_of(fx: float, fy: float, cx: float, cy: float, skew: float = 0.0) -> FloatArray:
    """Return K (3, 3), px."""
    return np.array([[fx, skew, cx], [0, fy, cy], [0, 0, 1.0]])


def image_size(value: Any, where: str) -> tuple[int, int]:
    """Return width and height, px, of an entry that states them in this order."""
    width, height = numbers(value, where, 2)
    if width != int(width) or height != int(height) or min(width, height) <= 0:
        raise CalibrationError(
            f'{where} is {width:g}x{height:g} px, it must be two whole numbers above 0'
        )
    return int(width), int(height)


def turn_of(value: Any, where: str) -> FloatArray:
    """Return a rotation (3, 3), of a matrix or of a rotation vector (rad)."""
    values = numbers(value, where, 9, 3)
    if values.size == 3:
        return rotation(values)
    R = values.reshape(3, 3)
    off = float(np.abs(R @ R.T - np.eye(3)).max())
    if off > _ROTATION_TOLERANCE:
        raise CalibrationError(
            f'{where} is not a rotation: R R^T is {significant(off, 2)} from the identity, at most'
            f' {_ROTATION_TOLERANCE} is allowed; check the order of its values, or calibrate again'
        )
    if np.linalg.det(R) < 0:
        raise CalibrationError(
            f'{where} is not a rotation but a reflection (determinant -1): one axis has the wrong'
            ' direction, as in left-handed frames; state it with x right, y down, z forward'
        )
    u, _, vt = np.linalg.svd(R)
    return u @ vt if off > 1e-9 else R


def pose_of(R: FloatArray, T: FloatArray) -> FloatArray:
    """Return the transformation (4, 4) x -> R x + T."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = R, T
    return pose


def inverse(pose: FloatArray) -> FloatArray:
    """Return the inverse of a rigid transformation (4, 4)."""
    R = pose[:3, :3].T
    return pose_of(R, -R @ pose[:3, 3])


def transformation(value: Any, where: str) -> FloatArray:
    """Return a rigid transformation (4, 4) of 16 values by rows, or 12 without the last row."""
    values = numbers(value, where, 16, 12)
    pose = np.vstack([values[:12].reshape(3, 4), [0, 0, 0, 1]])
    if values.size == 16:
        last = values[12:]
        if np.abs(last - [0, 0, 0, 1]).max() > 1e-6:
            written = ' '.join(f'{one:g}' for one in last)
            why = 'its rows and columns are exchanged' if not pose[:3, 3].any() else 'check it'
            raise CalibrationError(
                f'{where} is not a transformation: its last row is {written}, it must be 0 0 0 1;'
                f' {why}'
            )
    return pose_of(turn_of(pose[:3, :3].tolist(), f'{where}: its rotation'), pose[:3, 3])


def side_of(text: str) -> str:
    """Return ``'left'`` or ``'right'`` if a name says so, else an empty text."""
    words = set(re.split('[^a-z]+', text.lower()))
    found = {side for side in ('left', 'right') if side in text.lower() or side[0] in words}
    return found.pop() if len(found) == 1 else ''


def frame_of(name: str) -> str:
    """Return what the names of the two images of a frame share."""
    path = Path(name)
    if len(path.parts) > 1:  # each camera has its folder
        return path.name.lower()
    return re.sub(r'left|right|cam(era)?_?\d+|(?<![a-z])[lr](?![a-z])', '', name.lower())
