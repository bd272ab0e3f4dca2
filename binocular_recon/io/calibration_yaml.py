# SPDX-License-Identifier: Apache-2.0
"""Camera files in the format of camera_calibration_parsers (ROS)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import yaml

from binocular_recon.camera import Camera, FloatArray, StereoRig
from binocular_recon.errors import CalibrationError, FileError
from binocular_recon.inputs.camera_reading import camera_of_image
from binocular_recon.io.calibration_json import read_covariance
from binocular_recon.io.files import complete_file

# K, D, R and P
_MATRICES = (
    'camera_matrix',
    'distortion_coefficients',
    'rectification_matrix',
    'projection_matrix',
)

# Subfolder that holds a new calibration until all its files have been moved to their places.
PENDING = '.calibration.new'


def read_camera(path: Path, *, rectified: bool = False) -> Camera:
    """Read a camera file; ``rectified`` as for `camera_of_image`.

    Raises
    ------
    FileError
        If the file cannot be read.
    CalibrationError
        If it is not a camera file or its camera is not calibrated; the message begins with the
        path.

    """
    try:
        content = yaml.safe_load(path.read_text())
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, 'strerror', None) or error
        raise FileError(f'{path} cannot be read: {reason}; give a camera file') from error
    except yaml.YAMLError as error:
        raise CalibrationError(f'{path} is not a camera file: {error}') from error
    try:
        # PyYAML reads numbers such as 1e-05 as text
        K, D, R, P = (np.array(content[name]['data'], np.float64) for name in _MATRICES)
        size = int(content['image_width']), int(content['image_height'])
        model = str(content.get('distortion_model') or '')
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise CalibrationError(
            f'{path} is not a camera file as camera_calibration_parsers writes it: {error!r}'
        ) from error
    try:
        return camera_of_image(size, K, D, R, P, model, rectified=rectified)
    except CalibrationError as error:
        raise CalibrationError(f'{path}: {error}') from error


def read_rig(folder: str | Path, *, rectified: bool = False) -> StereoRig:
    """Read ``left.yaml``, ``right.yaml`` and, if it is there, ``calibration.json`` of ``folder``.

    If saving a calibration was interrupted, its new files are read where they are. Of rectified
    images only P counts. Errors as in `read_camera` and `read_covariance`.
    """
    paths = [_newest(Path(folder), f'{side}.yaml') for side in ('left', 'right')]
    cameras = [read_camera(path, rectified=rectified) for path in paths]
    json = _newest(Path(folder), 'calibration.json')
    if any(camera.notices for camera in cameras) and rectified:  # K or D cannot be used
        return StereoRig(*cameras)
    covariance = read_covariance(json, *(read_camera(path) for path in paths))
    return StereoRig(*cameras, covariance=covariance)


def _newest(folder: Path, name: str) -> Path:
    """Return where a file of the newest calibration is."""
    pending = folder / PENDING / name
    return pending if pending.exists() else folder / name


def write_camera(path: Path, camera: Camera, name: str) -> None:
    """Write a camera file in full precision; raises a FileError if it cannot be written.

    Parameters
    ----------
    path : Path
        File; an old one stays as it is until the new one is complete.
    camera : Camera
        Calibrated camera.
    name : str
        Name of the camera; drivers compare it with their own.

    """
    content = {
        'image_width': camera.width,
        'image_height': camera.height,
        'camera_name': name,
        'camera_matrix': _matrix(camera.K),
        'distortion_model': camera.distortion_model,
        'distortion_coefficients': _matrix(camera.D[None]),
        'rectification_matrix': _matrix(camera.R),
        'projection_matrix': _matrix(camera.P),
    }
    text = yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=1000)
    with complete_file(path) as file:
        file.write(text.encode())


def write_rig(folder: Path, rig: StereoRig, names: tuple[str, str] = ('left', 'right')) -> None:
    """Write ``left.yaml`` and ``right.yaml`` to ``folder``, which must exist."""
    for side, camera, name in zip(('left', 'right'), (rig.left, rig.right), names, strict=True):
        write_camera(folder / f'{side}.yaml', camera, name)


def _matrix(values: FloatArray) -> dict[str, Any]:
    rows, columns = values.shape
    return {'rows': rows, 'cols': columns, 'data': [float(value) for value in values.ravel()]}
