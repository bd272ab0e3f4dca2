# SPDX-License-Identifier: Apache-2.0
"""MCAP files whose messages are not those of ROS 2."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from rosbags.typesys import Stores, get_typestore

from binocular_recon.errors import BagError
from binocular_recon.io.bags.reader import Bag, ros2_types
from binocular_recon.io.bags.stereo_bag import StereoBag
from binocular_recon.io.bags.stereo_topics import find_stereo_topics
from test.bag_tools import image_pair, stereo_records

MAGIC = b'\x89MCAP0\r\n'


class Message(NamedTuple):
    topic: str
    schema: str
    definition: bytes
    stamp_ns: int
    data: bytes


def text(value: str) -> bytes:
    return struct.pack('<I', len(value.encode())) + value.encode()


def record(kind: int, content: bytes) -> bytes:
    return struct.pack('<BQ', kind, len(content)) + content


def write_mcap(path: Path, encoding: str, schema_encoding: str, messages: list[Message]) -> Path:
    """Write an MCAP file without chunks or an index, as simple recorders do."""
    parts = [MAGIC, record(1, text(encoding) + text('test'))]
    channels: dict[str, int] = {}
    for message in messages:
        if message.topic not in channels:
            key = channels[message.topic] = len(channels) + 1
            size = struct.pack('<I', len(message.definition))
            parts.append(
                record(
                    3,
                    struct.pack('<H', key)
                    + text(message.schema)
                    + text(schema_encoding)
                    + size
                    + message.definition,
                )
            )
            head = struct.pack('<HH', key, key) + text(message.topic) + text(encoding)
            parts.append(record(4, head + struct.pack('<I', 0)))
        stamp = struct.pack('<HIQQ', channels[message.topic], 0, message.stamp_ns, 0)
        parts.append(record(5, stamp + message.data))
    parts += [record(15, struct.pack('<I', 0)), record(2, struct.pack('<QQI', 0, 0, 0)), MAGIC]
    path.write_bytes(b''.join(parts))
    return path


def ros1_messages(frames: int) -> list[Message]:
    """Return the messages of a rig as a converter of ROS 1 bags to MCAP stores them."""
    types, ros1 = ros2_types(), get_typestore(Stores.ROS1_NOETIC)
    found = []
    for topic, message, stamp_ns in stereo_records(frames):
        kind = message.__msgtype__
        cdr = types.serialize_cdr(message, kind)
        definition = ros1.generate_msgdef(kind, ros_version=1)[0]
        name = kind.replace('/msg/', '/')
        data = bytes(types.cdr_to_ros1(cdr, kind))
        found.append(Message(topic, name, definition.encode(), stamp_ns, data))
    return found


def test_messages_of_ros_1_are_read(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / 'ros1.mcap', 'ros1', 'ros1msg', ros1_messages(3))
    with Bag(path) as bag:
        assert {topic.msgtype for topic in bag.topics} == {
            'sensor_msgs/msg/CameraInfo',
            'sensor_msgs/msg/Image',
        }
        pairs = list(StereoBag(bag, find_stereo_topics(bag.topics)))
        assert bag.damage == []
    assert len(pairs) == 3
    for index, pair in enumerate(pairs):
        for image, truth in zip(pair.images(), image_pair(index), strict=True):
            np.testing.assert_array_equal(image, truth)
        assert pair.rig.baseline_m == pytest.approx(0.5)


@pytest.mark.parametrize(
    ('encoding', 'schema_encoding', 'schema'),
    [
        ('protobuf', 'protobuf', 'foxglove.RawImage'),
        ('protobuf', 'protobuf', 'foxglove.CompressedImage'),
        ('json', 'jsonschema', 'foxglove.CameraCalibration'),
    ],
)
def test_other_encodings_are_named(
    tmp_path: Path, encoding: str, schema_encoding: str, schema: str
) -> None:
    messages = [
        Message(topic, schema, b'\xff\xfe\x00', k, b'{}')
        for k in range(3)
        for topic in ('/left/image', '/right/image')
    ]
    path = write_mcap(tmp_path / 'foreign.mcap', encoding, schema_encoding, messages)
    name = rf'/left/image \({schema}, {encoding}\), /right/image \({schema}, {encoding}\)'
    with pytest.raises(BagError, match=f'holds {name}: only messages of ROS 1 and ROS 2 are read'):
        Bag(path)
