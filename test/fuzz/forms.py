# SPDX-License-Identifier: Apache-2.0
"""The forms of input: what reads each, with its seeds in ``seeds/FORM/``.

A reader gets the bytes of one input and a folder of its own. It may return or raise a
`BinocularReconError`; anything else is a finding.
"""

from __future__ import annotations

import contextlib
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

from binocular_recon.apps.stored_frame import stored_frames
from binocular_recon.apps.summary_entries import SUMMARY
from binocular_recon.apps.survey.measured_folder import MeasuredFolder
from binocular_recon.calibration.session.points_csv import read_points
from binocular_recon.calibration.target.rods import load_rods
from binocular_recon.cli.main import EXIT_USAGE, main
from binocular_recon.errors import BinocularReconError
from binocular_recon.evaluation.accuracy.scenes import read_scene
from binocular_recon.io.bags.reader import Bag, decode
from binocular_recon.io.bags.stereo_topics import find_stereo_topics
from binocular_recon.io.calibration_yaml import read_rig
from binocular_recon.io.disparity_files import read_disparity_file
from binocular_recon.io.exports.placement import read_placement
from binocular_recon.io.exports.point_table import PointTable
from binocular_recon.io.image_files import read_image_file
from binocular_recon.io.messages.camera_infos import camera_from_message, rig_from_messages
from binocular_recon.io.messages.disparities import read_disparity
from binocular_recon.io.messages.images import read_image, stamp_ns
from binocular_recon.io.pairs.capture_times import capture_time_ns
from binocular_recon.io.pfm import read_pfm

SEEDS = Path(__file__).parent / 'seeds'
# What lies beside the input that is changed.
BESIDE = Path(__file__).parent / 'beside'

# Types of messages that commands decode.
TYPES = {f'sensor_msgs/msg/{name}' for name in ('CameraInfo', 'Image', 'CompressedImage')}

Reader = Callable[[bytes, Path], object]


def seeds(form: str) -> list[bytes]:
    """Return the seeds of a form, in the order of their names."""
    return [path.read_bytes() for path in sorted((SEEDS / form).iterdir())]


def _written(data: bytes, path: Path) -> Path:
    path.write_bytes(data)
    return path


def _message(msgtype: str, data: bytes) -> Any:
    return decode(f'sensor_msgs/msg/{msgtype}', data)


def _camera_info(data: bytes, _folder: Path) -> None:
    info = _message('CameraInfo', data)
    stamp_ns(info.header)
    for rectified in (False, True):
        with contextlib.suppress(BinocularReconError):
            camera_from_message(info, size=(64, 48), rectified=rectified)
    right = _message('CameraInfo', (BESIDE / 'right_info.cdr').read_bytes())
    rig = rig_from_messages(info, right)
    assert all(isinstance(text, str) for text in (*rig.notices, *rig.warnings))


def _image(data: bytes, _folder: Path) -> None:
    read_image(_message('Image', data))


def _compressed_image(data: bytes, _folder: Path) -> None:
    read_image(_message('CompressedImage', data))


def _disparity(data: bytes, _folder: Path) -> None:
    info = (BESIDE / 'left_info.cdr').read_bytes(), (BESIDE / 'right_info.cdr').read_bytes()
    rig = rig_from_messages(*(_message('CameraInfo', one) for one in info))
    read_disparity(decode('stereo_msgs/msg/DisparityImage', data), rig)


def _bag(path: Path) -> None:
    with Bag(path) as bag:
        with contextlib.suppress(BinocularReconError):
            find_stereo_topics(bag.topics)
        for message in bag.messages():
            if message.topic.msgtype in TYPES:
                with contextlib.suppress(BinocularReconError):
                    decode(message.topic.msgtype, message.cdr)


def _metadata(data: bytes, folder: Path) -> None:
    for path in (BESIDE / 'bag').iterdir():
        shutil.copy(path, folder)
    _written(data, folder / 'metadata.yaml')
    _bag(folder)


def _rig(data: bytes, folder: Path, name: str) -> None:
    for path in (BESIDE / 'rig').iterdir():
        shutil.copy(path, folder)
    _written(data, folder / name)
    rig = read_rig(folder)
    assert all(isinstance(text, str) for text in (*rig.notices, *rig.warnings))


def _scene(data: bytes, folder: Path) -> None:
    for path in (BESIDE / 'scene').iterdir():
        shutil.copy(path, folder)
    _written(data, folder / 'scene.yaml')
    read_scene(folder)


def _summary(data: bytes, folder: Path) -> None:
    _written(data, folder / SUMMARY)
    with contextlib.suppress(BinocularReconError):
        list(stored_frames(folder))
    found = MeasuredFolder(folder)
    for number in range(found.count):
        found.rig(number)


def _arguments(data: bytes, folder: Path) -> None:
    """Run a command whose input does not exist, so that nothing is computed or written."""
    words = data.decode(errors='surrogateescape').split('\n')
    before = Path.cwd()
    os.chdir(folder)
    try:
        status = main(['match', 'no.png', 'no.png', '--output', 'no/no.pfm', *words])
    except SystemExit as end:
        status = EXIT_USAGE if end.code == 2 else 0
    finally:
        os.chdir(before)
    assert status in (0, 1, EXIT_USAGE)


def _check(data: bytes, _folder: Path) -> None:
    """Do what readers must not do: the suite checks that it finds that."""
    if data == b'traceback':
        raise ValueError(data)
    if data == b'endless':
        while True:
            pass
    if data == b'memory':
        bytearray(2_000_000_000)
    if data == b'crash':
        os.abort()


FORMS: dict[str, Reader] = {
    'camera_yaml': lambda data, folder: _rig(data, folder, 'left.yaml'),
    'calibration_json': lambda data, folder: _rig(data, folder, 'calibration.json'),
    'rods_yaml': lambda data, folder: load_rods(_written(data, folder / 'rods.yaml')),
    'scene_yaml': _scene,
    'foreign_yaml': lambda data, folder: read_rig(_written(data, folder / 'a.yaml')),
    'foreign_xml': lambda data, folder: read_rig(_written(data, folder / 'a.xml')),
    'cameramodel': lambda data, folder: read_rig(_written(data, folder / 'a.cameramodel')),
    'mat': lambda data, folder: read_rig(_written(data, folder / 'a.mat')),
    'pfm': lambda data, folder: read_pfm(_written(data, folder / 'a.pfm')),
    'npy': lambda data, folder: read_disparity_file(_written(data, folder / 'a.npy')),
    'points_csv': lambda data, folder: read_points(_written(data, folder / 'a.csv')),
    'arguments': _arguments,
    'camera_info': _camera_info,
    'disparity': _disparity,
    'image': _image,
    'compressed_image': _compressed_image,
    'exif': lambda data, folder: capture_time_ns(_written(data, folder / 'a.jpg')),
    'ply': lambda data, folder: PointTable.of_file(_written(data, folder / 'a.ply')),
    'summary': _summary,
    'georeference': lambda data, folder: read_placement(_written(data, folder / 'a.json')),
    'image_file': lambda data, folder: read_image_file(_written(data, folder / 'a.png')),
    'mcap': lambda data, folder: _bag(_written(data, folder / 'a.mcap')),
    'db3': lambda data, folder: _bag(_written(data, folder / 'a.db3')),
    'metadata': _metadata,
}
# Not among those that are run by default.
CHECK = 'check'
READERS = {**FORMS, CHECK: _check}
