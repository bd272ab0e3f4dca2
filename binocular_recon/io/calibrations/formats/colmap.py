# SPDX-License-Identifier: Apache-2.0
"""COLMAP's ``cameras.txt`` and ``images.txt`` (colmap.github.io/format.html)."""

from __future__ import annotations

import dataclasses
import io
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from binocular_recon.camera import FloatArray
from binocular_recon.errors import CalibrationError, FileError
from binocular_recon.io.calibrations.format import CalibrationFormat
from binocular_recon.io.calibrations.raw_rig import Choice, RawCamera, RawRig, wanted
from binocular_recon.io.calibrations.source import MOST_BYTES, SourceFile
from binocular_recon.io.calibrations.values import (
    frame_of,
    image_size,
    inverse,
    matrix_of,
    numbers,
    pose_of,
    side_of,
)
from binocular_recon.io.text_files import open_file
from binocular_recon.number_text import counted

# Lens, and where its parameters are, of each model: focal lengths, then the coefficients of D in
# the order of the lens; cx and cy follow the focal lengths.
_MODELS = {
    'SIMPLE_PINHOLE': ('plumb_bob', 1, 0),
    'PINHOLE': ('plumb_bob', 2, 0),
    'SIMPLE_RADIAL': ('plumb_bob', 1, 1),
    'RADIAL': ('plumb_bob', 1, 2),
    'OPENCV': ('plumb_bob', 2, 4),
    'FULL_OPENCV': ('rational_polynomial', 2, 8),
    'OPENCV_FISHEYE': ('equidistant', 2, 4),
    'SIMPLE_RADIAL_FISHEYE': ('equidistant', 1, 1),
    'RADIAL_FISHEYE': ('equidistant', 1, 2),
}
_LINE = re.compile(r'\s*\d+\s+([A-Z_]+)\s+\d+\s+\d+\s')
# The centre of the first pixel is (0.5, 0.5).
_CENTRE_PX = 0.5
_MOST_LINE, _MOST_IMAGES = 1 << 20, 100_000
# Poses of the rig in several frames may differ by this share of the baseline.
_SPREAD = 0.05
_NO_POSE = (
    'images.txt of the same model, beside cameras.txt, states the poses, if both cameras took'
    ' images of the same frames; each camera needs a number of its own'
    ' (--ImageReader.single_camera_per_folder 1)'
)


class _Image(NamedTuple):
    name: str
    camera: int
    pose: FloatArray


class ColmapFormat(CalibrationFormat):
    """Cameras of ``cameras.txt``, poses from the world to the images of ``images.txt``."""

    NAME = 'COLMAP'
    FILES = 'cameras.txt, images.txt'

    def claims(self, file: SourceFile) -> bool:
        """Return whether a file lists cameras or images, as text or binary."""
        if file.name in ('cameras.bin', 'images.bin'):
            return True
        if not file.name.lower().endswith('.txt'):
            return False
        begin = file.head.decode('utf-8', 'replace')
        named = file.name.lower().endswith('cameras.txt')
        return (
            named
            or _is_images(file)
            or any(
                line.startswith('# Camera list') or _LINE.match(line)
                for line in begin.split('\n')[:8]
            )
        )

    def read(self, files: Sequence[SourceFile], choice: Choice) -> RawRig:
        """Read the cameras; each has the name of its number, as ``1``."""
        texts = [file for file in files if not file.name.endswith('.bin')]
        if not texts:
            raise CalibrationError(
                f'{files[0].path}: binary models are not read; convert it with colmap'
                ' model_converter --output_type TXT'
            )
        lists = [file for file in texts if not _is_images(file)]
        images = [file for file in texts if _is_images(file)]
        if len(lists) != 1 or len(images) > 1:
            raise CalibrationError(
                f'{files[0].path}: one cameras.txt and at most one images.txt make a calibration,'
                f' got {len(lists)} and {len(images)}; give those of one model'
            )
        rows = _rows(lists[0])
        chosen = wanted(list(rows), choice)
        cameras = [_camera(name, *row) for name, row in rows.items() if name in chosen]
        paths = [lists[0].path]
        beside = lists[0].path.with_name(lists[0].name.replace('cameras', 'images'))
        if not images and beside != lists[0].path and beside.is_file():
            images = [SourceFile(beside)]
        notices: tuple[str, ...] = ()
        if images:
            paths.append(images[0].path)
            cameras, notices = _posed(cameras, list(_images(images[0].path)), choice)
        return RawRig(
            self.NAME, tuple(paths), cameras, _NO_POSE, notices=notices, names=tuple(rows)
        )


def _is_images(file: SourceFile) -> bool:
    begin = file.head.decode('utf-8', 'replace')
    return file.name.lower().endswith('images.txt') or begin.startswith('# Image list')


def _rows(file: SourceFile) -> dict[str, tuple[str, list[str]]]:
    """Return place and words of the line of each camera, by its number."""
    rows: dict[str, tuple[str, list[str]]] = {}
    for count, line in enumerate(file.text.splitlines(), 1):
        words = line.split()
        if not words or words[0].startswith('#'):
            continue
        where = f'{file.path}: line {count}'
        if len(words) < 4:
            raise CalibrationError(
                f'{where} must have CAMERA_ID, MODEL, WIDTH, HEIGHT and parameters, got'
                f' {line[:60]!r}; the file is cut off or no cameras.txt, export it again'
            )
        if words[0] in rows:
            raise CalibrationError(f'{where}: camera {words[0]} is there twice; export it again')
        rows[words[0]] = where, words
    return rows


