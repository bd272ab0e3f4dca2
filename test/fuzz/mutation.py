# SPDX-License-Identifier: Apache-2.0
"""Change inputs at random, the same way for the same number."""

from __future__ import annotations

import random
import re
import struct
from collections.abc import Callable, Sequence

_NUMBER = re.compile(rb'-?\d+(\.\d*)?([eE][-+]?\d+)?')
_NUMBERS = (
    b'0', b'-1', b'1', b'nan', b'.nan', b'inf', b'-.inf', b'1e308', b'-1e308', b'1e-308', b'1e999',
    b'2147483647', b'4294967296', b'18446744073709551616', b'9' * 400, b'1_0', b'0x7fffffff',
    b'1:1:1', b'true', b'null', b'~', b'""', b'[]', b'{}', b'"text"', b'2001-01-01', b'0.5',
)  # fmt: skip
# Pieces of YAML, JSON, CSV, PFM headers and of names.
_TOKENS = (
    b'[', b']', b'{', b'}', b':', b': ', b',', b'- ', b'? ', b'&a ', b'*a', b'<<: ', b'!!binary ',
    b'!!set ', b'!!python/name:os.system ', b'!!float ', b'!!int ', b'|\n', b'>\n', b'---\n', b'#',
    b'"', b"'", b'\\', b'\n', b'\r', b'\t', b'\0', b'\x1b[2J', b'\xff\xfe', b'\xef\xbb\xbf',
    b'\xe2\x80\xae', b'%s', b'../', b'/', b' ', b'PF\n', b'Pf\n', b'-1.0\n', b'1e', b'--', b'=',
)  # fmt: skip
_DOUBLES = (0.0, -0.0, 1.0, -1.0, 1e-300, 1e300, 1e38, float('nan'), float('inf'), float('-inf'))
_WHOLE = (0, 1, 2, 7, 0x7F, 0x80, 0xFF, 0x7FFF, 0xFFFF, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF)
# Longest input that mutations make, bytes.
_LONGEST = 300_000


def mutated(data: bytes, others: Sequence[bytes], generator: random.Random) -> bytes:
    """Return ``data`` after one to eight changes; some take pieces of ``others``."""
    for _ in range(generator.choice((1, 1, 1, 2, 2, 4, 8))):
        data = generator.choice(_CHANGES)(data, others, generator)
    return data[:_LONGEST]


def _place(data: bytes, generator: random.Random, align: int = 1) -> int:
    return generator.randrange(len(data) // align + 1) * align


def _flip(data: bytes, _: Sequence[bytes], generator: random.Random) -> bytes:
    if not data:
        return data
    changed = bytearray(data)
    changed[generator.randrange(len(data))] ^= 1 << generator.randrange(8)
    return bytes(changed)


def _overwrite(data: bytes, _: Sequence[bytes], generator: random.Random) -> bytes:
    """Put a limit of a number type at an aligned place."""
    size = generator.choice((1, 2, 4, 4, 8, 8))
    if size == 8:
        value = struct.pack('<d', generator.choice(_DOUBLES))
    else:
        value = (generator.choice(_WHOLE) & (1 << 8 * size) - 1).to_bytes(size, 'little')
    place = _place(data, generator, size)
    return data[:place] + value + data[place + size :]


def _remove(data: bytes, _: Sequence[bytes], generator: random.Random) -> bytes:
    first = _place(data, generator)
    return data[:first] + data[first + generator.randrange(1, 40) :]


def _cut(data: bytes, _: Sequence[bytes], generator: random.Random) -> bytes:
    return data[: _place(data, generator)]


def _repeat(data: bytes, _: Sequence[bytes], generator: random.Random) -> bytes:
    first = _place(data, generator)
    piece = data[first : first + generator.choice((1, 2, 8, 40, 200))]
    return data[:first] + piece * generator.choice((2, 3, 10, 100, 2000)) + data[first:]


def _insert(data: bytes, _: Sequence[bytes], generator: random.Random) -> bytes:
    place = _place(data, generator)
    token = generator.choice(_TOKENS) * generator.choice((1, 1, 1, 2, 100, 5000))
    return data[:place] + token + data[place:]


def _number(data: bytes, _: Sequence[bytes], generator: random.Random) -> bytes:
    """Replace a number of a text."""
    found = list(_NUMBER.finditer(data[:20_000]))
    if not found:
        return data
    match = generator.choice(found)
    return data[: match.start()] + generator.choice(_NUMBERS) + data[match.end() :]


def _line(data: bytes, _: Sequence[bytes], generator: random.Random) -> bytes:
    """Drop a line of a text, or put it elsewhere."""
    lines = data.splitlines(keepends=True)
    if not lines:
        return data
    line = lines.pop(generator.randrange(len(lines)))
    if generator.random() < 0.5:
        lines.insert(generator.randrange(len(lines) + 1), line)
    return b''.join(lines)


def _splice(data: bytes, others: Sequence[bytes], generator: random.Random) -> bytes:
    other = generator.choice(others)
    return data[: _place(data, generator)] + other[_place(other, generator) :]


_CHANGES: tuple[Callable[[bytes, Sequence[bytes], random.Random], bytes], ...] = (
    _flip, _flip, _overwrite, _overwrite, _remove, _cut, _repeat, _insert, _number, _number, _line,
    _splice,
)  # fmt: skip
