# SPDX-License-Identifier: Apache-2.0
"""The covariance of a calibration in ``calibration.json``, which camera files cannot hold.

``parameters`` names the p parameters in order, ``covariance`` has p rows of p numbers (px, rad,
m); parameters that were not estimated have rows and columns of 0.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from binocular_recon.camera import Camera, RigCovariance
from binocular_recon.errors import CalibrationError
from binocular_recon.io.text_files import numbers, read_json

_REMEDY = 'calibrate again, or delete it to go on without the covariance'


def read_covariance(path: Path, left: Camera, right: Camera) -> RigCovariance | None:
    """Read the covariance of a calibration.

    Parameters
    ----------
    path : Path
        The ``calibration.json``.
    left, right : Camera
        The camera files beside it.

    Returns
    -------
    RigCovariance or None
        None if the file is missing, or was written before calibrations had a covariance.

    Raises
    ------
    FileError
        If the file cannot be read or is not JSON.
    CalibrationError
        If it is not a calibration, or that of other cameras; the message begins with the path.

    """
    if not path.exists():
        return None
    content = read_json(path, _REMEDY)
    if not isinstance(content, dict):
        raise CalibrationError(f'{path} is not a calibration as `calibrate` writes it; {_REMEDY}')
    if 'covariance' not in content:
        return None
    try:
        _check_cameras(content, left, right)
        names = content.get('parameters')
        if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
            raise CalibrationError(f'parameters must be a list of names; {_REMEDY}')
        matrix = numbers('covariance', content['covariance'], CalibrationError)
        return RigCovariance(left, right, tuple(names), matrix)
    except CalibrationError as error:
        raise CalibrationError(f'{path}: {error}') from error


def _check_cameras(content: dict[str, Any], left: Camera, right: Camera) -> None:
    """Raise a CalibrationError unless the file states the cameras of the camera files."""
    for side, camera in (('left', left), ('right', right)):
        stated = content.get(side)
        if not isinstance(stated, dict) or not {'K', 'D'} <= stated.keys():
            raise CalibrationError(f'K and D of the {side} camera are missing; {_REMEDY}')
        K = numbers(f'K of the {side} camera', stated['K'], CalibrationError)
        D = numbers(f'D of the {side} camera', stated['D'], CalibrationError)
        same = K.shape == camera.K.shape and D.shape == camera.D.shape
        if not same or not (np.allclose(K, camera.K) and np.allclose(D, camera.D)):
            raise CalibrationError(
                f'the {side} camera is not that of {side}.yaml (fx {K.flat[0]:g} px there'
                f' {camera.K[0, 0]:g} px); keep the files of one calibration together, or delete'
                ' calibration.json to go on without the covariance'
            )