def _camera(name: str, where: str, words: list[str]) -> RawCamera:
    model = words[1]
    if model not in _MODELS:
        raise CalibrationError(
            f'{where}: the camera model {model[:40]!r} is not read, only {", ".join(_MODELS)};'
            ' reconstruct with --ImageReader.camera_model OPENCV'
        )
    lens, focals, count_D = _MODELS[model]
    values = numbers(words[4:], f'{where}: {model}', focals + 2 + count_D)
    D = np.zeros({'plumb_bob': 4, 'equidistant': 4, 'rational_polynomial': 8}[lens])
    D[:count_D] = values[focals + 2 :]
    cx, cy = values[focals : focals + 2] - _CENTRE_PX
    return RawCamera(
        name,
        where,
        image_size(words[2:4], f'{where}: WIDTH and HEIGHT'),
        matrix_of(values[0], values[focals - 1], cx, cy),
        D,
        lens,
    )


def _images(path: Path) -> Iterator[_Image]:
    """Yield the images; each has two lines, of which the second one lists its points."""
    try:
        with io.TextIOWrapper(open_file(path), 'utf-8', 'replace') as file:
            count = number = 0
            points = False
            while line := file.readline(_MOST_LINE):
                number += 1
                length = len(line)
                while not line.endswith('\n') and (more := file.readline(_MOST_LINE)):
                    line = line[:200] + more[-1:]  # points go on
                    length += len(more)
                    if length > MOST_BYTES:
                        raise CalibrationError(
                            f'{path}: line {number} has more than {MOST_BYTES / 1e6:g} MB; the'
                            ' file is damaged, export it again'
                        )
                if line.startswith('#'):
                    continue
                points = not points
                if not points or not line.strip():
                    points = points and bool(line.strip())
                    continue
                count += 1
                if count > _MOST_IMAGES:
                    raise CalibrationError(
                        f'{path} has more than {_MOST_IMAGES} images; give those of a few frames'
                    )
                yield _image(line, f'{path}: line {number}')
    except OSError as error:
        raise FileError(
            f'{path} cannot be read: {error.strerror or error}; give the images.txt of the model'
        ) from error


def _image(line: str, where: str) -> _Image:
    words = line.split(maxsplit=9)
    if len(words) < 10:
        raise CalibrationError(
            f'{where} must have IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID and NAME, got'
            f' {line[:60]!r}; the file is cut off, export it again'
        )
    values = numbers(words[:9], where, 9)
    quaternion, shift = values[1:5], values[5:8]
    if abs(np.linalg.norm(quaternion) - 1) > 1e-3:
        raise CalibrationError(
            f'{where}: the quaternion has the length {np.linalg.norm(quaternion):g}, it must be 1;'
            ' export it again'
        )
    w, x, y, z = quaternion / np.linalg.norm(quaternion)
    R = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return _Image(words[9].strip(), int(values[8]), pose_of(np.array(R), shift))


def _posed(
    cameras: list[RawCamera], images: Sequence[_Image], choice: Choice
) -> tuple[list[RawCamera], tuple[str, ...]]:
    """Return the cameras with the pose of the two that are chosen, and notices."""
    if len(cameras) < 2:
        return cameras, ()
    chosen = cameras[0].name, cameras[1].name
    taken: list[dict[str, _Image]] = [
        {frame_of(image.name): image for image in images if str(image.camera) == name}
        for name in chosen
    ]
    frames = sorted(set(taken[0]) & set(taken[1]))
    if not frames and len(taken[0]) == len(taken[1]) == 1:
        pairs = [(*taken[0].values(), *taken[1].values())]
    else:
        pairs = [(taken[0][frame], taken[1][frame]) for frame in frames]
    if not pairs:
        return cameras, ()
    poses = np.array([second.pose @ inverse(first.pose) for first, second in pairs])
    shift = np.median(poses[:, :3, 3], axis=0)
    off = np.linalg.norm(poses[:, :3, 3] - shift, axis=1)
    pose = poses[int(np.argmin(off))]
    baseline = float(np.linalg.norm(shift))
    notices = []
    spread = float(np.median(off)) / max(baseline, 1e-12)
    if spread > _SPREAD:
        raise CalibrationError(
            f'the pose of cameras {chosen[0]} and {chosen[1]} differs from frame to frame by'
            f' {spread:.0%} of the baseline (median of {counted(len(pairs), "frame")}), at most'
            f' {_SPREAD:.0%} are expected of a rig; reconstruct with rig constraints (colmap'
            ' rig_configurator)'
        )
    if choice.baseline_m is None:
        notices.append(
            f'COLMAP knows no unit of length: the baseline of {baseline:.4g} is taken as metres;'
            ' import-calibration --baseline states it'
        )
    by_name = dict(zip(chosen, (np.eye(4), pose), strict=True))
    sides = dict(zip(chosen, (side_of(image.name) for image in pairs[0]), strict=True))
    posed = [
        dataclasses.replace(camera, pose=by_name.get(camera.name), side=sides.get(camera.name, ''))
        for camera in cameras
    ]
    return posed, tuple(notices)
