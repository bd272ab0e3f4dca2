# SPDX-License-Identifier: Apache-2.0
"""Matrices of OpenCV's calibrations in its FileStorage (YAML, XML or JSON), under usual names.

``intrinsics.yml`` and ``extrinsics.yml`` of OpenCV's sample ``stereo_calib``, or one file with
all of them.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Sequence
from typing import Any

import numpy as np

from binocular_recon.camera import FloatArray
from binocular_recon.errors import CalibrationError
from binocular_recon.inputs.camera_checks import known_lens
from binocular_recon.io.calibrations.format import CalibrationFormat
from binocular_recon.io.calibrations.formats._opencv_size import size_of_rectification
from binocular_recon.io.calibrations.raw_rig import Choice, RawCamera, RawRig
from binocular_recon.io.calibrations.source import SourceFile
from binocular_recon.io.calibrations.values import image_size, numbers, pose_of, turn_of

_REMEDY = (
    'R and T of stereoCalibrate state it: give intrinsics and extrinsics, both files of the sample'
    ' stereo_calib'
)
# What matrices of camera # are called, in lower case without anything but letters and digits.
_NAMES = {
    'K': (
        'm#', 'k#', 'cameramatrix#', '#cameramatrix', 'intrinsicmatrix#', 'intrinsics#', '#k',
        'mtx#', '#mtx', 'cameramtx#', 'intrinsic#', '#intrinsic', '#intrinsics',
    ),
    'D': (
        'd#', 'distcoeffs#', '#distcoeffs', 'distortioncoefficients#', '#distortioncoefficients',
        'distortioncoeffs#', 'distcoeff#', 'dist#', 'distortion#', '#d', '#dist', '#distortion',
    ),
    'R': ('r#', 'rectificationmatrix#', 'rect#', '#r'),
    'P': ('p#', 'projectionmatrix#', 'proj#', '#p'),
}  # fmt: skip
_CAMERAS = (('1', 'left', 'l'), ('2', 'right', 'r'))
_POSE = {
    'R': ('r', 'rotation', 'rotationmatrix', 'stereor'),
    'T': ('t', 'translation', 'translationvector', 'stereot'),
}
_SIZES = ('imagesize', 'size', 'calibrationsize', 'resolution', 'imgsize')
_WIDTHS = ('imagewidth', 'width', 'leftwidth', 'camerawidth')
_HEIGHTS = ('imageheight', 'height', 'leftheight', 'cameraheight')
_SINGLE = ('cameramatrix', 'intrinsicmatrix')

# Name as written and value, by the plain name.
_Names = dict[str, tuple[str, Any]]


class OpenCVFormat(CalibrationFormat):
    """Cameras 1 and 2 with R and T, from the first to the second one, and R1, R2, P1, P2."""

    NAME = 'OpenCV'
    FILES = 'intrinsics.yml and extrinsics.yml, or one file with M1, D1, M2, D2, R, T'

    def claims(self, file: SourceFile) -> bool:
        """Return whether a file has matrices under one of the names."""
        names = _plain(file.content)
        single = any(name in names for name in _SINGLE)
        if {'cameraparameters1', 'projectionmatrix'} & set(names):  # MATLAB's and ROS's
            return False
        if 'rotationofcamera2' in names:  # MATLAB's too, with its order of the image size
            return False
        pose = all(any(name in names for name in known) for known in _POSE.values())
        return single or pose or any(_matrix(names, 'K', index) for index in (0, 1))

    def read(self, files: Sequence[SourceFile], choice: Choice) -> RawRig:
        """Read the cameras of all files together."""
        files = _with_extrinsics(files)
        paths = tuple(file.path for file in files)
        where = ', '.join(map(str, paths))
        names: _Names = {}
        for file in files:
            own = _plain(file.content)
            twice = sorted(set(own) & set(names) & _known())
            if twice:
                raise CalibrationError(
                    f'{where}: {names[twice[0]][0]} is in both files: they are of two'
                    f' calibrations, or of cameras calibrated alone, without a pose; {_REMEDY}'
                )
            names |= own
        if not any(_matrix(names, 'K', index) for index in (0, 1)):
            return _without_pair(self.NAME, files, names)
        size = _size(names, where)
        pose = _pose(names, where)
        cameras = [
            camera
            for index in (0, 1)
            if (camera := _camera(names, index, where, size, pose)) is not None
        ]
        if size is None and choice.image_size is None and len(cameras) == 2:
            size = size_of_rectification(*cameras)
        notices: tuple[str, ...] = ()
        if size is not None and cameras[0].size is None:
            cameras = [dataclasses.replace(camera, size=size) for camera in cameras]
            notices = (
                f'the image size {size[0]}x{size[1]} px is that which P1 and P2 were made for',
            )
        return RawRig(self.NAME, paths, cameras, _REMEDY, notices=notices)


def _known() -> set[str]:
    return {
        pattern.replace('#', mark)
        for patterns in _NAMES.values()
        for pattern in patterns
        for marks in _CAMERAS
        for mark in marks
    } | set(_SINGLE)


def _plain(content: Any) -> dict[str, tuple[str, Any]]:
    """Return names as written and values, by names in lower case, letters and digits only."""
    if not isinstance(content, dict):
        return {}
    return {
        re.sub('[^a-z0-9]', '', str(key).lower()): (str(key), value)
        for key, value in content.items()
        if value is not None
    }


def _matrix(names: _Names, kind: str, index: int) -> tuple[str, Any] | None:
    """Return name and value of a matrix of a camera."""
    for mark in _CAMERAS[index]:
        for pattern in _NAMES[kind]:
            name = pattern.replace('#', mark)
            if name in names:
                return names[name]
    return None


def _first(names: _Names, known: Sequence[str]) -> tuple[str, Any] | None:
    """Return name and value of the first of some names that is there."""
    return next((names[name] for name in known if name in names), None)


def _with_extrinsics(files: Sequence[SourceFile]) -> Sequence[SourceFile]:
    """Return the files, of the sample's two both though one was given."""
    if len(files) != 1:
        return files
    path = files[0].path
    for one, other in (('intrinsic', 'extrinsic'), ('extrinsic', 'intrinsic')):
        beside = path.with_name(path.name.replace(one, other))
        if one in path.name and beside.is_file():
            return [*files, SourceFile(beside)]
    return files


