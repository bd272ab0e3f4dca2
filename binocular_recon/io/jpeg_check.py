# SPDX-License-Identifier: Apache-2.0
"""Find JPEG files that lost a part but are closed properly.

The decoder fills what is missing with grey, or leaves it coarse, and only warns on standard error.
Its warning tells that something is wrong, a look at the file what is missing.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from binocular_recon.io._jpeg_kernels import CODE_BITS, count_units
from binocular_recon.io.image_headers import jpeg_scans, jpeg_segments

_TABLES, _RESTART = 0xC4, 0xDD
_SEQUENTIAL, _PROGRESSIVE = (0xC0, 0xC1), 0xC2
_BLOCK = 8
_WARNING = re.compile('Corrupt JPEG|Premature end of JPEG')
# Cameras that write too much before the end marker are common; nothing is missing.
_HARMLESS = re.compile('extraneous bytes before marker 0xd9')


def loss(data: bytes, warnings: Sequence[str] | None) -> str:
    """Return what a JPEG file has lost.

    Parameters
    ----------
    data : bytes
        The file.
    warnings : sequence of str or None
        What the decoder wrote to standard error; None if that is not known.

    Returns
    -------
    text : str
        What follows "its N bytes of JPEG"; '' if nothing is missing, or if it cannot be told: in
        files with arithmetic coding the decoder does not notice it.

    """
    warned = [text for text in warnings or () if _WARNING.match(text)]
    try:
        segments = jpeg_segments(data)
        frame = next(one for one in segments if one[0] in (*_SEQUENTIAL, _PROGRESSIVE))
        scan = segments[-1][1]
        if frame[0] == _PROGRESSIVE or data[scan] < data[frame[1] + 5]:
            share = _share_of_coefficients(data, frame[1], scan)
            harmful = [text for text in warned if not _HARMLESS.search(text)]
            if share == 1 and harmful:
                return f'are damaged ({harmful[0]})'
        else:
            share = (
                _share_of_units(data, segments, frame[1]) if warned or warnings is None else 1.0
            )
    except (struct.error, LookupError, StopIteration, ValueError):
        return ''  # the decoder accepted it
    return f'hold {share:.0%} of the image' if share < 1 else ''


def _share_of_units(data: bytes, segments: list[tuple[int, int, int]], frame: int) -> float:
    _, start, end = segments[-1]
    units, blocks = _coded_units(data, frame, start)
    restart = 0
    for marker, content, _ in segments:
        if marker == _RESTART:
            (restart,) = struct.unpack_from('>H', data, content)
    tables = _huffman_tables(data, [one for one in segments if one[0] == _TABLES])
    scan = np.frombuffer(data, np.uint8)[end:]
    return int(count_units(scan, tables, blocks, restart, units)) / units


def _coded_units(data: bytes, frame: int, scan: int) -> tuple[int, npt.NDArray[np.uint8]]:
    """Return the number of coded units, and the tables of the blocks of one."""
    _, height, width, count = struct.unpack_from('>BHHB', data, frame)
    sampling = {
        data[place]: (data[place + 1] >> 4, data[place + 1] & 15)
        for place in range(frame + 6, frame + 6 + 3 * count, 3)
    }
    blocks = []
    for place in range(scan + 1, scan + 1 + 2 * count, 2):
        x, y = sampling[data[place]]
        first, others = data[place + 1] >> 4, data[place + 1] & 15
        blocks += [(first, 4 + others)] * (x * y if count > 1 else 1)
    across, down = (max(one) if count > 1 else 1 for one in zip(*sampling.values(), strict=True))
    columns, rows = -(-width // (_BLOCK * across)), -(-height // (_BLOCK * down))
    return columns * rows, np.array(blocks, np.uint8)


def _huffman_tables(data: bytes, segments: list[tuple[int, int, int]]) -> npt.NDArray[np.uint16]:
    """Return the tables by the next 16 bits: four of first coefficients, four of the others."""
    tables = np.zeros((8, 1 << CODE_BITS), np.uint16)
    for _, place, end in segments:
        while place < end:
            kind, number = data[place] >> 4, data[place] & 3
            counts, symbols = data[place + 1 : place + 17], place + 17
            code = 0
            for length, count in enumerate(counts, start=1):
                step = 1 << (CODE_BITS - length)
                for symbol in data[symbols : symbols + count]:
                    tables[4 * (kind > 0) + number, code : code + step] = length << 8 | symbol
                    code += step
                symbols += count
            place = symbols
    return tables


def _share_of_coefficients(data: bytes, frame: int, scan: int) -> float:
    """Return the share of the coefficients that the scans of a file with several bring."""
    count = data[frame + 5]
    exact = np.zeros((count, _BLOCK**2), np.bool_)
    numbers = {data[frame + 6 + 3 * i]: i for i in range(count)}
    for place in jpeg_scans(data, scan):
        parts = data[place]
        first, last, shift = data[place + 1 + 2 * parts : place + 4 + 2 * parts]
        for i in range(parts):
            exact[numbers[data[place + 1 + 2 * i]], first : last + 1] |= shift & 15 == 0
    return float(exact.mean())
