# SPDX-License-Identifier: Apache-2.0
"""Kalibr's camchain yaml (github.com/ethz-asl/kalibr, wiki page "yaml formats")."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Sequence
from typing import Any

import numpy as np

from binocular_recon.camera import FloatArray
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

_AGAIN = 'calibrate both cameras together with kalibr_calibrate_cameras'
# Lens and number of coefficients of each distortion model.
_LENSES = {
    'radtan': ('plumb_bob', 4),
    'plumb_bob': ('plumb_bob', 4),
    'equi': ('equidistant', 4),
    'equidistant': ('equidistant', 4),
    'none': ('plumb_bob', 0),
}


class KalibrFormat(CalibrationFormat):
    """Cameras ``cam0``, ``cam1``, ...; ``T_cn_cnm1`` takes points from the camera before."""

    NAME = 'Kalibr'
    FILES = 'camchain.yaml'

    def claims(self, file: SourceFile) -> bool:
        """Return whether a file has cameras named like ``cam0``."""
        return bool(_names(file.content))

    def read(self, files: Sequence[SourceFile], choice: Choice) -> RawRig:
        """Read all cameras of the chain; poses are those from ``cam0``."""
        if len(files) > 1:
            raise CalibrationError(
                f'{files[0].path} and {files[1].name} are two calibrations of Kalibr; give one'
            )
        (file,) = files
        names = _names(file.content)
        chosen = wanted(names, choice)
        pose: FloatArray | None = np.eye(4)
        cameras = []
        for index, name in enumerate(names):
            content, where = file.content[name], f'{file.path}: {name}'
            if index:
                pose = _next(pose, content, where)
            if name in chosen:
                cameras.append(_camera(name, content, where, pose))
        if any(camera.pose is None for camera in cameras):
            cameras = _by_imu(file, cameras)
        no_pose = f'T_cn_cnm1 of the second camera states it; {_AGAIN}'
        return RawRig(self.NAME, (file.path,), cameras, no_pose, names=tuple(names))


def _names(content: Any) -> list[str]:
    if not isinstance(content, dict):
        return []
    names = [
        key
        for key, value in content.items()
        if isinstance(key, str)
        and re.fullmatch(r'cam\d{1,4}', key)
        and isinstance(value, dict)
        and {'intrinsics', 'camera_model', 'distortion_coeffs', 'T_cn_cnm1'} & set(value)
    ]
    return sorted(names, key=lambda name: int(name[3:]))


def _next(pose: FloatArray | None, content: Any, where: str) -> FloatArray | None:
    if content.get('T_cn_cnm1') is None:
        return None
    step = transformation(content['T_cn_cnm1'], f'{where}: T_cn_cnm1')
    return None if pose is None else step @ pose


def _by_imu(file: SourceFile, cameras: list[RawCamera]) -> list[RawCamera]:
    """Return the cameras with the poses from the IMU, where all have one."""
    posed = []
    for camera in cameras:
        content, where = file.content[camera.name], camera.where
        if content.get('T_cam_imu') is not None:
            pose = transformation(content['T_cam_imu'], f'{where}: T_cam_imu')
        elif content.get('T_imu_cam') is not None:  # as OpenVINS states it
            pose = inverse(transformation(content['T_imu_cam'], f'{where}: T_imu_cam'))
        else:
            return cameras
        posed.append(dataclasses.replace(camera, pose=pose))
    return posed


def _camera(name: str, content: Any, where: str, pose: FloatArray | None) -> RawCamera:
    model = str(content.get('camera_model', 'pinhole'))
    if model != 'pinhole':
        raise CalibrationError(
            f'{where}: the camera model {model!r} is not read, only pinhole with radtan or equi;'
            ' calibrate with --models pinhole-equi for a wide lens'
        )
    known = 'distortion_coeffs' in content or 'distortion_model' in content
    kind = str(entry(content, 'distortion_model', where, _AGAIN)) if known else 'none'
    if kind not in _LENSES:
        raise CalibrationError(
            f'{where}: the distortion model {kind!r} is not read, only {", ".join(_LENSES)};'
            ' calibrate with --models pinhole-radtan, or pinhole-equi for a wide lens'
        )
    lens, count = _LENSES[kind]
    K = matrix_of(*numbers(entry(content, 'intrinsics', where, _AGAIN), f'{where}: intrinsics', 4))
    coefficients = (
        numbers(
            entry(content, 'distortion_coeffs', where, _AGAIN),
            f'{where}: distortion_coeffs',
            count,
        )
        if count
        else np.zeros(0)
    )
    size = content.get('resolution')
    return RawCamera(
        name,
        where,
        None if size is None else image_size(size, f'{where}: resolution'),
        K,
        coefficients,
        lens,
        pose,
        side_of(str(content.get('rostopic', ''))),
    )
