# SPDX-License-Identifier: Apache-2.0
"""Find JPEG files that lost their end but are closed properly.

The decoder fills what is missing with grey and only warns on standard error, so nothing else would
notice.
"""

from __future__ import annotations

import struct

import numpy as np
import numpy.typing as npt

from binocular_recon.images import Image
from binocular_recon.io._jpeg_kernels import CODE_BITS, count_units
from binocular_recon.io.image_headers import jpeg_segments

_TABLES, _RESTART = 0xC4, 0xDD
_SEQUENTIAL, _PROGRESSIVE = (0xC0, 0xC1), 0xC2
_BLOCK = 8
# The decoder sets missing blocks to this grey.
_INVENTED, _TOLERANCE = 128, 2


def share_found(data: bytes, image: Image) -> float:
    """Return the share of a JPEG image that its file holds.

    Parameters
    ----------
    data : bytes
        The file.
    image : (H, W) or (H, W, 3) uint8
        What it was decoded to.

    Returns
    -------
    share : float
        1 if the last block is not the grey that stands for a missing one, or if files of this
        kind are not checked (arithmetic coding, sequential in several scans). Of a progressive
        file that lost whole scans, the share of the coefficients.

    """
    try:
        segments = jpeg_segments(data)
        frame = next(one for one in segments if one[0] in (*_SEQUENTIAL, _PROGRESSIVE))
        if frame[0] == _PROGRESSIVE:
            return _share_of_coefficients(data, frame[1])
        corner = image[-_BLOCK:, -_BLOCK:].astype(np.int16)
        if np.abs(corner - _INVENTED).max() > _TOLERANCE:
            return 1.0
        return _share_of_units(data, segments, frame[1])
    except (struct.error, LookupError, StopIteration, ValueError):
        return 1.0  # the decoder accepted it


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
    if data[scan] != count:
        raise ValueError('several scans')
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


def _share_of_coefficients(data: bytes, frame: int) -> float:
    """Return the share of the coefficients that the scans of a progressive file bring."""
    count = data[frame + 5]
    exact = np.zeros((count, _BLOCK**2), np.bool_)
    numbers = {data[frame + 6 + 3 * i]: i for i in range(count)}
    place = data.find(b'\xff\xda')
    while place >= 0:
        parts = data[place + 4]
        first, last, shift = data[place + 5 + 2 * parts : place + 8 + 2 * parts]
        for i in range(parts):
            exact[numbers[data[place + 5 + 2 * i]], first : last + 1] |= shift & 15 == 0
        place = data.find(b'\xff\xda', place + 2)
    return float(exact.mean())
