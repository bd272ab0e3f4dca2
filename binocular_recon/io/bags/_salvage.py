# SPDX-License-Identifier: Apache-2.0
"""Read a damaged bag file from its start up to the damage, without its index."""

from __future__ import annotations

import os
import struct
from binascii import crc32
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, NamedTuple

from rosbags.rosbag1.reader import Header, RecordType
from rosbags.typesys.msg import normalize_msgtype

from binocular_recon.errors import BagError
from binocular_recon.io.bags._decompression import (
    MOST_ROS1_BYTES,
    ZSTD_MAGIC,
    decompressed_message,
    unpack_chunk,
)
from binocular_recon.io.bags._sqlite import scan_tables

_MAGIC = {
    'mcap': b'\x89MCAP0\r\n',
    'sqlite3': b'SQLite format 3\0',
    'ros1': b'#ROSBAG V2.0\n',
}
_MCAP_FOOTER, _MCAP_SCHEMA, _MCAP_CHANNEL, _MCAP_MESSAGE, _MCAP_CHUNK = range(2, 7)
_MCAP_DATA_END = 15
_BLOCK = 1 << 20


class RawMessage(NamedTuple):
    """One message of a bag file; ``encoding`` is that of its bytes, as MCAP names it."""

    topic: str
    msgtype: str
    definition: str
    stamp_ns: int
    data: bytes
    encoding: str = 'cdr'


def file_format(path: Path) -> str:
    """Return ``mcap``, ``sqlite3`` or ``ros1``, by the first bytes of a file.

    Raises a BagError if the file is none of these or cannot be read.
    """
    try:
        with path.open('rb') as file:
            head = file.read(16)
    except OSError as error:
        raise BagError(f'{path} cannot be read: {error.strerror}') from error
    for name, magic in _MAGIC.items():
        if head.startswith(magic):
            return name
    raise BagError(
        f'{path} is not a bag: it begins with {head[:8]!r}; give a .mcap, .db3 or .bag file or the'
        ' folder that was recorded'
    )


def scan_messages(path: Path) -> Iterator[RawMessage]:
    """Yield the messages of a bag file in the order of the file.

    Parameters
    ----------
    path : Path
        MCAP, SQLite or ROS 1 file.

    Yields
    ------
    message : RawMessage
        At the damage, the decoder's error is raised; it may be of any type.

    Raises
    ------
    BagError
        If the file is not a bag or ends inside a record.

    """
    kind = file_format(path)
    messages: Iterator[RawMessage]
    if kind == 'sqlite3':
        messages = (RawMessage(*recorded) for recorded in scan_tables(path))
    else:
        messages = _scan_mcap(path) if kind == 'mcap' else _scan_ros1(path)
    for message in messages:
        compressible = message.encoding == 'cdr'
        yield (
            message._replace(data=decompressed_message(message.data)) if compressible else message
        )


def is_compressed(path: Path) -> bool:
    """Tell whether a whole file is compressed by zstd; False if it cannot be read."""
    try:
        with path.open('rb') as file:
            return file.read(4) == ZSTD_MAGIC
    except OSError:
        return False


def check_index(path: Path) -> None:
    """Raise a BagError if the index of an MCAP file does not match its checksum."""
    with path.open('rb') as file:
        size = file.seek(0, os.SEEK_END)
        file.seek(max(size - 37, 0))
        footer = file.read()
        kind, _, start, _, crc = struct.unpack_from('<BQQQI', footer)
        if kind == _MCAP_FOOTER and start and crc:
            file.seek(start)
            found, left = 0, size - 12 - start
            while left > 0 and (block := file.read(min(left, _BLOCK))):  # it may say any start
                found, left = crc32(block, found), left - len(block)
            if found != crc:
                raise BagError('its index does not match its checksum')


def _scan_mcap(path: Path) -> Iterator[RawMessage]:
    with path.open('rb') as file:
        file.seek(len(_MAGIC['mcap']))
        yield from _mcap_messages(file, {}, {})


