# SPDX-License-Identifier: Apache-2.0
"""What image files claim in their first bytes, before anything is decoded or allocated."""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Iterator
from typing import NamedTuple

from binocular_recon.errors import ImageError

# Most pixels of an image, and most bytes of it once decoded.
MOST_PIXELS, MOST_BYTES = 2**27, 2**29
# More pixels than this cannot be compressed into a byte: a block of 8 x 8 takes a bit or more.
_JPEG_PIXELS_PER_BYTE = 1024
# Deflate shrinks to 1/1032 at best.
_PNG_GROWTH = 1040
_CHANNELS = {0: 1, 2: 3, 3: 4, 4: 2, 6: 4}  # by the colour type of PNG; 3: what a palette holds
# More parts no encoder writes, and each takes time: every scan of a JPEG that of the whole image.
_MOST_SEGMENTS, _MOST_CHUNKS, _MOST_SCANS = 1024, 1 << 17, 64
# Of all Huffman tables before the first scan; a whole set has 2 kB.
_MOST_TABLE_BYTES = 1 << 16
_TABLES, _SCAN, _END = 0xC4, 0xDA, 0xD9
_PROGRESSIVE = (0xC2, 0xCA)
_FILL = re.compile(rb'\xff+')
# In coded data FF is followed by 0, and restart markers belong to them.
_MARKER = re.compile(rb'\xff[^\x00\xff\xd0-\xd7]')
# As OpenCV reads it: other programs may find other numbers where a comment touches one.
_SPACE = rb'\s(?:\s|#[^\r\n]*[\r\n])*'
_PNM = re.compile(rb'P([1-6Ff])' + _SPACE + rb'(\d{1,10})' + _SPACE + rb'(\d{1,10})\s')
# Least bytes of eight pixels by the kind of PNM.
_PNM_BYTES = {b'1': 8, b'2': 8, b'3': 24, b'4': 1, b'5': 8, b'6': 24, b'f': 32, b'F': 96}
# Kinds of whole numbers in TIFF that are read; a size of another kind is refused.
_TIFF_KINDS = {1: 'B', 3: 'H', 4: 'I', 16: 'Q'}
_FORMATS = 'PNG, JPEG, TIFF, BMP, WebP, JPEG 2000 and PNM'


class ImageHeader(NamedTuple):
    """What the header of an image file claims.

    Attributes
    ----------
    format : str
        Name of the format.
    width, height : int
        Size, px.
    pixel_bytes : int
        Bytes of a decoded pixel; 3 if the format does not say.
    least_bytes : int
        Bytes that the smallest file of such an image has.

    """

    format: str
    width: int
    height: int
    pixel_bytes: int = 3
    least_bytes: int = 0


def read_header(data: bytes) -> ImageHeader:
    """Read the header of an image file, and check that it is plausible.

    Parameters
    ----------
    data : bytes
        The whole file: PNG, JPEG, TIFF, BMP, WebP, JPEG 2000 or PNM.

    Raises
    ------
    ImageError
        If the format is another one, the header is damaged, or the image that it claims is larger
        than `MOST_PIXELS` or `MOST_BYTES`, or cannot be in so few bytes. The message has no
        subject.

    """
    for magic, read in _READERS:
        if data.startswith(magic):
            try:
                header = read(data)
            except ImageError:
                raise
            except (struct.error, LookupError, ValueError) as error:
                raise ImageError(
                    f'is truncated or has a damaged header ({len(data)} bytes)'
                ) from error
            _check(header, len(data))
            return header
    raise ImageError(f'is not an image ({len(data)} bytes); {_FORMATS} are read')


def _check(header: ImageHeader, size: int) -> None:
    kind, width, height, pixel_bytes, least_bytes = header
    if width <= 0 or height <= 0:
        raise ImageError(f'has a damaged header: a {kind} of {width}x{height} px')
    if width * height > MOST_PIXELS or width * height * pixel_bytes > MOST_BYTES:
        raise ImageError(
            f'claims {width}x{height} px; at most {MOST_PIXELS >> 20} * 2^20 pixels and'
            f' {MOST_BYTES >> 20} MiB of them are decoded'
        )
    if size < least_bytes:
        raise ImageError(
            f'claims {width}x{height} px as {kind}, which takes at least {least_bytes} bytes, and'
            f' holds {size}; it is damaged'
        )


