# SPDX-License-Identifier: Apache-2.0
"""Decompress parts of bags without exceeding what a message may hold.

A few kilobytes can claim gigabytes. rosbags decompresses chunks without a limit, so its functions
are replaced by these, for all readers of the process.
"""

from __future__ import annotations

import bz2
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import lz4.frame  # type: ignore[import-untyped]
from rosbags.rosbag1 import reader as rosbag1_reader
from rosbags.rosbag2 import reader as rosbags_reader  # it knows this Python's zstd
from rosbags.rosbag2.storage_mcap import DECOMPRESSORS

from binocular_recon.errors import BagError

# First bytes of what zstd compressed; those of a CDR message begin with a zero.
ZSTD_MAGIC = b'\x28\xb5\x2f\xfd'
# Most bytes of a message, and of a chunk with messages: a colour image of 170 MP.
MOST_BYTES = 2**29
# The same for chunks of ROS 1, whose usual size is 0.75 MB: bz2 is slow.
MOST_ROS1_BYTES = 2**27
# A whole file may grow to this size, or by this factor if that is more.
MOST_FILE_BYTES, MOST_FILE_GROWTH = 2**30, 200
_BLOCK = 2**20

_zstd: Any = rosbags_reader.zstd  # type: ignore[attr-defined]
_ERRORS = (EOFError, OSError, RuntimeError, _zstd.ZstdError)


def decompressed_message(cdr: bytes) -> bytes:
    """Return a ROS 2 message, decompressed if its recorder compressed it.

    Raises a BagError if it is damaged or larger than `MOST_BYTES`.
    """
    return unpack_zstd(cdr) if cdr.startswith(ZSTD_MAGIC) else cdr


def unpack_zstd(data: bytes, most: int = MOST_BYTES) -> bytes:
    """Decompress zstd frames; raises a BagError if they are damaged or larger than ``most``."""
    return _unpack('zstd', _zstd.ZstdDecompressor, data, most)


def unpack_chunk(compression: str, data: bytes, size: int, most: int = MOST_BYTES) -> bytes:
    """Decompress a chunk that states its size.

    Raises
    ------
    BagError
        If the chunk is damaged, larger than it states or than ``most``, or compressed in an
        unknown way.

    """
    if compression in ('', 'none'):
        return data
    if compression not in _STREAMS:
        raise BagError(
            f'a chunk is compressed by {compression!r}; {", ".join(_STREAMS)} can be read'
        )
    if size > most:
        raise BagError(f'a chunk claims {size} bytes, at most {most} are read')
    return _unpack(compression, _STREAMS[compression], data, size)


def unpack_file(path: Path, folder: Path) -> Path:
    """Decompress a file by zstd into a folder.

    Raises a BagError if it is damaged, too large or does not fit.
    """
    target = folder / path.stem
    most = max(MOST_FILE_BYTES, MOST_FILE_GROWTH * path.stat().st_size)
    most = min(most, shutil.disk_usage(folder).free)
    written = 0
    try:
        with _zstd.open(path, 'rb') as packed, target.open('wb') as file:
            while block := packed.read(_BLOCK):
                written += file.write(block)
                if written > most:
                    raise BagError(
                        f'{path} grows beyond {most} bytes, which is implausible or more than the'
                        f' disk of {folder} holds; decompress it by hand if it is right'
                    )
    except _ERRORS as error:
        raise BagError(
            f'{path} cannot be decompressed into {folder}: {error}; repair it, or free the disk'
        ) from error
    return target


def _unpack(name: str, stream: Callable[[], Any], data: bytes, most: int) -> bytes:
    """Decompress all streams of ``data`` to at most ``most`` bytes."""
    parts, size = [], 0
    try:
        while data:
            decompressor = stream()
            part = decompressor.decompress(data, most - size + 1)
            size += len(part)
            if size > most:
                raise BagError(
                    f'{len(data)} bytes compressed by {name} hold more than {most}, all that they'
                    ' may'
                )
            if not decompressor.eof:
                raise BagError(f'data compressed by {name} are cut off')
            parts.append(part)
            data = decompressor.unused_data or b''
    except _ERRORS as error:
        raise BagError(f'data compressed by {name} are damaged: {error}') from error
    return parts[0] if len(parts) == 1 else b''.join(parts)


_STREAMS: dict[str, Callable[[], Any]] = {
    'zstd': _zstd.ZstdDecompressor,
    'lz4': lz4.frame.LZ4FrameDecompressor,
    'bz2': bz2.BZ2Decompressor,
}


def _of_mcap(compression: str) -> Callable[[bytes, int], bytes]:
    return lambda data, size: unpack_chunk(compression, data, size)


def _of_ros1(compression: str) -> Callable[[bytes], bytes]:
    return lambda data: _unpack(compression, _STREAMS[compression], data, MOST_ROS1_BYTES)


DECOMPRESSORS.update({name: _of_mcap(name) for name in ('lz4', 'zstd')})
rosbag1_reader.decompressors.update({name: _of_ros1(name) for name in ('bz2', 'lz4')})
