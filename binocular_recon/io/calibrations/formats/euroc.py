# SPDX-License-Identifier: Apache-2.0
"""``sensor.yaml`` of the cameras of a EuRoC data set (ASL dataset format)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from binocular_recon.errors import CalibrationError
from binocular_recon.io.calibrations.format import CalibrationFormat
from binocular_recon.io.calibrations.raw_rig import Choice, RawCamera, RawRig, wanted
from binocular_recon.io.calibrations.source import SourceFile
from binocular_recon.io.calibrations.values import (
    entry,
    image_size,
    inverse,
    matrix_of,
    numbers,
    side_of,
    transformation,
)

_WHOLE = 'take the sensor.yaml of the data set as published'
_LENSES = {
    'radial-tangential': 'plumb_bob',
    'radtan': 'plumb_bob',
    'plumb_bob': 'plumb_bob',
    'equidistant': 'equidistant',
    'none': 'plumb_bob',
}


class EurocFormat(CalibrationFormat):
    """One file per camera; ``T_BS`` takes points from the sensor to the body."""

    NAME = 'EuRoC'
    FILES = 'cam0/sensor.yaml, cam1/sensor.yaml'

    def claims(self, file: SourceFile) -> bool:
        """Return whether a file is that of a camera; those of other sensors are not."""
        content = file.content
        if not isinstance(content, dict):
            return False
        camera = 'intrinsics' in content or content.get('sensor_type') == 'camera'
        return camera and bool({'T_BS', 'sensor_type'} & set(content))

    def read(self, files: Sequence[SourceFile], choice: Choice) -> RawRig:
        """Read the cameras; each has the name of its folder."""
        names = [_name(file) for file in files]
        chosen = wanted(names, choice)
        cameras = [
            _camera(file) for file, name in zip(files, names, strict=True) if name in chosen
        ]
        paths = tuple(file.path for file in files)
        no_pose = 'give the sensor.yaml of both cameras, each with its T_BS'
        return RawRig(self.NAME, paths, cameras, no_pose, names=tuple(names))


def _name(file: SourceFile) -> str:
    """Return the name of a camera: that of its folder."""
    return file.path.resolve().parent.name if file.name == 'sensor.yaml' else file.path.stem


def _camera(file: SourceFile) -> RawCamera:
    content, where = file.content, str(file.path)
    name = _name(file)
    model = str(content.get('camera_model', 'pinhole'))
    known = {'distortion_coefficients', 'distortion_model'} & set(content)
    kind = str(entry(content, 'distortion_model', where, _WHOLE)) if known else 'none'
    if model != 'pinhole' or kind not in _LENSES:
        raise CalibrationError(
            f'{where}: the camera model {model!r} with distortion model {kind!r} is not read, only'
            f' pinhole with {", ".join(_LENSES)}; calibrate the camera with one of these'
        )
    values = numbers(entry(content, 'intrinsics', where, _WHOLE), f'{where}: intrinsics', 4)
    D = numbers(content.get('distortion_coefficients') or [], f'{where}: distortion_coefficients')
    pose = content.get('T_BS')
    size = content.get('resolution')
    return RawCamera(
        name,
        where,
        None if size is None else image_size(size, f'{where}: resolution'),
        matrix_of(*values),
        np.zeros(0) if kind == 'none' else D,
        _LENSES[kind],
        None if pose is None else inverse(transformation(pose, f'{where}: T_BS')),
        side_of(name),
    )
