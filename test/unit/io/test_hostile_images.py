# SPDX-License-Identifier: Apache-2.0
"""Image files that claim more than they hold, or that lost a part and do not show it."""

from __future__ import annotations

import os
import re
import struct
import zlib
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from binocular_recon.errors import FileError, ImageError
from binocular_recon.io.image_files import decoded_image, read_image_file
from binocular_recon.io.image_headers import jpeg_segments, read_header

HEIGHT, WIDTH = 120, 200
FORMATS = ('.png', '.jpg', '.tiff', '.bmp', '.webp', '.jp2', '.pgm', '.ppm', '.pam')
KINDS: dict[str, list[int]] = {
    'baseline': [],
    'restarts': [cv2.IMWRITE_JPEG_RST_INTERVAL, 4],
    'optimised': [cv2.IMWRITE_JPEG_OPTIMIZE, 1],
    'progressive': [cv2.IMWRITE_JPEG_PROGRESSIVE, 1],
}


def scene(channels: int = 3) -> Any:
    noise = np.random.default_rng(0).integers(0, 256, (HEIGHT, WIDTH, channels), np.uint8)
    return cv2.GaussianBlur(noise, (5, 5), 0)


def encoded(extension: str, image: Any, options: list[int] | None = None) -> bytes:
    return bytes(cv2.imencode(extension, image, options or [])[1].tobytes())


@pytest.mark.parametrize('extension', FORMATS)
def test_size_is_read_without_decoding(extension: str) -> None:
    image = scene(1) if extension == '.pgm' else scene()
    header = read_header(encoded(extension, image))
    assert (header.width, header.height) == (WIDTH, HEIGHT)
    decoded = cv2.imdecode(np.frombuffer(encoded(extension, image), np.uint8), -1)
    assert header.pixel_bytes * WIDTH * HEIGHT >= decoded.nbytes


@pytest.mark.parametrize(
    ('dtype', 'channels', 'pixel_bytes'),
    [(np.uint8, 1, 1), (np.uint8, 3, 3), (np.uint16, 1, 2), (np.uint16, 3, 6)],
)
def test_bytes_of_a_pixel_are_read(dtype: Any, channels: int, pixel_bytes: int) -> None:
    image = np.zeros((9, 7, channels), dtype)
    for extension in ('.png', '.tiff'):
        assert read_header(encoded(extension, image)).pixel_bytes == pixel_bytes


def claiming(extension: str, side: int) -> bytes:
    """Return a small file that claims to be a square image."""
    data = bytearray(encoded(extension, scene()))
    if extension == '.png':
        data[16:24] = struct.pack('>II', side, side)
        data[29:33] = struct.pack('>I', zlib.crc32(data[12:29]))
    elif extension == '.jpg':
        place = data.index(b'\xff\xc0') + 5
        data[place : place + 4] = struct.pack('>HH', side, side)
    elif extension == '.bmp':
        data[18:26] = struct.pack('<ii', side, side)
    elif extension == '.webp':
        width, height = side - 1, side - 1
        chunk = struct.pack('<B', 0x2F) + struct.pack('<I', width | height << 14)
        data = bytearray(b'RIFF' + struct.pack('<I', 22) + b'WEBPVP8L' + struct.pack('<I', 5))
        data += chunk
    elif extension == '.ppm':
        data[:] = b'P6\n# a comment\n%d %d\n255\n' % (side, side) + bytes(100)
    else:
        data[:] = b'II*\0\x08\0\0\0\x02\0'
        for tag in (256, 257):
            data += struct.pack('<HHII', tag, 4, 1, side)
    return bytes(data)


@pytest.mark.parametrize(
    ('extension', 'side'),
    [
        *((extension, 30000) for extension in ('.png', '.jpg', '.bmp', '.ppm', '.tiff')),
        ('.webp', 16000),
        ('.tiff', 2**31),
    ],
)
def test_a_huge_claim_is_refused_before_anything_is_allocated(extension: str, side: int) -> None:
    with pytest.raises(ImageError, match=rf'left image claims {side}x{side} px; at most 128 \*'):
        decoded_image(claiming(extension, side), 'left image')


@pytest.mark.parametrize(('extension', 'kind'), [('.png', 'PNG'), ('.jpg', 'JPEG')])
def test_an_image_that_cannot_be_in_so_few_bytes_is_refused(extension: str, kind: str) -> None:
    with pytest.raises(
        ImageError, match=rf'claims 8000x8000 px as {kind}, which takes at least \d+ bytes, and'
    ):
        decoded_image(claiming(extension, 8000), 'left image')


