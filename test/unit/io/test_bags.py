# SPDX-License-Identifier: Apache-2.0
"""Bags of every format, whole and damaged."""

from __future__ import annotations

import re
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
import yaml
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.typesys import Stores, get_typestore

from binocular_recon.errors import BagError, FileError
from binocular_recon.io.bags.reader import Bag, TopicQos, decode
from binocular_recon.io.bags.writer import BagWriter, new_message
from test.bag_tools import (
    FORMATS,
    START_NS,
    Record,
    image_message,
    pictures,
    stereo_records,
    write_bag,
)


def data_file(path: Path) -> Path:
    """Return the file of a bag that holds the messages."""
    return next(file for file in sorted(path.iterdir()) if file.suffix != '.yaml')


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
        np.testing.assert_array_equal(image.data, pictures(index)[0].reshape(-1))


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
        ('/left/image_raw', image_message(pictures(0, (480, 640))[0], stamp), stamp)
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


@pytest.mark.parametrize('keep', [0.5, 0.99])
@pytest.mark.parametrize('fmt', [*FORMATS[:3], *FORMATS[4:6], *FORMATS[-3:]])
def test_what_precedes_a_cut_is_kept_and_the_cut_is_said(
    tmp_path: Path, fmt: str, keep: float
) -> None:
    records = stereo_records(80)
    path = write_bag(tmp_path / 'bag', records, fmt)
    with Bag(path) as bag:
        whole = list(bag.messages())
    file = path if path.is_file() else data_file(path)
    content = file.read_bytes()
    file.write_bytes(content[: int(len(content) * keep)])

    with Bag(path) as bag:
        kept = list(bag.messages())
        assert len(bag.damage) >= 1
        assert all('is damaged (' in sentence for sentence in bag.damage)
        assert sum(topic.message_count for topic in bag.topics) == len(kept)

    # a ROS 1 chunk is 768 KiB, an MCAP chunk 1 MiB: what is lost is at most the last one
    chunk = 5 if 'sqlite' in fmt else 110
    assert len(kept) >= keep * len(whole) - chunk
    key = [(m.topic.name, m.stamp_ns, m.cdr) for m in whole]
    assert {(m.topic.name, m.stamp_ns, m.cdr) for m in kept} <= set(key)


def damage_the_middle(file: Path) -> None:
    content = bytearray(file.read_bytes())
    middle = len(content) // 2
    content[middle : middle + 2000] = bytes(2000)
    file.write_bytes(content)


def test_a_bad_chunk_ends_the_messages_and_is_said(tmp_path: Path) -> None:
    path = write_bag(tmp_path / 'bag', stereo_records(80), 'mcap, chunks compressed')
    damage_the_middle(data_file(path))
    with Bag(path) as bag:
        assert 50 < len(list(bag.messages())) < 250
        assert len(bag.damage) == 1


def write_split_bag(path: Path, records: list[Record], fmt: str = 'mcap') -> Path:
    """Write three files with the same number of messages, without metadata.yaml."""
    path.mkdir()
    count = len(records) // 3
    for index in range(3):
        part = path.with_name(f'part_{index}')
        file = data_file(write_bag(part, records[count * index : count * (index + 1)], fmt))
        file.rename(path / f'bag_{index}{file.suffix}')
    return path


def write_metadata(path: Path, files: list[str]) -> None:
    """Write metadata.yaml as the recorder of the first part did, for these files."""
    content = yaml.safe_load((path.with_name('part_0') / 'metadata.yaml').read_text())
    content['rosbag2_bagfile_information']['relative_file_paths'] = files
    (path / 'metadata.yaml').write_text(yaml.safe_dump(content))


def test_a_bad_chunk_in_a_split_recording_costs_only_the_end_of_its_file(tmp_path: Path) -> None:
    records = stereo_records(120)
    path = write_split_bag(tmp_path / 'bag', records, 'mcap, chunks compressed')
    write_metadata(path, [f'bag/bag_{index}.mcap' for index in range(3)])
    damage_the_middle(path / 'bag_0.mcap')
    with Bag(path) as bag:
        stamps = [message.stamp_ns for message in bag.messages()]
        (damage,) = bag.damage
    assert f'{path}/bag_0.mcap is damaged (' in damage
    assert stamps[-320:] == sorted(record[2] for record in records[160:])
    assert 320 <= len(stamps) < 480


