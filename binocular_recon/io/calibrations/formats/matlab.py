# SPDX-License-Identifier: Apache-2.0
"""MATLAB's ``stereoParameters``, as a structure in a ``.mat`` or JSON file.

``s = toStruct(stereoParams)``, then ``save('rig.mat', 's', '-v7')`` or
``writelines(jsonencode(s), 'rig.json')``; also what ``stereoParametersToOpenCV`` returns.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from binocular_recon.camera import FloatArray
from binocular_recon.errors import CalibrationError
from binocular_recon.io.calibrations.format import CalibrationFormat
from binocular_recon.io.calibrations.formats._mat_file import read_mat
from binocular_recon.io.calibrations.raw_rig import Choice, RawCamera, RawRig
from binocular_recon.io.calibrations.source import SourceFile
from binocular_recon.io.calibrations.values import image_size, numbers, pose_of, turn_of

_SAVE = "save it with s = toStruct(stereoParams); save('rig.mat', 's', '-v7')"
_UNITS_M = {
    **dict.fromkeys(('mm', 'millimeter', 'millimeters', 'millimetres'), 1e-3),
    **dict.fromkeys(('cm', 'centimeter', 'centimeters', 'centimetres'), 1e-2),
    **dict.fromkeys(('m', 'meter', 'meters', 'metres'), 1.0),
    **dict.fromkeys(('in', 'inch', 'inches'), 0.0254),
    **dict.fromkeys(('ft', 'foot', 'feet'), 0.3048),
}
# The centre of the first pixel is (1, 1).
_FIRST_PX = 1.0
_MOST_DEPTH = 4


class MatlabFormat(CalibrationFormat):
    """Rotations and, before R2022b, intrinsics are transposed; pixels are counted from 1."""

    NAME = 'MATLAB'
    FILES = '.mat or .json of stereoParameters'

    def claims(self, file: SourceFile) -> bool:
        """Return whether a file is a .mat, or JSON of such a structure."""
        return file.name.lower().endswith('.mat') or _parameters(file.content) is not None

    def read(self, files: Sequence[SourceFile], choice: Choice) -> RawRig:
        """Read cameras 1 and 2."""
        del choice
        if len(files) > 1:
            raise CalibrationError(
                f'{files[0].path} and {files[1].name} are two files of MATLAB; give the one with'
                ' the stereoParameters'
            )
        (file,) = files
        content = _mat(file) if file.name.lower().endswith('.mat') else file.content
        found = _parameters(content)
        if found is None:
            names = [str(key) for key in content if not str(key).startswith('__')]
            raise CalibrationError(
                f'{file.path} holds no stereoParameters as a structure, only'
                f' {", ".join(names[:8]) or "nothing"}; {_SAVE}'
            )
        if 'CameraParameters1' in found:
            return self._of_structure(found, file)
        return self._of_opencv(found, file)

    def _of_structure(self, found: Mapping[str, Any], file: SourceFile) -> RawRig:
        where = str(file.path)
        if isinstance(found.get('PoseCamera2'), Mapping):  # since R2022b, not transposed
            tform = found['PoseCamera2']
            if 'A' in tform and 'R' not in tform:
                A = numbers(tform['A'], f'{where}: PoseCamera2.A', 16).reshape(4, 4)
                R, T = turn_of(A[:3, :3].tolist(), f'{where}: PoseCamera2.A'), A[:3, 3]
            else:
                R = turn_of(_need(tform, 'R', where), f'{where}: PoseCamera2.R')
                T = numbers(_need(tform, 'Translation', where), f'{where}: Translation', 3)
        else:
            R = turn_of(_need(found, 'RotationOfCamera2', where), f'{where}: RotationOfCamera2').T
            shift = _need(found, 'TranslationOfCamera2', where)
            T = numbers(shift, f'{where}: TranslationOfCamera2', 3)
        poses = np.eye(4), pose_of(R, T)
        cameras = [
            _camera(found.get(f'CameraParameters{index + 1}'), index, where, poses[index])
            for index in (0, 1)
        ]
        first = found['CameraParameters1']
        unit = str(found.get('WorldUnits') or first.get('WorldUnits') or '').strip().lower()
        if unit and unit not in _UNITS_M:
            raise CalibrationError(
                f'{where}: WorldUnits {unit[:30]!r} is not one of {", ".join(_UNITS_M)}; set one'
                ' of them'
            )
        notices = (f'lengths are in {unit}',) if unit else ()
        return RawRig(self.NAME, (file.path,), cameras, _SAVE, _UNITS_M.get(unit, 1.0), notices)

    def _of_opencv(self, found: Mapping[str, Any], file: SourceFile) -> RawRig:
        where = str(file.path)
        size = found.get('imageSize')
        R = turn_of(_need(found, 'rotationOfCamera2', where), f'{where}: rotationOfCamera2')
        shift = _need(found, 'translationOfCamera2', where)
        T = numbers(shift, f'{where}: translationOfCamera2', 3)
        poses = np.eye(4), pose_of(R, T)
        cameras = []
        for index in (0, 1):
            K_name, D_name = f'intrinsicMatrix{index + 1}', f'distortionCoefficients{index + 1}'
            cameras.append(
                RawCamera(
                    f'camera {index + 1}',
                    f'{where}: {K_name}',
                    None if size is None else _swapped_size(size, f'{where}: imageSize'),
                    numbers(_need(found, K_name, where), f'{where}: {K_name}', 9).reshape(3, 3),
                    numbers(_need(found, D_name, where), f'{where}: {D_name}', 4, 5),
                    pose=poses[index],
                )
            )
        return RawRig(self.NAME, (file.path,), cameras, _SAVE)


def _need(found: Mapping[str, Any], key: str, where: str) -> Any:
    if key not in found:
        raise CalibrationError(f'{where}: {key} is missing; {_SAVE}')
    return found[key]


def _parameters(content: Any, depth: int = 0) -> Mapping[str, Any] | None:
    """Return the structure with the cameras, which may lie in another one."""
    if not isinstance(content, Mapping) or depth > _MOST_DEPTH:
        return None
    if 'CameraParameters1' in content or 'rotationOfCamera2' in content:
        return content
    inner = (_parameters(value, depth + 1) for value in content.values())
    return next((found for found in inner if found is not None), None)


def _swapped_size(value: Any, where: str) -> tuple[int, int]:
    """Return width and height of MATLAB's rows and columns."""
    rows, columns = numbers(value, where, 2)
    return image_size([columns, rows], where)


