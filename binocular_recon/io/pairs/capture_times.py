# SPDX-License-Identifier: Apache-2.0
"""When an image was taken: the time in its EXIF data, in JPEG, TIFF and PNG files.

Source: Exif 2.32 (CIPA DC-008), section 4.6: times are those of the camera's clock, with
fractions of a second and the offset from UTC in fields of their own.
"""

from __future__ import annotations

import re
import struct
from datetime import datetime, timedelta, timezone
from pathlib import Path

from binocular_recon.io.text_files import open_file

# The data stand at the beginning, in segments of at most 64 KiB.
_HEAD = 1 << 17
_SUB_IFD = 0x8769
# Tag of the time, of its fraction and of its offset from UTC, in order of preference.
_TIMES = ((0x9003, 0x9291, 0x9011), (0x9004, 0x9292, 0x9012), (0x0132, 0x9290, 0x9010))
_ASCII, _LONG = 2, 4
_MOST_ENTRIES = 512


def capture_time_ns(path: Path) -> int | None:
    """Return when an image was taken, ns since 1970; None if its file does not say.

    A time without an offset from UTC counts as UTC: it is compared with that of another camera.
    """
    try:
        with open_file(path) as file:
            block = _exif(file.read(_HEAD))
        return _time_ns(_texts(block)) if block else None
    except (OSError, struct.error, ValueError, LookupError, OverflowError):
        return None


def _exif(head: bytes) -> bytes:
    """Return the TIFF structure that holds the EXIF data, b'' if there is none."""
    if head[:4] in (b'II*\0', b'MM\0*'):
        return head
    if head.startswith(b'\x89PNG'):
        place = head.find(b'eXIf')
        return head[place + 4 :] if place > 0 else b''
    position = 2
    while head.startswith(b'\xff\xd8') and head[position] == 0xFF:
        (length,) = struct.unpack_from('>H', head, position + 2)
        if head[position + 1] == 0xE1 and head[position + 4 : position + 10] == b'Exif\0\0':
            return head[position + 10 : position + 2 + length]
        position += 2 + length
    return b''


def _texts(block: bytes) -> dict[int, str]:
    """Return the texts of the first directory and of the EXIF directory, by their tags."""
    order = '<' if block.startswith(b'II') else '>'
    (start,) = struct.unpack_from(order + 'I', block, 4)
    texts, numbers = _directory(block, order, start)
    if _SUB_IFD in numbers:
        texts |= _directory(block, order, numbers[_SUB_IFD])[0]
    return texts


def _directory(block: bytes, order: str, start: int) -> tuple[dict[int, str], dict[int, int]]:
    (count,) = struct.unpack_from(order + 'H', block, start)
    texts, numbers = {}, {}
    for entry in range(min(count, _MOST_ENTRIES)):
        place = start + 2 + 12 * entry
        tag, kind, size, value = struct.unpack_from(order + 'HHII', block, place)
        if kind == _ASCII:
            begin = place + 8 if size <= 4 else value
            texts[tag] = block[begin : begin + min(size, 64)].split(b'\0')[0].decode('ascii')
        elif kind == _LONG:
            numbers[tag] = value
    return texts, numbers


def _time_ns(texts: dict[int, str]) -> int | None:
    for time, fraction, offset in _TIMES:
        found = re.fullmatch(r'(\d{4}):(\d\d):(\d\d) (\d\d):(\d\d):(\d\d)', texts.get(time, ''))
        if found:
            zone = re.fullmatch(r'([+-])(\d\d):(\d\d)', texts.get(offset, ''))
            east = timedelta()
            if zone:
                east = timedelta(hours=int(zone[2]), minutes=int(zone[3]))
                east = -east if zone[1] == '-' else east
            year, month, day, hour, minute, second = map(int, found.groups())
            taken = datetime(year, month, day, hour, minute, second, tzinfo=timezone(east))
            digits = texts.get(fraction, '').strip()
            below_ns = int(digits[:9].ljust(9, '0')) if digits.isdecimal() else 0
            return int(taken.timestamp()) * 1_000_000_000 + below_ns
    return None
