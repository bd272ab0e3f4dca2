# SPDX-License-Identifier: Apache-2.0
"""Image and CompressedImage messages."""

from __future__ import annotations

import array
import zlib
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from binocular_recon.errors import ImageError
from binocular_recon.images import to_grey
from binocular_recon.io.messages.encodings import ENCODINGS
from binocular_recon.io.messages.images import fill_image, image_samples, read_image, stamp_ns

HEADER = SimpleNamespace(stamp=SimpleNamespace(sec=3, nanosec=7), frame_id='left')


def image_message(samples: np.ndarray, encoding: str, **members: Any) -> SimpleNamespace:
    """Return an Image in C order with the given samples."""
    samples = np.ascontiguousarray(samples)
    message = SimpleNamespace(
        header=HEADER,
        height=samples.shape[0],
        width=samples.shape[1],
        encoding=encoding,
        is_bigendian=0,
        step=samples.strides[0],
        data=array.array('B', samples.tobytes()),
    )
    vars(message).update(members)
    return message


def scene(height: int = 12, width: int = 20) -> np.ndarray:
    """Return a smooth BGR image in which every channel differs."""
    y, x = np.mgrid[:height, :width]
    return np.stack([40 + 4 * x, 60 + 8 * y, 200 - 3 * x - 2 * y], axis=-1).astype(np.uint8)


def test_stamp() -> None:
    assert stamp_ns(HEADER) == 3_000_000_007


@pytest.mark.parametrize('padding', [0, 3])
@pytest.mark.parametrize('order', ['<', '>'])
@pytest.mark.parametrize(
    ('encoding', 'dtype', 'channels'),
    [
        ('mono8', 'u1', 1),
        ('8UC1', 'u1', 1),
        ('mono16', 'u2', 1),
        ('16UC1', 'u2', 1),
        ('32FC1', 'f4', 1),
        ('bgr8', 'u1', 3),
        ('8UC3', 'u1', 3),
        ('bgra8', 'u1', 4),
        ('rgb8', 'u1', 3),
        ('rgba8', 'u1', 4),
        ('rgb16', 'u2', 3),
    ],
)
def test_any_step_and_byte_order(
    encoding: str, dtype: str, channels: int, order: str, padding: int
) -> None:
    generator = np.random.default_rng(1)
    shape = (5, 7) if channels == 1 else (5, 7, channels)
    samples = generator.integers(0, 256 ** np.dtype(dtype).itemsize, shape).astype(dtype)
    rows = samples.astype(order + dtype).reshape(5, -1).view(np.uint8)
    rows = np.pad(rows, ((0, 0), (0, padding)), constant_values=99)
    message = image_message(
        rows, encoding, width=7, step=rows.shape[1], is_bigendian=int(order == '>')
    )
    np.testing.assert_array_equal(image_samples(message), samples)
    image, kept = read_image(message)
    swapped = samples[..., [2, 1, 0, 3][:channels]] if encoding.startswith('rgb') else samples
    np.testing.assert_array_equal(image, swapped)
    assert kept == encoding and image.dtype == np.dtype(dtype)
    again = image_message(np.zeros((1, 1), np.uint8), 'mono8')
    fill_image(again, image, encoding, HEADER)
    np.testing.assert_array_equal(image_samples(again), samples)
    assert isinstance(again.data, array.array) and again.step == 7 * samples[0, 0].nbytes
    assert (again.width, again.height, again.header) == (7, 5, HEADER)


@pytest.mark.parametrize('data', [bytes, np.frombuffer], ids=['bytes', 'numpy'])
def test_data_of_any_kind(data: Any) -> None:
    samples = np.arange(12, dtype=np.uint8).reshape(3, 4)
    stored = data(samples.tobytes()) if data is bytes else data(samples.tobytes(), np.uint8)
    image = read_image(image_message(samples, 'mono8', data=stored)).image
    np.testing.assert_array_equal(image, samples)


