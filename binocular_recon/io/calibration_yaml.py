# SPDX-License-Identifier: Apache-2.0
"""Camera files in the format of camera_calibration_parsers (ROS), and rigs in any format."""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from binocular_recon.camera import Camera, FloatArray, StereoRig
from binocular_recon.errors import BinocularReconError, CalibrationError, FileError
from binocular_recon.inputs.camera_reading import camera_of_image
from binocular_recon.io.calibration_json import read_covariance
from binocular_recon.io.calibrations.formats.ros import camera_values
from binocular_recon.io.calibrations.registry import formats_text, read_calibration
from binocular_recon.io.calibrations.source import SourceFile
from binocular_recon.io.files import complete_file

# Key of what left and right have in common, so that those of two calibrations are not mixed.
_ID = 'calibration_id'
# Subfolder that holds a new calibration until all its files have been moved to their places.
PENDING = '.calibration.new'
# How often a calibration is read that is replaced meanwhile, before savers are made to wait.
_TRIES = 5


@contextlib.contextmanager
def locked(folder: Path, *, shared: bool = False) -> Iterator[None]:
    """Wait for the lock of a folder and hold it; nothing where its file system has no locks.

    Other processes and threads that lock the folder wait meanwhile, those that share it only for
    one that does not. The lock of a process that dies is free.
    """
    try:
        handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    except OSError:  # it is not a folder, or one that cannot be opened
        yield
        return
    try:
        with contextlib.suppress(OSError):  # a network file system without locks
            fcntl.flock(handle, fcntl.LOCK_SH if shared else fcntl.LOCK_EX)
        yield
    finally:
        os.close(handle)


def read_camera(path: Path, *, rectified: bool = False) -> Camera:
    """Read a camera file, also in OpenCV's notation; ``rectified`` as for `camera_of_image`.

    Raises
    ------
    FileError
        If the file cannot be read.
    CalibrationError
        If it is not a camera file or its camera is not calibrated; the message begins with the
        path.

    """
    return _camera(SourceFile(path), rectified=rectified)


def _camera(file: SourceFile, *, rectified: bool = False) -> Camera:
    values = camera_values(file.content, file.path)
    try:
        return camera_of_image(*values, rectified=rectified)
    except CalibrationError as error:
        raise CalibrationError(f'{file.path}: {error}') from error


def read_rig(path: str | Path, *, rectified: bool = False) -> StereoRig:
    """Read the calibration of a rig: a folder that `write_rig` wrote, or of another program.

    Parameters
    ----------
    path : str or Path
        Folder with ``left.yaml``, ``right.yaml`` and, if it is there, ``calibration.json``; or a
        file or folder in another format (`calibrations.FORMATS`). If saving a calibration was
        interrupted, its new files are read where they are.
    rectified : bool
        Whether the images are rectified; only P counts then.

    Raises
    ------
    FileError
        If a file is missing or cannot be read.
    CalibrationError
        If the files are not those of a rig.

    """
    folder = Path(path)
    # Without a lock: readers that take turns would never let one save.
    for _ in range(_TRIES):
        before = _state(folder)
        try:
            rig = _read(folder, rectified=rectified)
        except BinocularReconError:
            if _state(folder) == before:
                raise
        else:
            if _state(folder) == before:
                return rig
    with locked(folder, shared=True):
        return _read(folder, rectified=rectified)


def _state(folder: Path) -> list[tuple[Path, int, int]]:
    """Return which files the newest calibration has: a replaced one has another inode."""
    found = []
    for name in ('left.yaml', 'right.yaml', 'calibration.json'):
        path = _newest(folder, name)
        with contextlib.suppress(OSError, ValueError):
            status = path.stat()
            found.append((path, status.st_ino, status.st_mtime_ns))
    return found


def _read(folder: Path, *, rectified: bool) -> StereoRig:
    paths = [_newest(folder, f'{side}.yaml') for side in ('left', 'right')]
    if any(one.exists() for one in paths):
        return _own_rig(folder, paths, rectified=rectified)
    return _foreign_rig(folder, rectified=rectified)


def _own_rig(folder: Path, paths: list[Path], *, rectified: bool) -> StereoRig:
    files = [SourceFile(path) for path in paths]
    cameras = [_camera(file, rectified=rectified) for file in files]
    left, right = (file.content.get(_ID, 'none') for file in files)
    if left != right:
        raise CalibrationError(
            f'{paths[0]} and {paths[1].name} are of two calibrations ({_ID} {left} and {right});'
            f' keep the files of one together, or delete both lines {_ID} if they belong together'
        )
    json = _newest(folder, 'calibration.json')
    if any(camera.notices for camera in cameras) and rectified:  # K or D cannot be used
        return StereoRig(*cameras)
    covariance = read_covariance(json, *(_camera(file) for file in files))
    return StereoRig(*cameras, covariance=covariance)


def _foreign_rig(path: Path, *, rectified: bool) -> StereoRig:
    empty = path.is_dir() and not any(path.iterdir())
    if empty or not path.exists():
        missing = path if path.suffix else path / 'left.yaml'
        raise FileError(
            f'{missing} cannot be read: No such file or directory; give a folder with left.yaml'
            f' and right.yaml, or the calibration of another program: {formats_text()}'
        )
    return read_calibration([path], rectified=rectified).rig


def _newest(folder: Path, name: str) -> Path:
    """Return where a file of the newest calibration is."""
    pending = folder / PENDING
    # left.yaml is the first to take its place
    newer = (pending / 'left.yaml').exists() or (pending / name).exists()
    return pending / name if newer else folder / name


def write_camera(path: Path, camera: Camera, name: str, calibration_id: str = '') -> None:
    """Write a camera file in full precision; raises a FileError if it cannot be written.

    Parameters
    ----------
    path : Path
        File; an old one stays as it is until the new one is complete.
    camera : Camera
        Calibrated camera.
    name : str
        Name of the camera; drivers compare it with their own.
    calibration_id : str
        What the files of both cameras have in common; it is not written if it is empty.

    """
    content: dict[str, Any] = {
        'image_width': camera.width,
        'image_height': camera.height,
        'camera_name': name,
        'camera_matrix': _matrix(camera.K),
        'distortion_model': camera.distortion_model,
        'distortion_coefficients': _matrix(camera.D[None]),
        'rectification_matrix': _matrix(camera.R),
        'projection_matrix': _matrix(camera.P),
    }
    if calibration_id:
        content[_ID] = calibration_id
    text = yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=1000)
    with complete_file(path) as file:
        file.write(text.encode())


def write_rig(folder: Path, rig: StereoRig, names: tuple[str, str] = ('left', 'right')) -> None:
    """Write ``left.yaml`` and ``right.yaml`` to ``folder``, which must exist."""
    digest = hashlib.sha256()
    for camera in (rig.left, rig.right):
        for values in (camera.K, camera.D, camera.R, camera.P):
            digest.update(np.ascontiguousarray(values, '<f8').tobytes())
    common = digest.hexdigest()[:16]
    for side, camera, name in zip(('left', 'right'), (rig.left, rig.right), names, strict=True):
        write_camera(folder / f'{side}.yaml', camera, name, common)


def _matrix(values: FloatArray) -> dict[str, Any]:
    rows, columns = values.shape
    return {'rows': rows, 'cols': columns, 'data': [float(value) for value in values.ravel()]}
