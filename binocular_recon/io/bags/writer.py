# SPDX-License-Identifier: Apache-2.0
"""Write bags without ROS."""

from __future__ import annotations

from contextlib import AbstractContextManager
from pathlib import Path
from types import TracebackType
from typing import Any

from rosbags.convert.converter import default_message
from rosbags.interfaces import (
    Connection,
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer, WriterError

from binocular_recon.camera import StereoRig
from binocular_recon.errors import FileError
from binocular_recon.images import Image
from binocular_recon.io.bags.reader import TopicQos, ros2_types
from binocular_recon.io.messages.camera_infos import fill_camera_info
from binocular_recon.io.messages.images import fill_image, plain_encoding

RELIABLE = TopicQos()
_UNLIMITED = QosTime(9223372036, 854775807)  # as rosbag2 writes it
_IMAGE, _INFO = 'sensor_msgs/msg/Image', 'sensor_msgs/msg/CameraInfo'


def new_message(msgtype: str) -> Any:
    """Return an empty message of a ROS 2 type as a dataclass, to be filled and written."""
    return default_message(ros2_types(), msgtype)


class BagWriter(AbstractContextManager['BagWriter']):
    """Write a ROS 2 bag: mcap with compressed chunks.

    Parameters
    ----------
    path : Path
        Folder of the bag; it must not exist.

    Raises
    ------
    FileError
        If the folder exists or cannot be made.

    """

    def __init__(self, path: Path) -> None:
        try:
            self._writer = Writer(path, version=9, storage_plugin=StoragePlugin.MCAP)
            self._writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
            self._writer.open()
        except WriterError as error:
            raise FileError(f'{path} exists; remove it or choose another folder') from error
        except OSError as error:
            raise FileError(
                f'{path} cannot be made: {error.strerror}; choose another folder'
            ) from error
        self._connections: dict[str, Connection] = {}

    def write(self, topic: str, message: Any, stamp_ns: int, qos: TopicQos = RELIABLE) -> None:
        """Append a message of `new_message`; the first of a topic sets its type and QoS."""
        msgtype = message.__msgtype__
        if topic not in self._connections:
            self._connections[topic] = self._writer.add_connection(
                topic, msgtype, typestore=ros2_types(), offered_qos_profiles=[_offer(qos)]
            )
        cdr = ros2_types().serialize_cdr(message, msgtype)
        self._writer.write(self._connections[topic], stamp_ns, cdr)

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Write the index; after an error, only close the file."""
        self._writer.__exit__(kind, error, traceback)


def _offer(qos: TopicQos) -> Qos:
    return Qos(
        QosHistory.KEEP_LAST,
        qos.depth,
        QosReliability.RELIABLE if qos.reliable else QosReliability.BEST_EFFORT,
        QosDurability.TRANSIENT_LOCAL if qos.transient_local else QosDurability.VOLATILE,
        _UNLIMITED,
        _UNLIMITED,
        QosLiveliness.AUTOMATIC,
        _UNLIMITED,
        avoid_ros_namespace_conventions=False,
    )


def write_pair(
    writer: BagWriter, rig: StereoRig, pair: tuple[Image, Image], stamp_ns: int
) -> None:
    """Append an image pair and its camera infos, on the topics that the nodes read.

    Parameters
    ----------
    writer : BagWriter
    rig : StereoRig
        Calibration of the images.
    pair : (image, image)
        Left and right: (H, W) or (H, W, 3) BGR, uint8 or uint16.
    stamp_ns : int
        Stamp of both images, and time of the recording.

    Raises
    ------
    ImageError
        If an image has another type or number of channels.

    """
    for side, camera, image in zip(('left', 'right'), (rig.left, rig.right), pair, strict=True):
        header = new_message('std_msgs/msg/Header')
        header.stamp.sec, header.stamp.nanosec = divmod(stamp_ns, 1_000_000_000)
        header.frame_id = f'camera_{side}_optical'
        message, info = new_message(_IMAGE), new_message(_INFO)
        fill_image(message, image, plain_encoding(image), header)
        fill_camera_info(info, camera, header)
        writer.write(f'/{side}/camera_info', info, stamp_ns)
        writer.write(f'/{side}/image_raw', message, stamp_ns)