def test_members_keep_the_type_they_have() -> None:
    message = image_message(np.zeros((1, 1), np.uint8), 'mono8', data=np.zeros(0, np.uint8))
    fill_image(message, np.ones((2, 3), np.float32), '32FC1', HEADER)
    assert message.data.dtype == np.uint8 and message.data.shape == (24,)


@pytest.mark.parametrize(
    ('pattern', 'red', 'blue'),
    [
        ('rggb', (0, 0), (1, 1)),
        ('bggr', (1, 1), (0, 0)),
        ('gbrg', (1, 0), (0, 1)),
        ('grbg', (0, 1), (1, 0)),
    ],
)
def test_bayer_pattern(pattern: str, red: tuple[int, int], blue: tuple[int, int]) -> None:
    bgr = scene()
    mosaic = bgr[..., 1].copy()
    mosaic[red[0] :: 2, red[1] :: 2] = bgr[red[0] :: 2, red[1] :: 2, 2]
    mosaic[blue[0] :: 2, blue[1] :: 2] = bgr[blue[0] :: 2, blue[1] :: 2, 0]
    image, encoding = read_image(image_message(mosaic, f'bayer_{pattern}8'))
    assert encoding == 'bgr8'
    inner = np.s_[2:-2, 2:-2]
    np.testing.assert_allclose(image[inner].astype(int), bgr[inner], atol=1)


@pytest.mark.parametrize('encoding', ['yuv422', 'uyvy', 'yuv422_yuy2', 'yuyv'])
def test_shared_colour(encoding: str) -> None:
    y, u, v = 81, 90, 240  # red in Rec. 601's video range
    pixels = [u, y, v, y] if encoding in ('yuv422', 'uyvy') else [y, u, y, v]
    samples = np.tile(np.array(pixels, np.uint8), (4, 3)).reshape(4, 6, 2)
    image, kept = read_image(image_message(samples, encoding))
    assert kept == 'bgr8'
    np.testing.assert_allclose(image.reshape(-1, 3).astype(int), [[0, 0, 255]] * 24, atol=2)


@pytest.mark.parametrize(
    ('members', 'error'),
    [
        ({'encoding': 'rgb7'}, "left image has encoding 'rgb7'; convert it to one of mono8"),
        ({'data': bytes(19)}, r'left image holds 19 bytes, step x height is 5 x 4 = 20'),
        ({'step': 4}, 'step of 4 bytes, 5 px of mono8 take 5'),
        ({'width': 0}, 'cannot be 0x4 px'),
        ({'encoding': 'yuv422', 'width': 1}, 'cannot be 1x4 px as yuv422'),
    ],
)
def test_bad_image(members: dict[str, Any], error: str) -> None:
    message = image_message(np.zeros((4, 5), np.uint8), **{'encoding': 'mono8', **members})
    with pytest.raises(ImageError, match=error):
        read_image(message, 'left image')


@pytest.mark.parametrize('encoding', ['mono16', 'bayer_rggb8', 'yuv422', 'what'])
def test_image_that_does_not_fit_the_encoding(encoding: str) -> None:
    message = image_message(np.zeros((1, 1), np.uint8), 'mono8')
    with pytest.raises(ImageError, match=f"cannot be written as '{encoding}'"):
        fill_image(message, np.zeros((4, 4), np.uint8), encoding, HEADER)


@pytest.mark.parametrize(
    ('name', 'encoding'),
    [
        ('Mono8', 'mono8'),
        ('RGB8', 'rgb8'),
        ('Y8', 'mono8'),
        ('GRAY16', 'mono16'),
        ('Y16', 'mono16'),
        ('mono12', 'mono16'),
        ('BayerRG8', 'bayer_rggb8'),
        ('BayerGB12', 'bayer_gbrg16'),
        ('bayer_grbg10', 'bayer_grbg16'),
        ('YUV422_8_UYVY', 'uyvy'),
        ('YUY2', 'yuyv'),
    ],
)
def test_what_drivers_call_an_encoding(name: str, encoding: str) -> None:
    dtype, channels = ENCODINGS[encoding][:2]
    shape = (6, 8) if channels == 1 else (6, 8, channels)
    samples = np.random.default_rng(3).integers(0, 200, shape).astype(dtype)
    image, kept = read_image(image_message(samples, name))
    expected, plain = read_image(image_message(samples, encoding))
    np.testing.assert_array_equal(image, expected)
    assert kept == plain and kept in ENCODINGS