def _without_pair(name: str, files: Sequence[SourceFile], names: _Names) -> RawRig:
    """Raise a CalibrationError about what is missing of cameras 1 and 2."""
    found = _first(names, _SINGLE)
    if found is None:
        content = [name for name, _ in names.values()]
        raise CalibrationError(
            f'{files[0].path} holds the pose only; the cameras are missing (M1, D1, M2, D2 of'
            f' intrinsics.yml) or have other names (it has {", ".join(content[:12])}): give'
            ' both files, or name the matrices so'
        )
    where = str(files[0].path)
    K = numbers(found[1], f'{where}: {found[0]}', 9).reshape(3, 3)
    camera = RawCamera(files[0].path.stem, where, None, K, np.zeros(0))
    return RawRig(name, (files[0].path,), [camera], _REMEDY)


def _size(names: _Names, where: str) -> tuple[int, int] | None:
    found = _first(names, _SIZES)
    if found is not None:
        name, value = found
        if isinstance(value, dict) and {'width', 'height'} <= set(value):
            value = [value['width'], value['height']]
        return image_size(value, f'{where}: {name}')
    width, height = _first(names, _WIDTHS), _first(names, _HEIGHTS)
    if width is None or height is None:
        return None
    return image_size([width[1], height[1]], f'{where}: {width[0]}, {height[0]}')


def _pose(names: _Names, where: str) -> FloatArray | None:
    turn, shift = (_first(names, known) for known in _POSE.values())
    if turn is None or shift is None:
        return None
    R = turn_of(turn[1], f'{where}: {turn[0]}')
    return pose_of(R, numbers(shift[1], f'{where}: {shift[0]}', 3))


def _camera(
    names: _Names,
    index: int,
    where: str,
    size: tuple[int, int] | None,
    pose: FloatArray | None,
) -> RawCamera | None:
    found = _matrix(names, 'K', index)
    if found is None:
        return None
    name, value = found
    K = numbers(value, f'{where}: {name}', 9).reshape(3, 3)
    D_name, D_value = _matrix(names, 'D', index) or ('D', [])
    D = numbers(D_value, f'{where}: {D_name}')
    _, fisheye = _first(names, ('fisheyemodel', 'fisheye')) or ('', 0)
    _, model = _first(names, ('distortionmodel',)) or ('', '')
    if str(fisheye).lower() in ('1', 'true'):
        model = 'equidistant'
    try:
        lens, D, _ = known_lens(
            model or ('plumb_bob' if D.size <= 5 else 'rational_polynomial'), D
        )
    except CalibrationError as error:
        raise CalibrationError(f'{where}: {D_name}: {error}') from error
    rectification = [
        numbers(one[1], f'{where}: {one[0]}', count).reshape(3, -1)
        if (one := _matrix(names, kind, index)) is not None
        else None
        for kind, count in (('R', 9), ('P', 12))
    ]
    sides = [side for side in ('left', 'right') if side in name.lower()]
    poses = (None, None) if pose is None else (np.eye(4), pose)
    return RawCamera(
        sides[0] if sides else f'camera {index + 1}',
        f'{where}: {name}',
        size,
        K,
        D,
        lens,
        poses[index],
        sides[0] if sides else '',
        *rectification,
    )
