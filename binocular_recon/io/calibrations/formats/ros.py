# SPDX-License-Identifier: Apache-2.0
"""Camera files of ROS (camera_calibration_parsers), one per camera, also in OpenCV's notation."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from binocular_recon.camera import FloatArray
from binocular_recon.errors import CalibrationError
from binocular_recon.inputs.camera_checks import known_lens
from binocular_recon.io.calibrations.format import CalibrationFormat
from binocular_recon.io.calibrations.raw_rig import Choice, RawCamera, RawRig
from binocular_recon.io.calibrations.source import SourceFile
from binocular_recon.io.calibrations.values import numbers, side_of
from binocular_recon.io.text_files import whole_number

# K, D, R and P
_MATRICES = (
    'camera_matrix',
    'distortion_coefficients',
    'rectification_matrix',
    'projection_matrix',
)
_SIZE = ('image_width', 'image_height')
# The same in a CameraInfo as `ros2 topic echo` (and `rostopic echo`, in capitals) prints it.
_MESSAGE = dict(zip('kdrp', _MATRICES, strict=True))


class RosFormat(CalibrationFormat):
    """One file per camera; the pose is that of R and P."""

    NAME = 'ROS camera info'
    FILES = 'left.yaml, right.yaml'

    def claims(self, file: SourceFile) -> bool:
        """Return whether a file has the matrices of a camera info."""
        return set(_MATRICES) <= set(_entries(file.content, file.path))

    def read(self, files: Sequence[SourceFile], choice: Choice) -> RawRig:
        """Read the cameras; each has the name of its file."""
        del choice
        cameras = [_camera(file) for file in files]
        paths = tuple(file.path for file in files)
        return RawRig(self.NAME, paths, cameras, 'give both files, or the folder that holds them')


def camera_values(
    content: Any, path: Path
) -> tuple[tuple[int, int], FloatArray, FloatArray, FloatArray, FloatArray, str]:
    """Return size, K, D, R, P and distortion model of a camera file's content.

    Raises
    ------
    CalibrationError
        If one is missing or has other values than numbers; the message begins with the path.

    """
    entries = _entries(content, path)
    missing = [name for name in (*_MATRICES, *_SIZE) if name not in entries]
    missing += [
        f'data of {name}'
        for name in _MATRICES
        if name in entries and not (isinstance(entries[name], dict) and 'data' in entries[name])
    ]
    if missing:
        raise CalibrationError(
            f'{path} is not a camera file as camera_calibration_parsers writes it: it lacks'
            f' {", ".join(missing)}; write it again with the calibration'
        )
    data = [entries[name]['data'] for name in _MATRICES]
    width, height = (
        whole_number(f'{path}: {name}', entries[name], CalibrationError) for name in _SIZE
    )
    size = width, height
    model = str(entries.get('distortion_model') or '')
    K, D, R, P = (
        numbers(values, f'{path} is not a camera file because {name}')
        for name, values in zip(_MATRICES, data, strict=True)
    )
    return size, K, D, R, P, model


def _entries(content: Any, path: Path) -> dict[Any, Any]:
    """Return the entries of a camera file, also of a CameraInfo that was printed."""
    if not isinstance(content, dict):
        return {}
    members = {str(key).lower(): value for key, value in content.items()}
    if 'camera_matrix' in content or not {*_MESSAGE, 'width', 'height'} <= set(members):
        return content
    region = members.get('roi')
    cut = isinstance(region, dict) and region.get('width')
    if cut or any(members.get(f'binning_{axis}') not in (None, 0, 1) for axis in 'xy'):
        raise CalibrationError(
            f'{path} states binning or a region of interest, which camera files have not; record'
            ' the camera info with the images in a bag, or print it at full size'
        )
    matrices = {name: {'data': members[key]} for key, name in _MESSAGE.items()}
    sizes = {name: members[name.removeprefix('image_')] for name in _SIZE}
    return {**matrices, **sizes, 'distortion_model': members.get('distortion_model')}


def _camera(file: SourceFile) -> RawCamera:
    size, K, D, R, P, model = camera_values(file.content, file.path)
    where = str(file.path)
    try:
        lens, D, _ = known_lens(model, D)
    except CalibrationError as error:
        raise CalibrationError(f'{where}: {error}') from error
    for name, values, count in (('K', K, 9), ('R', R, 9), ('P', P, 12)):
        if values.size != count:
            raise CalibrationError(
                f'{where}: {name} must have {count} values, got {values.size}; check the file'
            )
    return RawCamera(
        file.path.stem,
        where,
        size,
        K.reshape(3, 3),
        D,
        lens,
        side=side_of(file.path.stem) or side_of(str(file.content.get('camera_name', ''))),
        R=R.reshape(3, 3),
        P=P.reshape(3, 4),
    )