@pytest.mark.parametrize('encoding', ['nv12', 'NV21', 'nv24'])
def test_the_brightness_of_planes_is_read(encoding: str) -> None:
    grey = np.arange(48, dtype=np.uint8).reshape(6, 8)
    chroma = np.full((6 if encoding == 'nv24' else 3, 8), 128, np.uint8)
    message = image_message(grey, encoding, data=np.vstack([grey, chroma]).tobytes())
    image, kept = read_image(message)
    np.testing.assert_array_equal(image, grey)
    assert kept == 'mono8'


@pytest.mark.parametrize('bits', [12, 14])
@pytest.mark.parametrize('encoding', ['mono16', '16UC1', 'bayer_rggb16'])
def test_exchanged_bytes_are_said(encoding: str, bits: int) -> None:
    """Counts of most of the range, stored with the other order than is_bigendian says."""
    y, x = np.mgrid[:120, :160]
    texture = np.random.default_rng(4).normal(0, 0.01, (120, 160))
    levels = (0.5 + 0.3 * np.sin(x / 13) * np.cos(y / 17) + texture) * 2**bits
    samples = levels.astype(np.uint16)
    assert read_image(image_message(samples, encoding)).image.dtype == np.uint16
    error = (
        r'exchanged bytes: with is_bigendian [01] neighbouring .* by [01]\.\d\d times .* correct'
    )
    with pytest.raises(ImageError, match=error):
        read_image(image_message(samples.byteswap(), encoding))
    noise = np.random.default_rng(5).integers(0, 2**bits, samples.shape).astype(np.uint16)
    read_image(image_message(noise, encoding))  # either order is noise


def compressed(file: Any, codec: str) -> SimpleNamespace:
    return SimpleNamespace(header=HEADER, format=codec, data=array.array('B', bytes(file)))


def encoded(extension: str, image: np.ndarray) -> bytes:
    done, file = cv2.imencode(extension, image, [cv2.IMWRITE_JPEG_QUALITY, 98])
    assert done
    return bytes(file.tobytes())


@pytest.mark.parametrize(
    ('extension', 'codec', 'kept'),
    [
        ('.jpg', 'bgr8; jpeg compressed bgr8', 'bgr8'),
        ('.jpg', 'rgb8; jpeg compressed bgr8', 'rgb8'),
        ('.png', 'rgb8; png compressed bgr8', 'rgb8'),
        ('.jpg', 'jpeg', 'bgr8'),
        ('.png', 'png', 'bgr8'),
    ],
)
def test_compressed_colour(extension: str, codec: str, kept: str) -> None:
    image, encoding = read_image(compressed(encoded(extension, scene()), codec))
    assert encoding == kept
    np.testing.assert_allclose(image.astype(int), scene(), atol=6)
    swapped = compressed(encoded('.png', scene()[..., ::-1]), 'rgb8; png compressed rgb8')
    np.testing.assert_array_equal(read_image(swapped).image, scene())


def test_compressed_grey_deep_and_mosaic() -> None:
    grey = to_grey(scene()).astype(np.uint8)
    assert read_image(compressed(encoded('.jpg', grey), 'mono8; jpeg compressed ')).encoding == (
        'mono8'
    )
    deep = grey.astype(np.uint16) * 200
    image, encoding = read_image(compressed(encoded('.png', deep), 'mono16; png compressed '))
    np.testing.assert_array_equal(image, deep)
    assert encoding == 'mono16'
    # a 16-bit image that was sent as JPEG has 8 bits
    assert read_image(compressed(encoded('.jpg', grey), '16UC1; jpeg compressed ')).encoding == (
        'mono8'
    )
    image, encoding = read_image(compressed(encoded('.png', grey), 'bayer_rggb8; png compressed '))
    assert encoding == 'bgr8' and image.shape == (*grey.shape, 3)


