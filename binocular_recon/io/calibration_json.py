# SPDX-License-Identifier: Apache-2.0
"""The covariance of a calibration in ``calibration.json``, which camera files cannot hold.

``parameters`` names the p parameters in order, ``covariance`` has p rows of p numbers (px, rad,
m); parameters that were not estimated have rows and columns of 0.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from binocular_recon.camera import Camera, RigCovariance
from binocular_recon.errors import CalibrationError, FileError


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
        If the file cannot be read.
    CalibrationError
        If it is not a calibration, or that of other cameras; the message begins with the path.

    """
    try:
        content: Any = json.loads(path.read_text(encoding='utf-8'))
    except FileNotFoundError:
        return None
    except (ValueError, RecursionError) as error:
        raise CalibrationError(
            f'{path} is not a calibration: {error}; calibrate again, or delete it to go on without'
            ' the covariance'
        ) from error
    except OSError as error:
        raise FileError(f'{path} cannot be read: {error.strerror or error}') from error
    if not isinstance(content, dict) or 'covariance' not in content:
        return None
    try:
        _check_cameras(content, left, right)
        parameters = tuple(str(name) for name in content['parameters'])
        matrix = np.array(content['covariance'], np.float64)
        return RigCovariance(left, right, parameters, matrix)
    except CalibrationError as error:  # a ValueError too
        raise CalibrationError(f'{path}: {error}') from error
    except (KeyError, TypeError, ValueError) as error:
        raise CalibrationError(
            f'{path} is not a calibration as `calibrate` writes it: {error!r}'
        ) from error


def _check_cameras(content: dict[str, Any], left: Camera, right: Camera) -> None:
    """Raise a CalibrationError unless the file states the cameras of the camera files."""
    for side, camera in (('left', left), ('right', right)):
        K = np.array(content[side]['K'], np.float64)
        D = np.array(content[side]['D'], np.float64)
        same = K.shape == camera.K.shape and D.shape == camera.D.shape
        if not same or not (np.allclose(K, camera.K) and np.allclose(D, camera.D)):
            raise CalibrationError(
                f'the {side} camera is not that of {side}.yaml (fx {K.flat[0]:g} px there'
                f' {camera.K[0, 0]:g} px); keep the files of one calibration together, or delete'
                ' calibration.json to go on without the covariance'
            )