def _png(data: bytes) -> ImageHeader:
    width, height, depth, colour = struct.unpack_from('>IIBB', data, 16)
    channels = _CHANNELS.get(colour, 0)
    raw = height * (1 + -(-width * (1 if colour == 3 else channels) * depth // 8))
    samples = max(channels, 1) * (2 if depth == 16 else 1)
    _check_chunks(data)
    return ImageHeader('PNG', width, height, samples, raw // _PNG_GROWTH)


def _check_chunks(data: bytes) -> None:
    """Raise an error unless all chunks of a PNG lie in it: the decoder allocates what they claim.

    libpng checks the rest of them.
    """
    place = 8
    for _ in range(_MOST_CHUNKS):
        length, kind = struct.unpack_from('>I4s', data, place)
        place += 12 + length
        if place > len(data):
            raise ImageError(
                f'is truncated: a chunk claims {length} bytes, the file has {len(data)}'
            )
        if kind == b'IEND':
            return
    raise ImageError(f'has more than {_MOST_CHUNKS} chunks; no encoder writes so many')


def _jpeg(data: bytes) -> ImageHeader:
    segments = jpeg_segments(data)
    tables = sum(end - start for marker, start, end in segments if marker == _TABLES)
    if tables > _MOST_TABLE_BYTES:
        raise ImageError(f'has {tables} bytes of Huffman tables, at most {_MOST_TABLE_BYTES}')
    for marker, position, _ in segments:
        if 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC):
            height, width, channels = struct.unpack_from('>HHB', data, position + 1)
            least = width * height // _JPEG_PIXELS_PER_BYTE
            scan = segments[-1][1]
            if marker in _PROGRESSIVE or data[scan] < channels:
                for count, _ in enumerate(jpeg_scans(data, scan), start=1):
                    if count > _MOST_SCANS:
                        raise ImageError(
                            f'has more than {_MOST_SCANS} scans; no encoder writes so many'
                        )
            return ImageHeader('JPEG', width, height, max(channels, 1), least)
    raise ValueError('no frame')


def jpeg_segments(data: bytes) -> list[tuple[int, int, int]]:
    """Return marker, start and end of the content of each segment up to the first scan's header.

    Raises a ValueError, LookupError or struct.error if they are damaged or too many.
    """
    segments: list[tuple[int, int, int]] = []
    position = 2
    while True:
        fill = _FILL.match(data, position)  # any number of these may precede a marker
        if fill is None or len(segments) == _MOST_SEGMENTS:
            raise ValueError('no marker')
        position = fill.end() - 1
        marker = data[position + 1]
        (length,) = struct.unpack_from('>H', data, position + 2)
        end = position + 2 + length
        if length < 2 or end > len(data):
            raise ValueError('a segment is cut off')
        segments.append((marker, position + 4, end))
        if marker == _SCAN:
            return segments
        position = end


def jpeg_scans(data: bytes, first: int) -> Iterator[int]:
    """Yield where the content of each scan's header begins.

    Raises a ValueError if there are too many segments, as `jpeg_segments` if they are damaged.

    Parameters
    ----------
    data : bytes
        The whole file.
    first : int
        Where that of the first scan begins.

    """
    place, marker = first, _SCAN
    for _ in range(_MOST_SEGMENTS):
        if marker == _END:
            return
        if marker == _SCAN:
            yield place
        (length,) = struct.unpack_from('>H', data, place - 2)
        found = _MARKER.search(data, place - 2 + length)
        if found is None:
            return
        place, marker = found.end() + 2, data[found.end() - 1]
    raise ValueError('too many segments')


def _tiff(data: bytes) -> ImageHeader:
    order = '<' if data.startswith(b'II') else '>'
    big = struct.unpack_from(order + 'H', data, 2)[0] == 43
    (start,) = struct.unpack_from(order + ('Q' if big else 'I'), data, 8 if big else 4)
    (count,) = struct.unpack_from(order + ('Q' if big else 'H'), data, start)
    size, inline = (20, 12) if big else (12, 8)
    first = start + (8 if big else 2)
    values = {}
    for entry in range(first, first + size * min(count, 4096), size):
        tag, kind = struct.unpack_from(order + 'HH', data, entry)
        if tag in (256, 257, 258, 277):
            if tag in values or kind not in _TIFF_KINDS:
                raise ValueError('stated twice, or not by a whole number')
            many = struct.unpack_from(order + ('Q' if big else 'I'), data, entry + 4)[0] > 2
            place = entry + inline
            if tag == 258 and many and not big:  # bits of three or more channels stand elsewhere
                (place,) = struct.unpack_from(order + 'I', data, place)
            (values[tag],) = struct.unpack_from(order + _TIFF_KINDS[kind], data, place)
    pixel_bytes = values.get(277, 1) * -(-values.get(258, 8) // 8)
    return ImageHeader('TIFF', values.get(256, 0), values.get(257, 0), max(pixel_bytes, 1))


def _bmp(data: bytes) -> ImageHeader:
    (size,) = struct.unpack_from('<I', data, 14)
    width, height = struct.unpack_from('<HH' if size == 12 else '<ii', data, 18)
    return ImageHeader('BMP', width, abs(height))


def _webp(data: bytes) -> ImageHeader:
    kind = data[12:16]
    if data[8:12] != b'WEBP':
        raise ValueError('no WebP')
    if kind == b'VP8X':
        width, height = (int.from_bytes(data[i : i + 3], 'little') + 1 for i in (24, 27))
    elif kind == b'VP8L':
        (bits,) = struct.unpack_from('<I', data, 21)
        width, height = (bits & 0x3FFF) + 1, (bits >> 14 & 0x3FFF) + 1
    else:
        width, height = (value & 0x3FFF for value in struct.unpack_from('<HH', data, 26))
    return ImageHeader('WebP', width, height, 4)


def _jpeg_2000(data: bytes) -> ImageHeader:
    start = 0 if data.startswith(b'\xff\x4f') else _codestream(data)
    if data[start : start + 4] != b'\xff\x4f\xff\x51':
        raise ValueError('no codestream')
    right, bottom, left, top = struct.unpack_from('>IIII', data, start + 8)
    (channels,) = struct.unpack_from('>H', data, start + 40)
    if not 1 <= channels <= 4:
        raise ValueError('no image')
    return ImageHeader('JPEG 2000', right - left, bottom - top, 2 * channels)


def _codestream(data: bytes) -> int:
    """Return where the codestream in the boxes of a file begins."""
    place = 0
    for _ in range(_MOST_SEGMENTS):
        length, kind, long = struct.unpack_from('>I4sQ', data, place)
        head = 16 if length == 1 else 8
        if kind == b'jp2c':
            return place + head
        place += max(long if length == 1 else length, head)
    raise ValueError('no codestream')


def _pnm(data: bytes) -> ImageHeader:
    if data.startswith(b'P7'):
        words = data[:1024].split()
        if any(words.count(name) > 1 for name in (b'WIDTH', b'HEIGHT', b'DEPTH')):
            raise ValueError('stated twice')
        fields = dict(zip(words[1::2], words[2::2], strict=False))
        width, height = int(fields[b'WIDTH']), int(fields[b'HEIGHT'])
        return ImageHeader('PAM', width, height, int(fields[b'DEPTH']) * 2)
    found = _PNM.match(data[:1024])
    if found is None:
        raise ValueError('no size')
    kind, width, height = found[1], int(found[2]), int(found[3])
    least = width * height * _PNM_BYTES[kind] // 8
    return ImageHeader('PNM', width, height, 12 if kind == b'F' else 6, least)


_READERS: list[tuple[bytes | tuple[bytes, ...], Callable[[bytes], ImageHeader]]] = [
    (b'\x89PNG\r\n\x1a\n', _png),
    (b'\xff\xd8', _jpeg),
    ((b'II*\0', b'MM\0*', b'II+\0', b'MM\0+'), _tiff),
    (b'BM', _bmp),
    (b'RIFF', _webp),
    ((b'\0\0\0\x0cjP  ', b'\xff\x4f\xff\x51'), _jpeg_2000),
    (tuple(b'P' + kind for kind in (b'1', b'2', b'3', b'4', b'5', b'6', b'7', b'F', b'f')), _pnm),
]
