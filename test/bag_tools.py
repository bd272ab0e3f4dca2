# SPDX-License-Identifier: Apache-2.0
"""Small bags in every format, written directly with the rosbags library."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
from rosbags.interfaces import Connection
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from binocular_recon.camera import Camera, StereoRig
from binocular_recon.io.bags.reader import ros2_types
from binocular_recon.io.bags.writer import new_message
from binocular_recon.io.messages.camera_infos import fill_camera_info
from binocular_recon.io.messages.images import fill_image

Image = npt.NDArray[np.uint8]
# topic, message, time of recording
Record = tuple[str, Any, int]

WIDTH, HEIGHT = 96, 72
START_NS, PERIOD_NS = 1_700_000_000_000_000_000, 100_000_000

_ROS2 = {
    'mcap': (StoragePlugin.MCAP, CompressionMode.NONE),
    'mcap, chunks compressed': (StoragePlugin.MCAP, CompressionMode.STORAGE),
    'mcap, messages compressed': (StoragePlugin.MCAP, CompressionMode.MESSAGE),
    'mcap, file compressed': (StoragePlugin.MCAP, CompressionMode.FILE),
    'sqlite3': (StoragePlugin.SQLITE3, CompressionMode.NONE),
    'sqlite3, messages compressed': (StoragePlugin.SQLITE3, CompressionMode.MESSAGE),
    'sqlite3, file compressed': (StoragePlugin.SQLITE3, CompressionMode.FILE),
}
_ROS1 = {
    'ros1': None,
    'ros1, bz2': Ros1Writer.CompressionFormat.BZ2,
    'ros1, lz4': Ros1Writer.CompressionFormat.LZ4,
}
FORMATS = (*_ROS2, *_ROS1)


def rig(focal_px: float = 80.0) -> StereoRig:
    """Return a rectified rig of the size of the test images, baseline 0.5 m."""
    K = np.array([[focal_px, 0, WIDTH / 2], [0, focal_px, HEIGHT / 2], [0, 0, 1]])
    left, right = (
        Camera(WIDTH, HEIGHT, K, np.zeros(5), np.eye(3), np.c_[K, [tx, 0, 0]])
        for tx in (0.0, -0.5 * focal_px)
    )
    return StereoRig(left, right)


def image_pair(index: int, size: tuple[int, int] = (HEIGHT, WIDTH)) -> tuple[Image, Image]:
    """Return a BGR pair with texture; every point is 6 px farther left in the right image."""
    noise = np.random.default_rng(index).integers(0, 256, (size[0], size[1] + 6, 3), np.uint8)
    texture = np.asarray(cv2.GaussianBlur(noise, (5, 5), 0), np.uint8)
    return texture[:, :-6].copy(), texture[:, 6:].copy()


def header(stamp_ns: int, frame_id: str = 'camera_left_optical') -> Any:
    message = new_message('std_msgs/msg/Header')
    message.stamp.sec, message.stamp.nanosec = divmod(stamp_ns, 1_000_000_000)
    message.frame_id = frame_id
    return message


def image_message(image: Image, stamp_ns: int) -> Any:
    message = new_message('sensor_msgs/msg/Image')
    fill_image(message, image, 'bgr8' if image.ndim == 3 else 'mono8', header(stamp_ns))
    return message


def compressed_message(image: Image, stamp_ns: int) -> Any:
    message = new_message('sensor_msgs/msg/CompressedImage')
    message.header, message.format = header(stamp_ns), 'bgr8; png compressed bgr8'
    message.data = cv2.imencode('.png', image)[1].reshape(-1)
    return message


def info_message(camera: Camera, stamp_ns: int) -> Any:
    message = new_message('sensor_msgs/msg/CameraInfo')
    fill_camera_info(message, camera, header(stamp_ns))
    return message


def stereo_records(frames: int = 4, namespace: str = '', image: str = 'image_raw') -> list[Record]:
    """Return the messages that a driver of `rig` would publish."""
    records: list[Record] = []
    for index in range(frames):
        stamp_ns = START_NS + index * PERIOD_NS
        for side, camera, pixels in zip(
            ('left', 'right'), (rig().left, rig().right), image_pair(index), strict=True
        ):
            records += [
                (f'{namespace}/{side}/camera_info', info_message(camera, stamp_ns), stamp_ns),
                (f'{namespace}/{side}/{image}', image_message(pixels, stamp_ns), stamp_ns + 1),
            ]
    return records


def write_bag(path: Path, records: Iterable[Record], fmt: str = 'mcap', version: int = 9) -> Path:
    """Write a bag; returns its path for a command: the folder, or the file of ROS 1."""
    if fmt in _ROS1:
        return _write_ros1(path.with_suffix('.bag'), records, fmt)
    storage, mode = _ROS2[fmt]
    writer = Writer(path, version=version, storage_plugin=storage)  # type: ignore[arg-type]
    writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        _write_records(writer, records, ros2_types(), _to_cdr)
    return path


def data_file(path: Path) -> Path:
    """Return the file of a ROS 2 bag that holds the messages."""
    return next(file for file in sorted(path.iterdir()) if file.suffix != '.yaml')


def _write_ros1(path: Path, records: Iterable[Record], fmt: str) -> Path:
    writer = Ros1Writer(path)
    compression = _ROS1[fmt]
    if compression:
        writer.set_compression(compression)
    with writer:
        _write_records(writer, records, get_typestore(Stores.ROS1_NOETIC), _to_ros1)
    return path


def _write_records(
    writer: Writer | Ros1Writer,
    records: Iterable[Record],
    types: Typestore,
    serialise: Callable[[Any], bytes],
) -> None:
    connections: dict[str, Connection] = {}
    for topic, message, stamp_ns in records:
        if topic not in connections:
            kind = message.__msgtype__
            connections[topic] = writer.add_connection(topic, kind, typestore=types)
        writer.write(connections[topic], stamp_ns, serialise(message))


def _to_cdr(message: Any) -> bytes:
    return bytes(ros2_types().serialize_cdr(message, message.__msgtype__))


def _to_ros1(message: Any) -> bytes:
    return bytes(ros2_types().cdr_to_ros1(_to_cdr(message), message.__msgtype__))
