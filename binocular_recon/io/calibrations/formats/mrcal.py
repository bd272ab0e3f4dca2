# SPDX-License-Identifier: Apache-2.0
"""mrcal's ``.cameramodel`` (mrcal.secretsauce.net/cameramodels.html)."""

from __future__ import annotations

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
    matrix_of,
    numbers,
    pose_of,
    side_of,
)
from binocular_recon.rotations import rotation

# Lens of OpenCV's models by their number of coefficients.
_LENSES = {0: 'plumb_bob', 4: 'plumb_bob', 5: 'plumb_bob', 8: 'rational_polynomial'}
_LENSES |= {12: 'rational_polynomial'}
_AGAIN = 'write the model again with mrcal'


class MrcalFormat(CalibrationFormat):
    """One file per camera; ``rt_cam_ref`` takes points from the reference to the camera."""

    NAME = 'mrcal'
    FILES = 'two .cameramodel'

    def claims(self, file: SourceFile) -> bool:
        """Return whether a file is a camera model, of CAHVOR too."""
        if file.name.lower().endswith(('.cahvor', '.cahvore')):
            return True
        return isinstance(file.content, dict) and _old(file.content)[0] is not None

    def read(self, files: Sequence[SourceFile], choice: Choice) -> RawRig:
        """Read the cameras; each has the name of its file."""
        names = [file.path.stem for file in files]
        chosen = wanted(names, choice)
        cameras = [
            _camera(file) for file, name in zip(files, names, strict=True) if name in chosen
        ]
        if len(cameras) > 1 and all(
            camera.pose is not None and np.array_equal(camera.pose, np.eye(4))
            for camera in cameras
        ):
            raise CalibrationError(
                f'{cameras[0].where} and {files[1].name}: both have rt_cam_ref 0, so their pose is'
                ' missing; calibrate the cameras together with mrcal-calibrate-cameras'
            )
        paths = tuple(file.path for file in files)
        return RawRig(
            self.NAME, paths, cameras, 'give both models; rt_cam_ref states it', names=tuple(names)
        )


def _old(content: dict[Any, Any]) -> tuple[Any, Any]:
    """Return lens model and pose under their names of any version."""
    models = ('lensmodel', 'lens_model', 'distortion_model')
    model = next((content[key] for key in models if key in content), None)
    if not isinstance(model, str) or not re.match('LENSMODEL_|DISTORTION_', model):
        return None, None
    poses = ('rt_cam_ref', 'extrinsics')
    return model, next((content[key] for key in poses if content.get(key) is not None), None)


def _camera(file: SourceFile) -> RawCamera:
    where = str(file.path)
    if file.name.lower().endswith(('.cahvor', '.cahvore')):
        raise CalibrationError(
            f'{where}: CAHVOR models are not read; convert it with mrcal-to-cameramodel and'
            ' mrcal-convert-lensmodel LENSMODEL_OPENCV8'
        )
    content = file.content
    model, pose = _old(content)
    name = re.sub('^(LENSMODEL|DISTORTION)_', '', model)
    found = re.fullmatch(r'OPENCV(\d{1,2})', name)
    count = int(found[1]) if found else 0 if name in ('PINHOLE', 'NONE') else -1
    if count not in _LENSES:
        raise CalibrationError(
            f'{where}: the lens model {model[:60]} is not read, only LENSMODEL_PINHOLE and'
            ' LENSMODEL_OPENCV4, 5, 8 and 12; convert it with'
            f' mrcal-convert-lensmodel LENSMODEL_OPENCV8 {file.name} or calibrate with it'
        )
    values = numbers(
        entry(content, 'intrinsics', where, _AGAIN), f'{where}: intrinsics of {name}', 4 + count
    )
    size = content.get('imagersize')
    return RawCamera(
        file.path.stem,
        where,
        None if size is None else image_size(size, f'{where}: imagersize'),
        matrix_of(*values[:4]),
        values[4:],
        _LENSES[count],
        None if pose is None else _pose(pose, f'{where}: rt_cam_ref'),
        side_of(file.path.stem),
    )


def _pose(value: Any, where: str) -> FloatArray:
    values = numbers(value, where, 6)
    return pose_of(rotation(values[:3]), values[3:])