def _mcap_messages(
    file: BinaryIO,
    schemas: dict[int, tuple[str, str]],
    channels: dict[int, tuple[str, str, str, str]],
) -> Iterator[RawMessage]:
    """Yield the messages of a file or, in recursion, of a chunk."""
    while head := file.read(9):
        kind, size = struct.unpack('<BQ', head)
        content = _read(file, size)
        if kind == _MCAP_DATA_END:
            return
        if kind == _MCAP_SCHEMA:
            (key,) = struct.unpack_from('<H', content)
            name = _mcap_string(content, 2)
            schemas[key] = name, _schema_text(content, 6 + len(name))
        elif kind == _MCAP_CHANNEL:
            key, schema = struct.unpack_from('<HH', content)
            topic = _mcap_string(content, 4)
            encoding = _mcap_string(content, 8 + len(topic.encode()))
            name, definition = schemas.get(schema, ('', ''))  # JSON may have none
            if encoding == 'ros1':
                name = str(normalize_msgtype(name))
            channels[key] = topic, name, definition, encoding
        elif kind == _MCAP_CHUNK:
            yield from _mcap_messages(BytesIO(_unpack_chunk(content)), schemas, channels)
        elif kind == _MCAP_MESSAGE:
            channel, _, stamp_ns = struct.unpack_from('<HIQ', content)
            topic, name, definition, encoding = channels[channel]
            yield RawMessage(topic, name, definition, stamp_ns, content[22:], encoding)


def _mcap_string(content: bytes, offset: int) -> str:
    (size,) = struct.unpack_from('<I', content, offset)
    return content[offset + 4 : offset + 4 + size].decode()


def _schema_text(content: bytes, offset: int) -> str:
    """Return the definition of a message, behind the encoding of its schema; '' if binary."""
    start = offset + 4 + len(_mcap_string(content, offset))
    (size,) = struct.unpack_from('<I', content, start)
    try:
        return content[start + 4 : start + 4 + size].decode()
    except UnicodeDecodeError:
        return ''


def _unpack_chunk(content: bytes) -> bytes:
    _, _, size, crc = struct.unpack_from('<QQQI', content)
    compression = _mcap_string(content, 28)
    chunk = unpack_chunk(compression, content[40 + len(compression) :], size)
    if crc and crc32(chunk) != crc:
        raise BagError('a chunk does not match its checksum')
    return chunk


def _scan_ros1(path: Path) -> Iterator[RawMessage]:
    with path.open('rb') as file:
        file.seek(len(_MAGIC['ros1']))
        yield from _ros1_messages(file, {})


def _ros1_messages(
    file: BinaryIO, connections: dict[int, tuple[str, str, str]]
) -> Iterator[RawMessage]:
    """Yield the messages of a file or, in recursion, of a chunk."""
    while length := file.read(4):
        header = _ros1_header(file, length)
        content = _read(file, struct.unpack('<I', _read(file, 4))[0])
        kind = header.get_uint8('op')
        if kind == RecordType.CHUNK:
            chunk = unpack_chunk(
                header.get_string('compression'),
                content,
                header.get_uint32('size'),
                MOST_ROS1_BYTES,
            )
            yield from _ros1_messages(BytesIO(chunk), connections)
        elif kind == RecordType.CONNECTION:
            fields = _ros1_header(BytesIO(content), struct.pack('<I', len(content)))
            connections[header.get_uint32('conn')] = (
                header.get_string('topic'),
                str(normalize_msgtype(fields.get_string('type'))),
                fields.get_string('message_definition'),
            )
        elif kind == RecordType.MSGDATA:
            connection = connections[header.get_uint32('conn')]
            yield RawMessage(*connection, header.get_time('time'), content, 'ros1')


def _ros1_header(file: BinaryIO, length: bytes) -> Header:
    (size,) = struct.unpack('<I', length)
    return Header.read(BytesIO(length + _read(file, size)))


def _read(file: BinaryIO, size: int) -> bytes:
    """Read ``size`` bytes, without allocating more than the file holds if the size is damaged."""
    here = file.tell()
    left = file.seek(0, os.SEEK_END) - here
    file.seek(here)
    if size > left:
        raise BagError(f'it ends at byte {here + left}, inside a record')
    return file.read(size)
