# SPDX-License-Identifier: Apache-2.0
"""Shared memory of Fast DDS: remove what killed processes left, and say if there is too little.

Each process reserves a segment in ``/dev/shm`` (`config/fastdds_shared_memory.xml`: 64 MiB). A
process that is killed leaves it there for good, and in a container there are 64 MB in all.
"""

from __future__ import annotations

import fcntl
import os
import re
import time
from contextlib import suppress
from pathlib import Path
from xml.etree import ElementTree as ET

FOLDER = Path('/dev/shm')  # noqa: S108 - that is where Fast DDS puts it
# The lock file of a segment: its owner holds the lock as long as it lives. Fast DDS 3, and 2.
_LOCK = re.compile(r'(fast(?:dds|rtps)_[0-9a-z]{16})_el')
# A process makes the lock file and then locks it; so old, its owner is not about to, s.
_LEAST_AGE_S = 10.0
PROFILE_VARIABLES = ('FASTDDS_DEFAULT_PROFILES_FILE', 'FASTRTPS_DEFAULT_PROFILES_FILE')
# Fast DDS without a profile, and what a segment takes besides what the profile says.
_DEFAULT_BYTES, _OVERHEAD = 512 * 1024, 1.1
_MIB = 1 << 20


def in_use() -> bool:
    """Tell whether ROS communicates by Fast DDS."""
    return 'fastrtps' in os.environ.get('RMW_IMPLEMENTATION', 'rmw_fastrtps_cpp')


def remove_leftovers(folder: Path = FOLDER) -> int:
    """Remove segments of dead processes of this user and return how many bytes that gave back.

    Like ``fastdds shm clean``: a process holds the lock of its segment until it ends, however.
    """
    freed = 0
    with suppress(OSError):
        for lock in folder.iterdir():
            found = _LOCK.fullmatch(lock.name)
            if found:
                with suppress(OSError):  # in use, of another user, or removed meanwhile
                    freed += _remove(lock, folder / found[1])
    return freed


def _remove(lock: Path, segment: Path) -> int:
    handle = os.open(lock, os.O_RDONLY | os.O_NOFOLLOW)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        stat = os.fstat(handle)
        if stat.st_uid != os.getuid() or time.time() - stat.st_mtime < _LEAST_AGE_S:
            return 0
        freed = 0
        with suppress(FileNotFoundError):
            freed = segment.stat().st_blocks * 512
            segment.unlink()
        lock.unlink()
        return freed
    finally:
        os.close(handle)


def shortage(folder: Path = FOLDER) -> str:
    """Return why this process gets no shared memory, and the remedy; '' if it gets it."""
    try:
        disk = os.statvfs(folder)
    except OSError as error:
        return f'{folder} cannot be used ({error.strerror}): images go through the network stack'
    needed, free = segment_bytes() * _OVERHEAD, disk.f_bavail * disk.f_frsize
    if free >= needed:
        return ''
    size = disk.f_blocks * disk.f_frsize
    return (
        f'{folder} has {free / _MIB:.0f} of {size / _MIB:.0f} MiB free, and each process takes'
        f' {needed / _MIB:.0f} MiB: images go through the network stack, which is slower and may'
        ' lose large ones; give a container more (docker run --shm-size=1g, or --ipc=host), or end'
        ' processes that use it'
    )


def segment_bytes() -> int:
    """Return the size of the segment that the profile in use gives each process."""
    path = next((os.environ[name] for name in PROFILE_VARIABLES if os.environ.get(name)), '')
    with suppress(OSError, ET.ParseError, ValueError):
        for element in ET.parse(path).iter():  # noqa: S314 - the user's own file
            if element.tag.rpartition('}')[2] == 'segment_size':
                return int(element.text or '')
    return _DEFAULT_BYTES