def test_uniform_images_are_not_too_few_bytes() -> None:
    for value in (0, 128, 255):
        image = np.full((1200, 1800, 3), value, np.uint8)
        for extension, options in (
            ('.png', [16, 9]),
            *(('.jpg', options) for options in KINDS.values()),
        ):
            data = encoded(extension, image, options)
            np.testing.assert_array_equal(decoded_image(data, 'image'), image)


def test_another_size_than_the_calibrated_one_is_not_decoded() -> None:
    data = claiming('.jpg', 3000)  # it has no such image: decoding would fail
    with pytest.raises(
        ImageError, match='left image is 3000x3000 px, its calibration is for 200x'
    ):
        decoded_image(data, 'left image', (WIDTH, HEIGHT))
    assert decoded_image(encoded('.jpg', scene()), 'left image', (WIDTH, HEIGHT)).shape[1] == WIDTH


@pytest.mark.parametrize('extension', FORMATS)
def test_headers_of_any_bytes_end_in_one_sentence(extension: str) -> None:
    rng = np.random.default_rng(1)
    whole = encoded(extension, scene(1) if extension == '.pgm' else scene())
    for _ in range(300):
        data = bytearray(whole[: rng.integers(2, 200)])
        for place in rng.integers(0, len(data), rng.integers(0, 8)):
            data[place] = rng.integers(256)
        try:
            header = read_header(bytes(data))
        except ImageError as error:
            assert str(error).split()[0] in ('is', 'has', 'claims')  # noqa: PT017
        else:
            assert 0 < header.width * header.height <= 2**27


def chunk(kind: bytes, content: bytes, claimed: int | None = None) -> bytes:
    """Return a chunk of a PNG."""
    length = len(content) if claimed is None else claimed
    body = kind + content
    return struct.pack('>I', length) + body + struct.pack('>I', zlib.crc32(body))


def costly(name: str) -> bytes:
    """Return an image of 200x120 px that takes long, or much memory, to decode."""
    progressive = encoded('.jpg', scene(), KINDS['progressive'])
    plain, png = encoded('.jpg', scene()), encoded('.png', scene())
    last = progressive.rindex(b'\xff\xda')
    table = bytes([0x10, 1, *15 * [0], 0]) * 3600
    tables = b'\xff\xc4' + struct.pack('>H', len(table) + 2) + table
    size = struct.pack('<HHII', 257, 4, 1, 120)
    return {
        # 20 s for 1 MB of 1280x720 px
        'scans': progressive[:-2] + 60 * progressive[last:-2] + b'\xff\xd9',
        'segments': plain[:2] + 1100 * b'\xff\xe1\0\2' + plain[2:],
        'tables': plain[:2] + 2 * tables + plain[2:],
        # 2.1 GB for 56 bytes
        'chunk': png[:33] + chunk(b'IDAT', b'abc', 2**31 - 1) + chunk(b'IEND', b''),
        'chunks': png[:33] + 2**17 * chunk(b'tEXt', b'') + png[33:],
        # two readers, two sizes
        'comment': b'P6 30000#30000 1\n200 255\n' + bytes(72000),
        'return': b'P6 #\r30000 30000 255\n200 120 255\n' + bytes(72000),
        'pam': b'P7\nWIDTH 200\nHEIGHT 120\nDEPTH 3\nWIDTH 30000\nENDHDR\n' + bytes(72000),
        'twice': b'II*\0\x08\0\0\0\3\0' + struct.pack('<HHII', 256, 4, 1, 30000)
        + struct.pack('<HHII', 256, 4, 1, 200) + size,
        'signed': b'II*\0\x08\0\0\0\2\0' + struct.pack('<HHII', 256, 9, 1, 65536 + 200) + size,
    }[name]  # fmt: skip


@pytest.mark.parametrize(
    ('name', 'reason'),
    [
        ('scans', 'more than 64 scans'),
        ('segments', 'truncated'),
        ('tables', r'\d+ bytes of Huffman tables'),
        ('chunk', 'truncated: a chunk claims 2147483647 bytes'),
        ('chunks', 'more than 131072 chunks'),
        ('comment', 'claims 30000x30000|damaged header'),
        ('return', 'claims 30000x30000'),
        ('pam', 'damaged header'),
        ('twice', 'damaged header'),
        ('signed', 'damaged header'),
    ],
)
def test_an_image_of_a_right_size_that_is_costly_is_refused(name: str, reason: str) -> None:
    with pytest.raises(ImageError, match=f'left image .*({reason})'):
        decoded_image(costly(name), 'left image')