@pytest.mark.parametrize('extension', ['.jpg', '.png'])
def test_truncated_file_is_refused_wherever_it_ends(extension: str) -> None:
    file = encoded(extension, scene())
    for length in [*range(8), *range(8, len(file) - 1, 7)]:
        with pytest.raises(ImageError, match=r'is truncated|is not an image'):
            read_image(compressed(file[:length], 'bgr8; jpeg compressed bgr8'))
    read_image(compressed(file + bytes(5), 'bgr8; jpeg compressed bgr8'))  # padded by a camera


def test_file_that_asks_for_too_many_pixels_is_refused() -> None:
    file = bytearray(encoded('.png', scene()))
    file[16:24] = (2**30).to_bytes(4, 'big') * 2  # width and height
    file[29:33] = zlib.crc32(file[12:29]).to_bytes(4, 'big')
    with pytest.raises(ImageError, match=r'claims 1073741824x1073741824 px; at most 128 \* 2\^20'):
        read_image(compressed(file, 'bgr8; png compressed bgr8'))


def test_swapped_colours_of_a_grey_file_are_none() -> None:
    grey = scene()[..., 0]
    image, encoding = read_image(compressed(encoded('.png', grey), 'rgb8; png compressed rgb8'))
    np.testing.assert_array_equal(image, grey)
    assert encoding == 'mono8'


def test_bytes_may_fill_the_place_before_a_marker_of_a_jpeg() -> None:
    file = encoded('.jpg', scene())
    filled = file[:2] + b'\xff\xff' + file[2:]
    np.testing.assert_array_equal(
        read_image(compressed(filled, 'jpeg')).image, read_image(compressed(file, 'jpeg')).image
    )


def test_end_of_a_thumbnail_is_not_the_end() -> None:
    file = encoded('.jpg', scene())
    thumbnail = encoded('.jpg', scene(8, 8))
    segment = b'\xff\xe1' + (len(thumbnail) + 2).to_bytes(2, 'big') + thumbnail
    whole = file[:2] + segment + file[2:]
    np.testing.assert_array_equal(
        read_image(compressed(whole, 'jpeg')).image, read_image(compressed(file, 'jpeg')).image
    )
    with pytest.raises(ImageError, match='right image is truncated'):
        read_image(compressed(whole[:-40], 'jpeg'), 'right image')


def test_file_of_an_unknown_kind() -> None:
    with pytest.raises(ImageError, match=r"is not an image \(9 bytes\).* says 'h264'"):
        read_image(compressed(b'not image', 'h264'))


@pytest.mark.parametrize('pattern', ['rggb', 'bggr', 'gbrg', 'grbg'])
def test_mosaics_of_16_bits_are_those_of_8_bits(pattern: str) -> None:
    mosaic = np.random.default_rng(2).integers(0, 256, (16, 24), np.uint8)
    eight, sixteen = (
        read_image(
            SimpleNamespace(
                header=None,
                width=24,
                height=16,
                encoding=f'bayer_{pattern}{bits}',
                step=24 * bits // 8,
                is_bigendian=0,
                data=values.tobytes(),
            )
        )
        for bits, values in ((8, mosaic), (16, mosaic.astype('<u2') * 16))
    )
    assert (eight.encoding, sixteen.encoding) == ('bgr8', 'bgr16')
    assert np.abs(sixteen.image / 16 - eight.image).max() <= 1


@pytest.mark.parametrize(
    ('encoding', 'order'), [('rgba16', [2, 1, 0, 3]), ('bgra16', [0, 1, 2, 3])]
)
def test_images_of_16_bits_with_alpha(encoding: str, order: list[int]) -> None:
    values = np.random.default_rng(3).integers(0, 65536, (5, 7, 4)).astype('<u2')
    message = SimpleNamespace(
        header=None,
        width=7,
        height=5,
        encoding=encoding,
        step=56,
        is_bigendian=0,
        data=values.tobytes(),
    )
    found = read_image(message)
    np.testing.assert_array_equal(found.image, values[..., order])
    assert found.encoding == encoding
    assert to_grey(found.image).shape == (5, 7)