def _camera(content: Any, index: int, where: str, pose: FloatArray) -> RawCamera:
    name = f'camera {index + 1}'
    where = f'{where}: CameraParameters{index + 1}'
    if not isinstance(content, Mapping):
        raise CalibrationError(f'{where} is missing, so there is one camera only; {_SAVE}')
    key = next((one for one in ('K', 'IntrinsicMatrix') if one in content), None)
    if key is None and isinstance(content.get('Intrinsics'), Mapping):
        content = {**content, **content['Intrinsics']}
        key = next((one for one in ('K', 'IntrinsicMatrix') if one in content), None)
    if key is None:
        raise CalibrationError(f'{where}: K (IntrinsicMatrix) is missing; {_SAVE}')
    K = numbers(content[key], f'{where}: {key}', 9).reshape(3, 3)
    if K[2, :2].any():  # transposed: points are rows
        K = K.T
    K = K - [[0, 0, _FIRST_PX], [0, 0, _FIRST_PX], [0, 0, 0]]
    radial = numbers(content.get('RadialDistortion', [0, 0]), f'{where}: RadialDistortion', 2, 3)
    tangential = numbers(
        content.get('TangentialDistortion', [0, 0]), f'{where}: TangentialDistortion', 2
    )
    size = content.get('ImageSize')
    empty = size is None or (isinstance(size, list | np.ndarray) and len(size) == 0)
    return RawCamera(
        name,
        where,
        None if empty else _swapped_size(size, f'{where}: ImageSize'),
        K,
        np.array([*radial[:2], *tangential, *radial[2:]]),
        pose=pose,
    )


def _mat(file: SourceFile) -> Any:
    """Return the variables of a .mat file as mappings."""
    if file.data.startswith(b'\x89HDF') or file.data.startswith(b'MATLAB 7.3 MAT-file'):
        raise CalibrationError(
            f'{file.path} is a MAT-file of version 7.3, which is not read; {_SAVE}'
        )
    try:
        return read_mat(file.data)
    except ValueError as error:
        raise CalibrationError(
            f'{file.path} is no MAT-file that can be read: {error}; {_SAVE}'
        ) from error