def test_many_scans_and_fill_bytes_are_read() -> None:
    progressive = encoded('.jpg', scene(), KINDS['progressive'])
    last = progressive.rindex(b'\xff\xda')
    filled = progressive[:2] + 10_000_000 * b'\xff' + progressive[3:]
    np.testing.assert_array_equal(decoded_image(filled, 'image'), decoded_image(progressive, ''))
    again = progressive[:-2] + 20 * progressive[last:-2] + b'\xff\xd9'
    assert decoded_image(again, 'image').shape == (HEIGHT, WIDTH, 3)


def test_the_image_of_a_jpeg_2000_is_not_what_lies_in_another_box() -> None:
    data = encoded('.jp2', scene())
    start = data.index(b'jp2c') - 4
    hidden = data[start + 8 : start + 68]
    other = bytearray(hidden)
    struct.pack_into('>II', other, 8, 64, 48)
    box = struct.pack('>I4s', 8 + len(other), b'xml ') + bytes(other)
    header = read_header(data[:start] + box + data[start:])
    assert (header.width, header.height) == (WIDTH, HEIGHT)


def several_scans(image: Any) -> bytes:
    """Return a sequential JPEG with one scan per channel, made of files of one channel each."""
    files = [encoded('.jpg', np.ascontiguousarray(channel)) for channel in cv2.split(image)]
    (frame,) = (one for one in jpeg_segments(files[0]) if one[0] == 0xC0)
    components = b''.join(bytes([number, 0x11, 0]) for number in range(3))
    whole = files[0][: frame[1] - 2] + struct.pack('>H', 17) + files[0][frame[1] : frame[1] + 5]
    whole += bytes([3]) + components + files[0][frame[2] : jpeg_segments(files[0])[-1][1] - 4]
    for number, file in enumerate(files):
        whole += bytes([0xFF, 0xDA, 0, 8, 1, number, 0, 0, 63, 0])
        whole += file[jpeg_segments(file)[-1][2] : -2]
    return whole + b'\xff\xd9'


@pytest.mark.parametrize('kind', ['baseline', 'restarts', 'optimised', 'progressive', 'scans'])
@pytest.mark.parametrize('channels', [1, 3])
def test_a_jpeg_without_its_middle_is_found_out(kind: str, channels: int) -> None:
    """It ends with an end marker; the decoder invents the rest."""
    whole = (
        several_scans(scene())
        if kind == 'scans'
        else encoded('.jpg', scene(channels), KINDS[kind])
    )
    assert decoded_image(whole, 'image').shape[:2] == (HEIGHT, WIDTH)
    for keep in (0.3, 0.5, 0.66, 0.8, 0.98):
        for tail in (b'', whole[-100:-2]):
            data = whole[: int(keep * len(whole))] + tail + b'\xff\xd9'
            with pytest.raises(
                ImageError, match=r'right image is truncated: its \d+ bytes of'
            ) as e:
                decoded_image(data, 'right image')
            if kind in ('baseline', 'restarts', 'optimised') and not tail:
                image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
                rows = np.flatnonzero(np.ptp(image.reshape(HEIGHT, -1), axis=1) > 4)
                share = float(str(e.value).partition(' hold ')[2].partition('%')[0]) / 100
                assert share == pytest.approx((rows.max() + 1) / HEIGHT, abs=0.2)  # whole rows


def test_a_jpeg_without_its_last_scans_is_found_out() -> None:
    """The decoder has nothing to warn of."""
    for whole in (several_scans(scene()), encoded('.jpg', scene(), KINDS['progressive'])):
        scans = [found.start() for found in re.finditer(b'\xff\xda', whole)]
        for place in scans[1:]:
            with pytest.raises(ImageError, match=r'bytes of JPEG hold \d+% of the image'):
                decoded_image(whole[:place] + b'\xff\xd9', 'image')


def test_bytes_too_many_before_the_end_are_harmless() -> None:
    for options in KINDS.values():
        data = encoded('.jpg', scene(), options)
        padded = decoded_image(data[:-2] + bytes(3) + data[-2:], 'image')
        np.testing.assert_array_equal(padded, decoded_image(data, 'image'))


def test_grey_images_are_whole() -> None:
    grey = np.full((HEIGHT + 3, WIDTH + 5, 3), 128, np.uint8)
    grey[:40] = scene()[:40, :1]
    for options in KINDS.values():
        data = encoded('.jpg', grey, options)
        assert decoded_image(data, 'image').shape == grey.shape


def test_a_pipe_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / 'left.png')
    with pytest.raises(FileError, match=r'left\.png cannot be read: it is not a file; give a PNG'):
        read_image_file(tmp_path / 'left.png')
