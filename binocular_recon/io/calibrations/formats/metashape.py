# SPDX-License-Identifier: Apache-2.0
"""Agisoft Metashape's XML of cameras (File > Export > Export Cameras).

Camera models as in appendix "Camera models" of the user manual of Metashape Professional.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

from binocular_recon.camera import FloatArray
from binocular_recon.errors import CalibrationError
from binocular_recon.io.calibrations.format import CalibrationFormat
from binocular_recon.io.calibrations.raw_rig import Choice, RawCamera, RawRig, wanted
from binocular_recon.io.calibrations.source import SourceFile
from binocular_recon.io.calibrations.values import (
    frame_of,
    image_size,
    inverse,
    matrix_of,
    numbers,
    side_of,
    transformation,
)
from binocular_recon.number_text import counted

_EXPORT = (
    'align the images of both cameras and export the cameras (File > Export > Export Cameras)'
)
_NO_SCALE = (
    'the chunk has no scale: its lengths are taken as metres; import-calibration --baseline states'
    ' the baseline'
)
_PARAMETERS = ('cx', 'cy', 'b1', 'b2', 'k1', 'k2', 'k3', 'k4', 'p1', 'p2', 'p3', 'p4')


class MetashapeFormat(CalibrationFormat):
    """Sensors and aligned cameras; a camera's ``transform`` takes points from it to the chunk."""

    NAME = 'Metashape'
    FILES = 'XML of exported cameras'

    def claims(self, file: SourceFile) -> bool:
        """Return whether the root is that of a document or of a calibration."""
        content = file.content
        if not isinstance(content, Element):
            return False
        return content.tag == 'calibration' or content.find('chunk') is not None

    def read(self, files: Sequence[SourceFile], choice: Choice) -> RawRig:
        """Read the cameras by their labels."""
        paths = tuple(file.path for file in files)
        if all(file.content.tag == 'calibration' for file in files):
            cameras = [
                _camera(file.path.stem, file.content, str(file.path), None) for file in files
            ]
            return RawRig(self.NAME, paths, cameras, _EXPORT)
        if len(files) > 1:
            raise CalibrationError(
                f'{files[0].path} and {files[1].name}: one file of exported cameras makes a'
                ' calibration; give one'
            )
        chunks = files[0].content.findall('chunk')
        if len(chunks) != 1:
            raise CalibrationError(
                f'{paths[0]} holds {counted(len(chunks), "chunk")}; export the cameras of one'
            )
        return self._of_chunk(chunks[0], paths, choice)

    def _of_chunk(self, chunk: Element, paths: tuple[Path, ...], choice: Choice) -> RawRig:
        scale = chunk.findtext('transform/scale') or chunk.findtext(
            'components/component/transform/scale'
        )
        where = str(paths[0])
        factor = 1.0 if scale is None else float(numbers(scale, f'{where}: scale', 1)[0])
        listed = {
            one.get('label') or f'camera {index}': one
            for index, one in enumerate(chunk.iterfind('.//cameras//camera'))
        }
        names = _pair_first(listed, choice, where)
        sensors = {sensor.get('id'): sensor for sensor in chunk.iterfind('sensors/sensor')}
        cameras = []
        for label in wanted(names, choice):
            own, one = f'{where}: {label}', listed[label]
            sensor = sensors.get(one.get('sensor_id'))
            if sensor is None:
                raise CalibrationError(
                    f'{own}: its sensor {one.get("sensor_id")!r} is missing; {_EXPORT}'
                )
            found = sensor.findall('calibration')
            adjusted = [part for part in found if part.get('class') == 'adjusted']
            if not found:
                raise CalibrationError(f'{own}: its sensor has no calibration; {_EXPORT}')
            text, pose = one.findtext('transform'), None
            if text is not None:
                pose = inverse(transformation(text.split(), f'{own}: transform'))
                pose[:3, 3] *= factor
            cameras.append(_camera(label, (adjusted or found)[0], own, pose, sensor))
        notices = () if scale is not None else (_NO_SCALE,)
        return RawRig(self.NAME, paths, cameras, _EXPORT, notices=notices, names=tuple(names))


def _pair_first(listed: dict[str, Element], choice: Choice, where: str) -> list[str]:
    """Return the names of all images, first one of each of two sensors, of the same frame.

    Every image is a camera to Metashape, so the first two may be of one camera.
    """
    names = list(listed)
    if len(names) <= 2 or choice.cameras is not None:
        return names
    first = names[0]
    sensor, frame = listed[first].get('sensor_id'), frame_of(first)
    second = next(
        (
            name
            for name in names
            if listed[name].get('sensor_id') != sensor and frame_of(name) == frame
        ),
        None,
    )
    if second is None:
        raise CalibrationError(
            f'{where}: which of the {len(names)} images are of the same frame is not known: none'
            f' of another sensor is named like {first}; choose two with import-calibration'
            ' --cameras LABEL,LABEL'
        )
    return [first, second, *(name for name in names if name not in (first, second))]


def _camera(
    name: str,
    content: Element,
    where: str,
    pose: FloatArray | None,
    sensor: Element | None = None,
) -> RawCamera:
    kind = content.get('type') or content.findtext('projection') or 'frame'
    if kind not in ('frame', 'fisheye', 'equidistant_fisheye'):
        raise CalibrationError(
            f'{where}: the camera type {kind[:30]!r} is not read, only frame and fisheye; set the'
            ' type in Tools > Camera Calibration and align again'
        )
    f = content.findtext('f')
    if f is None:
        raise CalibrationError(
            f'{where}: the focal length f is missing; export the cameras with Metashape 1.5 or'
            ' later'
        )
    focal = float(numbers(f, f'{where}: f', 1)[0])
    values = {
        key: float(numbers(content.findtext(key) or '0', f'{where}: {key}', 1)[0])
        for key in _PARAMETERS
    }
    size = _size(content, sensor, where)
    if size is None:
        raise CalibrationError(f'{where}: the image size (resolution) is missing; {_EXPORT}')
    # an offset from the middle of the image; the centre of the first pixel is (0.5, 0.5)
    cx, cy = (np.array(size) - 1) / 2 + [values['cx'], values['cy']]
    K = matrix_of(focal + values['b1'], focal, cx, cy, values['b2'])
    lens, D = _distortion(kind, values, where)
    return RawCamera(name, where, size, K, D, lens, pose, side_of(name))


def _distortion(kind: str, values: dict[str, float], where: str) -> tuple[str, FloatArray]:
    k = [values[f'k{index}'] for index in (1, 2, 3, 4)]
    excess = ('k4', 'p3', 'p4') if kind == 'frame' else ('p1', 'p2', 'p3', 'p4')
    for key in excess:
        if values[key]:
            raise CalibrationError(
                f'{where}: {key} of a {kind} camera is {values[key]:g}, no lens here has it; set'
                ' it to 0 in Tools > Optimize Cameras and export again'
            )
    if kind == 'frame':  # p1 and p2 are exchanged against OpenCV
        return 'plumb_bob', np.array([k[0], k[1], values['p2'], values['p1'], k[2]])
    return 'equidistant', np.array(k)


def _size(content: Element, sensor: Element | None, where: str) -> tuple[int, int] | None:
    for part in (content, sensor):
        resolution = None if part is None else part.find('resolution')
        if resolution is not None:
            sides = [resolution.get('width', ''), resolution.get('height', '')]
            return image_size(sides, f'{where}: resolution')
    width, height = content.findtext('width'), content.findtext('height')
    if width is None or height is None:
        return None
    return image_size([width, height], f'{where}: width and height')