@pytest.mark.parametrize('fmt', ['mcap, messages compressed', 'sqlite3, messages compressed'])
def test_metadata_says_which_files_belong_to_the_bag(tmp_path: Path, fmt: str) -> None:
    records = stereo_records(3)
    path = write_split_bag(tmp_path / 'bag', records, fmt)
    files = sorted(file.name for file in path.iterdir())
    write_metadata(path, files[:2])
    with Bag(path) as bag:
        assert len(list(bag.messages())) == 8
        assert bag.damage == []
    for listed, complaint in (
        ([*files, 'gone.db3'], r'^gone\.db3 of .*metadata\.yaml is missing; all files there'),
        ('3', r'^3 of .*metadata\.yaml is missing'),
        (3, r"metadata\.yaml is damaged \('int' object is not iterable\); all files beside it"),
    ):
        write_metadata(path, listed)  # type: ignore[arg-type]
        with Bag(path) as bag:
            assert len(list(bag.messages())) == 12
            (said,) = bag.damage
            assert re.search(complaint, said)


def test_one_damaged_file_of_a_split_recording_costs_only_its_own_end(tmp_path: Path) -> None:
    records = stereo_records(120)
    path = write_split_bag(tmp_path / 'bag', records)
    middle = path / 'bag_1.mcap'
    middle.write_bytes(middle.read_bytes()[:1_300_000])
    (path / 'bag_3.mcap').write_bytes(b'')  # the recorder was killed as it began a new file
    with Bag(path) as bag:
        stamps = [message.stamp_ns for message in bag.messages()]
        assert [('bag_1.mcap' in s, 'bag_3.mcap' in s) for s in bag.damage] == [
            (True, False),
            (False, True),
        ]
    assert stamps[:160] == sorted(record[2] for record in records[:160])
    assert stamps[-160:] == sorted(record[2] for record in records[-160:])
    assert 320 < len(stamps) < 480


def test_packed_files_without_metadata_can_be_unpacked(tmp_path: Path) -> None:
    path = write_bag(tmp_path / 'bag', stereo_records(1), 'mcap, file compressed')
    (path / 'metadata.yaml').unlink()
    with pytest.raises(BagError, match=r'unpack its \.zstd files with zstd -d'):
        Bag(path)


def test_what_is_no_bag_is_named(tmp_path: Path) -> None:
    (tmp_path / 'folder').mkdir()
    (tmp_path / 'text.bag').write_text('hello, this is no bag at all')
    (tmp_path / 'empty.mcap').write_bytes(b'')
    (tmp_path / 'noise.mcap').write_bytes(np.random.default_rng(0).bytes(5000))
    for name, message in (
        ('gone', r'gone does not exist; check the path'),
        ('folder', r'folder holds no bag file \(\.mcap, \.db3, \.bag\)'),
        ('text.bag', r"text\.bag is no bag: it begins with b'hello, t'"),
        ('empty.mcap', r"empty\.mcap is no bag: it begins with b''"),
        ('noise.mcap', r'noise\.mcap is no bag'),
    ):
        with pytest.raises(BagError, match=message):
            Bag(tmp_path / name)


@pytest.mark.parametrize('fmt', ['mcap', 'sqlite3', 'ros1'])
def test_a_bag_without_messages_is_refused(tmp_path: Path, fmt: str) -> None:
    path = write_bag(tmp_path / 'bag', [], fmt)
    with pytest.raises(BagError, match='holds no message'):
        Bag(path)


def test_a_damaged_message_is_a_bag_error() -> None:
    for cdr in (b'', b'\0\1\0\0', b'\0\1\0\0' + bytes(20), bytes(range(200))):
        with pytest.raises(BagError, match='message is damaged'):
            decode('sensor_msgs/msg/Image', cdr)


def test_a_bag_is_not_overwritten(tmp_path: Path) -> None:
    path = write_bag(tmp_path / 'bag', stereo_records(1))
    with pytest.raises(FileError, match='bag exists; remove it'):
        BagWriter(path)
    (tmp_path / 'file').write_text('')
    with pytest.raises(FileError, match='cannot be made'):
        BagWriter(tmp_path / 'file' / 'bag')
