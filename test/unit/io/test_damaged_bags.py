# SPDX-License-Identifier: Apache-2.0
"""Damaged bags, split recordings, and paths that are not bags."""

from __future__ import annotations

import re
import sqlite3
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
import yaml

from binocular_recon.errors import BagError
from binocular_recon.io.bags.reader import Bag, decode
from test.bag_tools import (
    FORMATS,
    Record,
    data_file,
    stereo_records,
    write_bag,
)


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
    write_metadata(path, [*files[:2], *files[:2]])  # twice
    with Bag(path) as bag:
        assert len(list(bag.messages())) == 8
        assert bag.damage == []
    for listed, message in (
        ([*files, 'gone.db3'], r'metadata\.yaml lists missing files: gone\.db3; all files in'),
        ('3', r'metadata\.yaml lists missing files: 3;'),
        (3, r"metadata\.yaml is damaged \('int' object is not iterable\); all files in its"),
    ):
        write_metadata(path, listed)  # type: ignore[arg-type]
        with Bag(path) as bag:
            assert len(list(bag.messages())) == 12
            (damage,) = bag.damage
            assert re.search(message, damage)


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


@pytest.mark.parametrize('fmt', ['mcap, file compressed', 'sqlite3, file compressed'])
def test_compressed_files_are_read_without_metadata_and_alone(tmp_path: Path, fmt: str) -> None:
    path = write_bag(tmp_path / 'bag', stereo_records(2), fmt)
    (path / 'metadata.yaml').unlink()
    file = data_file(path)
    assert file.suffix == '.zstd'
    for source in (path, file):
        with Bag(source) as bag:
            assert len(list(bag.messages())) == 8
            assert bag.damage == []
    file.write_bytes(file.read_bytes()[:-200])
    with pytest.raises(BagError, match=r'\.zstd cannot be decompressed into .*: .*; repair it'):
        Bag(file)


def test_what_is_not_a_bag_is_named(tmp_path: Path) -> None:
    (tmp_path / 'folder').mkdir()
    (tmp_path / 'text.bag').write_text('hello, this is not a bag at all')
    (tmp_path / 'empty.mcap').write_bytes(b'')
    (tmp_path / 'noise.mcap').write_bytes(np.random.default_rng(0).bytes(5000))
    for name, message in (
        ('gone', r'gone does not exist; check the path'),
        ('folder', r'folder holds no bag file \(\.mcap, \.db3, \.bag\)'),
        ('text.bag', r"text\.bag is not a bag: it begins with b'hello, t'"),
        ('empty.mcap', r"empty\.mcap is not a bag: it begins with b''"),
        ('noise.mcap', r'noise\.mcap is not a bag'),
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


@pytest.mark.parametrize('topic_id', [99, 'left'])
def test_messages_of_no_topic_are_said(tmp_path: Path, topic_id: object) -> None:
    path = write_bag(tmp_path / 'bag', stereo_records(2), 'sqlite3')
    with Bag(path) as bag:
        whole = len(list(bag.messages()))
    with closing(sqlite3.connect(data_file(path))) as database, database:
        database.execute('UPDATE messages SET topic_id = ? WHERE id = 2', (topic_id,))
    with Bag(path) as bag:
        assert len(list(bag.messages())) == whole - 1
        assert len(bag.damage) == 1 and 'messages of no topic: 1' in bag.damage[0]
