# SPDX-License-Identifier: Apache-2.0
"""Bags that claim more than they hold, never end, or lost messages and do not show it."""

from __future__ import annotations

import bz2
import os
import shutil
import sqlite3
import struct
from binascii import crc32
from contextlib import closing
from pathlib import Path

import lz4.frame  # type: ignore[import-untyped]
import pytest
from rosbags.rosbag2 import reader as rosbags_reader
from rosbags.typesys import get_types_from_msg

from binocular_recon.errors import BagError
from binocular_recon.io.bags import _decompression as decompression
from binocular_recon.io.bags._ros1_conversion import check_definition
from binocular_recon.io.bags.reader import Bag
from binocular_recon.io.bags.stereo_bag import StereoBag
from binocular_recon.io.bags.stereo_topics import find_stereo_topics
from test.bag_tools import data_file, stereo_records, write_bag
from test.unit.io.test_foreign_mcap import MAGIC, record, text

_zstd = rosbags_reader.zstd  # type: ignore[attr-defined]
COMPRESS = {'zstd': _zstd.compress, 'lz4': lz4.frame.compress, 'bz2': bz2.compress}
MEBIBYTE = 2**20
STEREO = ['/left/camera_info', '/left/image_raw', '/right/camera_info', '/right/image_raw']


@pytest.mark.parametrize('name', COMPRESS)
@pytest.mark.parametrize('parts', [1, 3])
def test_chunks_may_not_be_larger_than_they_state(name: str, parts: int) -> None:
    content = bytes(range(256)) * 1000
    packed = COMPRESS[name](content) * parts
    size = parts * len(content)
    assert decompression.unpack_chunk(name, packed, size) == content * parts
    with pytest.raises(BagError, match=rf'compressed by {name} hold more than {size - 1}, all'):
        decompression.unpack_chunk(name, packed, size - 1)
    with pytest.raises(BagError, match=rf'a chunk claims {size} bytes, at most 1000 are read'):
        decompression.unpack_chunk(name, packed, size, most=1000)
    with pytest.raises(BagError, match=f'compressed by {name} are (cut off|damaged)'):
        decompression.unpack_chunk(name, packed[:-3], size)
    with pytest.raises(BagError, match=f'compressed by {name} are damaged'):
        decompression.unpack_chunk(name, b'\x07' * 100, size)


def test_chunks_of_unknown_compression_are_named() -> None:
    with pytest.raises(BagError, match="compressed by 'snappy'; zstd, lz4, bz2 can be read"):
        decompression.unpack_chunk('snappy', b'1', 1)


def mcap_with_chunk(path: Path, compression: str, packed: bytes, size: int) -> Path:
    chunk = struct.pack('<QQQI', 1, 2, size, 0) + text(compression)
    chunk += struct.pack('<Q', len(packed)) + packed
    parts = [MAGIC, record(1, text('ros2') + text('test')), record(6, chunk)]
    parts += [record(15, struct.pack('<I', 0)), record(2, struct.pack('<QQI', 0, 0, 0)), MAGIC]
    path.write_bytes(b''.join(parts))
    return path


@pytest.mark.parametrize('name', ['zstd', 'lz4'])
@pytest.mark.parametrize('states', [1000, 2**40])
def test_a_chunk_that_explodes_is_damage(tmp_path: Path, name: str, states: int) -> None:
    packed = COMPRESS[name](bytes(16 * MEBIBYTE)) * 100
    path = mcap_with_chunk(tmp_path / 'bomb.mcap', name, packed, states)
    with pytest.raises(BagError, match=r'hold more than 1000|claims 1099511627776 bytes'):
        Bag(path)


