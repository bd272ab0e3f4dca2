# SPDX-License-Identifier: Apache-2.0
"""MAT-files of version 5 to 7, read with bounds.

Source: MathWorks, "MAT-File Format". scipy's reader ends the process on damaged files (bus
error), which a node must survive.
"""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Iterator
from typing import Any

import numpy as np

_HEADER_BYTES = 128
_MATRIX, _COMPRESSED = 14, 15
_NUMBERS = {
    1: 'i1', 2: 'u1', 3: 'i2', 4: 'u2', 5: 'i4', 6: 'u4', 7: 'f4', 9: 'f8', 12: 'i8', 13: 'u8',
}  # fmt: skip
_TEXTS = {16: 'utf-8', 17: 'utf-16', 18: 'utf-32'}
# Classes of arrays: structures, text, and full matrices of numbers.
_STRUCTURE, _TEXT, _NUMERIC = 2, 4, range(6, 16)
_MOST_DEPTH, _MOST_BYTES = 8, 64 << 20


def read_mat(data: bytes) -> dict[str, Any]:
    """Return the variables of a MAT-file.

    Parameters
    ----------
    data : bytes
        Content of the file.

    Returns
    -------
    dict
        Structures as dicts, text as str, numbers as arrays of their shape; None for anything
        else, such as objects and cells.

    Raises
    ------
    ValueError
        If the file is damaged or of another version.

    """
    order = {b'IM': '<', b'MI': '>'}.get(data[126:128])
    if order is None:
        raise ValueError('it has no header of a MAT-file of version 5 to 7')
    variables: dict[str, Any] = {}
    for kind, content in _elements(data[_HEADER_BYTES:], order):
        if kind == _COMPRESSED:
            inner = _inflated(content)
            variables.update(
                _array(part, order, 0) for one, part in _elements(inner, order) if one == _MATRIX
            )
        elif kind == _MATRIX:
            variables.update([_array(content, order, 0)])
    return variables


def _inflated(content: bytes) -> bytes:
    machine = zlib.decompressobj()
    try:
        inner = machine.decompress(content, _MOST_BYTES)
    except zlib.error as error:
        raise ValueError(str(error)) from error
    if not machine.eof:
        raise ValueError('a variable is cut off, or has more than 64 MB')
    return inner


def _elements(data: bytes, order: str) -> Iterator[tuple[int, bytes]]:
    """Yield type and content of each data element."""
    at = 0
    while at + 8 <= len(data):
        kind, size = struct.unpack_from(f'{order}II', data, at)
        if kind >> 16 and kind & 0xFFFF:  # small: size and type share four bytes
            kind, size, begin = kind & 0xFFFF, kind >> 16, at + 4
            at += 8
        else:
            begin = at + 8
            at = begin + size + (-size % 8 if kind != _COMPRESSED else 0)
        if size > len(data) - begin:
            raise ValueError(f'it is cut off: {size} bytes are stated, {len(data) - begin} follow')
        yield kind, data[begin : begin + size]


def _array(data: bytes, order: str, depth: int) -> tuple[str, Any]:
    """Return name and value of an array."""
    if depth > _MOST_DEPTH:
        raise ValueError(f'its structures are nested more than {_MOST_DEPTH} times')
    parts = list(_elements(data, order))
    if not parts:  # an empty array may have nothing
        return '', None
    if len(parts) < 3:
        raise ValueError('an array has no flags, size and name')
    flags = _numbers(parts[0], order)
    shape = [int(side) for side in _numbers(parts[1], order)]
    name = parts[2][1].decode('latin-1')
    kind, rest = int(flags[0]) & 0xFF if flags.size else 0, parts[3:]
    if kind == _STRUCTURE and math.prod(shape) == 1:
        return name, _structure(rest, order, depth)
    if kind == _TEXT:
        return name, _text(rest[0], order) if rest else ''
    if kind in _NUMERIC:
        values = _numbers(rest[0], order) if rest else np.zeros(0)
        if min(shape, default=0) < 0 or values.size != math.prod(shape):
            raise ValueError(f'an array of {shape} has {values.size} values')
        return name, values.reshape(shape, order='F')
    return name, None


def _structure(parts: list[tuple[int, bytes]], order: str, depth: int) -> dict[str, Any]:
    if len(parts) < 2 or not (length := _numbers(parts[0], order)).size or int(length[0]) < 1:
        raise ValueError('a structure has no names')
    size, text = int(length[0]), parts[1][1]
    names = [
        text[at : at + size].split(b'\0')[0].decode('latin-1') for at in range(0, len(text), size)
    ]
    if len(names) != len(parts) - 2:
        raise ValueError(f'a structure of {len(names)} names has {len(parts) - 2} values')
    values = (_array(content, order, depth + 1)[1] for _, content in parts[2:])
    return dict(zip(names, values, strict=True))


def _numbers(part: tuple[int, bytes], order: str) -> Any:
    kind, content = part
    if kind not in _NUMBERS:
        raise ValueError(f'numbers are stored as type {kind}, which there is not')
    dtype = np.dtype(order + _NUMBERS[kind])
    if len(content) % dtype.itemsize:
        raise ValueError(f'{len(content)} bytes are no whole number of values')
    return np.frombuffer(content, dtype)


def _text(part: tuple[int, bytes], order: str) -> str:
    kind, content = part
    if kind in _TEXTS:
        ending = '' if kind == 16 else '-le' if order == '<' else '-be'
        return content.decode(_TEXTS[kind] + ending, 'replace')
    return ''.join(chr(int(code) & 0xFFFF) for code in _numbers(part, order)[:1000])
