# SPDX-License-Identifier: Apache-2.0
"""Bags of every format."""

from __future__ import annotations

import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.typesys import Stores, get_typestore

from binocular_recon.errors import FileError
from binocular_recon.io.bags.reader import Bag, TopicQos, decode
from binocular_recon.io.bags.writer import BagWriter, new_message
from test.bag_tools import (
    FORMATS,
    START_NS,
    data_file,
    image_message,
    image_pair,
    stereo_records,
    write_bag,
)


@pytest.mark.parametrize('version', [8, 9])
@pytest.mark.parametrize('fmt', FORMATS)
def test_every_format_gives_the_same_messages_in_order(
    tmp_path: Path, fmt: str, version: int
) -> None:
    records = stereo_records(3)
    path = write_bag(tmp_path / 'bag', records, fmt, version)
    with Bag(path) as bag:
        assert [(topic.name, topic.message_count) for topic in bag.topics] == [
            (f'/{side}/{name}', 3)
            for side in ('left', 'right')
            for name in ('camera_info', 'image_raw')
        ]
        messages = list(bag.messages())
        assert bag.damage == []
    assert sorted((message.topic.name, message.stamp_ns) for message in messages) == sorted(
        (topic, stamp_ns) for topic, _, stamp_ns in records
    )
    assert [message.stamp_ns for message in messages] == sorted(r[2] for r in records)
    left = [message for message in messages if message.topic.name == '/left/image_raw']
    for index, message in enumerate(left):
        image = decode(message.topic.msgtype, message.cdr)
        assert image.header.frame_id == 'camera_left_optical'
        assert image.header.stamp.nanosec == index * 100_000_000
        np.testing.assert_array_equal(image.data, image_pair(index)[0].reshape(-1))


def test_only_the_topics_asked_for_are_read(tmp_path: Path) -> None:
    with Bag(write_bag(tmp_path / 'bag', stereo_records(2))) as bag:
        wanted = [topic for topic in bag.topics if topic.name == '/right/image_raw']
        assert [message.topic for message in bag.messages(wanted)] == wanted * 2


@pytest.mark.parametrize('fmt', ['mcap', 'sqlite3'])
def test_metadata_may_be_missing(tmp_path: Path, fmt: str) -> None:
    path = write_bag(tmp_path / 'bag', stereo_records(2), fmt)
    (path / 'metadata.yaml').unlink()
    for given in (path, data_file(path)):
        with Bag(given) as bag:
            assert len(list(bag.messages())) == 8
            assert bag.damage == []


def test_quality_of_service_is_kept(tmp_path: Path) -> None:
    with BagWriter(tmp_path / 'bag') as writer:
        message = new_message('std_msgs/msg/Header')
        writer.write('/latched', message, 1, TopicQos(transient_local=True, depth=3))
        writer.write('/lossy', message, 2, TopicQos(reliable=False))
        writer.write('/plain', message, 3)
    with Bag(tmp_path / 'bag') as bag:
        assert [topic.qos for topic in bag.topics] == [
            TopicQos(reliable=True, transient_local=True, depth=3),
            TopicQos(reliable=False, transient_local=False, depth=10),
            TopicQos(reliable=True, transient_local=False, depth=10),
        ]


def test_ros1_latched_topics_are_transient_local(tmp_path: Path) -> None:
    types = get_typestore(Stores.ROS1_NOETIC)
    with Ros1Writer(tmp_path / 'a.bag') as writer:
        connection = writer.add_connection('/a', 'std_msgs/msg/Bool', typestore=types, latching=1)
        writer.write(connection, 5, b'\1')
    with Bag(tmp_path / 'a.bag') as bag:
        (message,) = bag.messages()
        assert message.topic.qos.transient_local
        assert decode('std_msgs/msg/Bool', message.cdr).data


def test_publishers_of_a_topic_offer_together_what_one_of_them_offered(tmp_path: Path) -> None:
    types = get_typestore(Stores.ROS1_NOETIC)
    with Ros1Writer(tmp_path / 'a.bag') as writer:
        for latching in (1, 0):
            connection = writer.add_connection(
                '/a',
                'std_msgs/msg/Bool',
                typestore=types,
                latching=latching,
                callerid=str(latching),
            )
            writer.write(connection, 5, b'\1')
    with Bag(tmp_path / 'a.bag') as bag:
        (topic,) = bag.topics
    assert topic.qos.transient_local and topic.message_count == 2


def test_ros1_types_that_changed_are_converted_member_by_member(tmp_path: Path) -> None:
    types = get_typestore(Stores.ROS1_NOETIC)
    battery = types.types['sensor_msgs/msg/Joy']
    header = types.types['std_msgs/msg/Header'](
        7, types.types['builtin_interfaces/msg/Time'](3, 4), 'stick'
    )
    message = battery(header, np.array([0.5, -1], np.float32), np.array([1, 0, 1], np.int32))
    odd = 'Header header\nfloat64 extra\nuint32 height\n'
    with Ros1Writer(tmp_path / 'a.bag') as writer:
        joy = writer.add_connection('/joy', 'sensor_msgs/msg/Joy', typestore=types)
        writer.write(joy, 5, types.serialize_ros1(message, 'sensor_msgs/msg/Joy'))
        header_definition = types.generate_msgdef('std_msgs/msg/Header')[0]
        changed = writer.add_connection(
            '/changed',
            'sensor_msgs/msg/CameraInfo',
            msgdef=f'{odd}{"=" * 80}\nMSG: std_msgs/Header\n{header_definition}',
            md5sum='0' * 32,
        )
        payload = types.serialize_ros1(header, 'std_msgs/msg/Header')
        writer.write(changed, 6, bytes(payload) + np.float64(2).tobytes() + b'\x2a\0\0\0')
    with Bag(tmp_path / 'a.bag') as bag:
        first, second = bag.messages()
        assert bag.damage == []
    joy_message = decode('sensor_msgs/msg/Joy', first.cdr)
    assert joy_message.axes.tolist() == [0.5, -1.0]
    assert joy_message.header.stamp.nanosec == 4
    info = decode('sensor_msgs/msg/CameraInfo', second.cdr)
    assert (info.header.frame_id, info.height, info.width) == ('stick', 42, 0)


def test_the_bag_is_never_in_memory_as_a_whole(tmp_path: Path) -> None:
    records = (
        ('/left/image_raw', image_message(image_pair(0, (480, 640))[0], stamp), stamp)
        for stamp in range(START_NS, START_NS + 40)
    )
    path = write_bag(tmp_path / 'bag', records)
    assert data_file(path).stat().st_size > 36_000_000
    with Bag(path) as bag:
        tracemalloc.start()
        count = sum(1 for _ in bag.messages())
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
    assert count == 40
    assert peak < 9_000_000


def test_a_bag_is_not_overwritten(tmp_path: Path) -> None:
    path = write_bag(tmp_path / 'bag', stereo_records(1))
    with pytest.raises(FileError, match='bag exists; remove it'):
        BagWriter(path)
    (tmp_path / 'file').write_text('')
    with pytest.raises(FileError, match='cannot be made'):
        BagWriter(tmp_path / 'file' / 'bag')