@pytest.mark.parametrize('fmt', ['ros1, bz2', 'ros1, lz4'])
def test_a_chunk_of_ros_1_that_explodes_is_damage(
    tmp_path: Path, fmt: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write_bag(tmp_path / 'bag', stereo_records(4), fmt)
    monkeypatch.setattr(decompression, 'MOST_ROS1_BYTES', 1000)
    with Bag(path) as bag:
        assert list(bag.messages()) == []
        assert 'hold more than 1000, all that they may' in bag.damage[0]


@pytest.mark.parametrize('fmt', ['mcap, messages compressed', 'sqlite3, messages compressed'])
def test_a_message_that_explodes_is_damage(
    tmp_path: Path, fmt: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write_bag(tmp_path / 'bag', stereo_records(4), fmt)
    monkeypatch.setattr(decompression, 'MOST_BYTES', 1000)
    monkeypatch.setattr(decompression.unpack_zstd, '__defaults__', (1000,))
    with Bag(path) as bag:
        assert all('camera_info' in message.topic.name for message in bag.messages())
        assert 'hold more than 1000, all that they may' in bag.damage[0]


def test_a_file_that_explodes_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_bag(tmp_path / 'bag', stereo_records(20), 'mcap, file compressed')
    with Bag(path) as bag:
        assert len(list(bag.messages())) == 80
    monkeypatch.setattr(decompression, 'MOST_FILE_BYTES', 1000)
    monkeypatch.setattr(decompression, 'MOST_FILE_GROWTH', 1)
    with pytest.raises(BagError, match=r'grows beyond \d+ bytes, which is implausible'):
        Bag(path)


ENDLESS_VIEW = """CREATE VIEW {0} AS WITH RECURSIVE n(id) AS
    (SELECT 1 UNION ALL SELECT id + 1 FROM n)
    SELECT id, 1 AS topic_id, id AS timestamp, x'00' AS data, 'a' AS name, 'b' AS type FROM n"""
HUGE_COLUMN = """CREATE TABLE {0}(id INTEGER, topic_id INTEGER, timestamp INTEGER, name TEXT,
    type TEXT, data BLOB AS (zeroblob(900000000)) VIRTUAL)"""


@pytest.mark.parametrize('name', ['messages', 'topics'])
@pytest.mark.parametrize('endless', [ENDLESS_VIEW, HUGE_COLUMN])
def test_messages_that_are_computed_are_refused(tmp_path: Path, name: str, endless: str) -> None:
    path = data_file(write_bag(tmp_path / 'bag', stereo_records(2), 'sqlite3'))
    with closing(sqlite3.connect(path)) as database, database:
        database.execute(f'DROP TABLE {name}')
        database.execute(endless.format(name))
    what = 'view' if 'VIEW' in endless else 'table with generated columns'
    with pytest.raises(BagError, match=f"'{name}' is a {what}, not a table as recorders write"):
        Bag(path)


def test_a_pipe_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / 'bag.mcap')
    for path in (tmp_path, tmp_path / 'bag.mcap'):
        with pytest.raises(BagError, match=r'bag\.mcap is not a regular file'):
            Bag(path)


def test_definitions_that_multiply_are_refused() -> None:
    levels = [f'MSG: x/T{i}\nT{i + 1}[100] a\nT{i + 1}[100] b' for i in range(9)]
    rule = '\n' + '=' * 80 + '\n'
    for definition, said in (
        (
            rule.join(['T0 a', *levels, 'MSG: x/T9\nuint8 a']),
            r'200{9}\d* members|members, at most',
        ),
        (rule.join(['T0[2000000] a', 'MSG: x/T0\n']), r'2000000 members, at most 1000000'),
        (rule.join(['T0[] a', 'MSG: x/T0\n']), 'a sequence of x/msg/T0, which has no content'),
        (rule.join(['T0 a', 'MSG: x/T0\nT0 b']), 'nests x/msg/T0 in itself'),
    ):
        with pytest.raises(BagError, match=said):
            check_definition(get_types_from_msg(definition, 'x/msg/A'), 'x/msg/A')
    plain = rule.join(['T0[1000] a\nuint8[4000000] image', 'MSG: x/T0\nfloat64[36] covariance'])
    check_definition(get_types_from_msg(plain, 'x/msg/A'), 'x/msg/A')


@pytest.mark.parametrize('writable', [True, False])
def test_messages_in_a_write_ahead_log_are_read(
    tmp_path: Path, writable: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As a killed recorder with the preset ``resilient`` leaves them."""
    whole = write_bag(tmp_path / 'whole', stereo_records(20), 'sqlite3')
    with Bag(whole) as bag:
        expected = sorted((m.topic.name, m.stamp_ns, m.cdr) for m in bag.messages())
    file = data_file(whole)
    rest = tmp_path / 'killed'
    rest.mkdir()
    with closing(sqlite3.connect(file)) as database:
        database.execute('PRAGMA journal_mode=WAL')
        database.execute('PRAGMA wal_autocheckpoint=0')
        rows = database.execute('SELECT * FROM messages WHERE id > 30').fetchall()
        database.execute('DELETE FROM messages WHERE id > 30')
        database.commit()
        database.execute('PRAGMA wal_checkpoint(TRUNCATE)')
        database.executemany(f'INSERT INTO messages VALUES ({",".join("?" * len(rows[0]))})', rows)
        database.commit()
        for part in file.parent.glob(f'{file.name}*'):
            if not part.name.endswith('-shm'):
                shutil.copy(part, rest)
    if not writable:
        monkeypatch.setattr('binocular_recon.io.bags.reader.can_be_read', lambda _: False)
    with Bag(rest) as bag:
        assert [topic.name for topic in bag.topics] == STEREO
        assert sorted((m.topic.name, m.stamp_ns, m.cdr) for m in bag.messages()) == expected
        assert bag.damage == []


def test_a_transaction_that_was_not_finished_is_undone(tmp_path: Path) -> None:
    path = write_bag(tmp_path / 'whole', stereo_records(20), 'sqlite3')
    with Bag(path) as bag:
        expected = [m.cdr for m in bag.messages()]
    file = data_file(path)
    rest = tmp_path / 'killed'
    rest.mkdir()
    with closing(sqlite3.connect(file)) as database:
        database.execute('PRAGMA cache_size=1')  # what is not committed goes to the file
        database.execute('UPDATE messages SET data = zeroblob(length(data))')
        for part in file.parent.glob(f'{file.name}*'):
            shutil.copy(part, rest)
    assert any(part.name.endswith('-journal') for part in rest.iterdir())
    with Bag(rest) as bag:
        assert [m.cdr for m in bag.messages()] == expected


def test_an_index_that_does_not_match_its_checksum_is_not_used(tmp_path: Path) -> None:
    path = write_bag(tmp_path / 'bag', stereo_records(20), 'mcap, chunks compressed')
    with Bag(path) as bag:
        expected = sorted(m.cdr for m in bag.messages())
    file = data_file(path)
    content = bytearray(file.read_bytes())
    (start,) = struct.unpack_from('<Q', content, len(content) - 28)
    struct.pack_into('<I', content, len(content) - 12, crc32(content[start:-12]))
    file.write_bytes(content)
    with Bag(path) as bag:
        assert sorted(m.cdr for m in bag.messages()) == expected
        assert bag.damage == []
    content[start + 200] ^= 4
    file.write_bytes(content)
    with Bag(path) as bag:
        assert sorted(m.cdr for m in bag.messages()) == expected
        (damage,) = bag.damage
        assert damage.startswith(f'{file} is damaged (its index does not match its checksum);')


def test_messages_that_the_index_lists_but_nobody_finds_are_said(tmp_path: Path) -> None:
    path = write_bag(tmp_path / 'bag', stereo_records(20), 'mcap')
    file = data_file(path)
    content = bytearray(file.read_bytes())
    chunk = content.index(b'\x06', 9)
    while struct.unpack_from('<Q', content, chunk + 1)[0] > len(content):
        chunk = content.index(b'\x06', chunk + 1)
    (size,) = struct.unpack_from('<Q', content, chunk + 1)
    content[chunk + 9 + 24 : chunk + 9 + 28] = bytes(4)  # no checksum of the chunk
    place, lost = chunk + 9 + 40, 0
    (length,) = struct.unpack_from('<I', content, chunk + 9 + 28)
    place += length
    while place < chunk + 9 + size and lost < 3:
        (length,) = struct.unpack_from('<Q', content, place + 1)
        if content[place] == 5 and length > 10000:  # an image
            content[place + 9] = 77  # a channel that does not exist
            lost += 1
        place += 9 + length
    file.write_bytes(content)
    with Bag(path) as bag:
        assert len(list(bag.messages())) == 77
        assert all('of the 20 messages on /' in sentence for sentence in bag.damage)
        assert 'image_raw that its index lists could be read' in bag.damage[0]


def test_damage_is_said_where_no_pair_remains(tmp_path: Path) -> None:
    path = write_bag(tmp_path / 'bag', stereo_records(1), 'sqlite3')
    with closing(sqlite3.connect(data_file(path))) as database, database:
        database.execute("UPDATE messages SET data = x'0001000001' WHERE length(data) > 15000")
    with Bag(path) as bag:
        frames = StereoBag(bag, find_stereo_topics(bag.topics))
        with pytest.raises(BagError, match=r'only one camera|no .*image_raw: message is damaged'):
            list(frames)
