# SPDX-License-Identifier: Apache-2.0
"""Convert Image and CompressedImage messages to arrays, and back.

Array members keep the type that they have in the message: `array.array` in rclpy, numpy in bags.
"""

from __future__ import annotations

import array
import math
import sys
from typing import Any, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from binocular_recon.errors import ImageError
from binocular_recon.images import Image
from binocular_recon.inputs.camera_checks import check_image_size
from binocular_recon.io.image_files import decoded_image
from binocular_recon.io.messages.encodings import (
    ENCODINGS,
    Encoding,
    check_byte_order,
    known_encoding,
)


class DecodedImage(NamedTuple):
    """An image and the encoding of its message.

    Attributes
    ----------
    image : (H, W) or (H, W, C) uint8, uint16, float32 or float64
        Grey, BGR or BGRA, whatever the order in the message.
    encoding : str
        Encoding of the message; `bgr8` or `bgr16` if that is a Bayer mosaic or YUV 4:2:2.

    """

    image: Image
    encoding: str


# Encodings of images that come without one.
_PLAIN = {
    ('u1', 1): 'mono8',
    ('u1', 3): 'bgr8',
    ('u1', 4): 'bgra8',
    ('u2', 1): 'mono16',
    ('u2', 3): 'bgr16',
    ('u2', 4): 'bgra16',
}


def stamp_ns(header: Any) -> int:
    """Return the stamp of a header, ns."""
    return int(header.stamp.sec) * 1_000_000_000 + int(header.stamp.nanosec)


def read_image(
    message: Any, name: str = 'image', size: tuple[int, int] | None = None
) -> DecodedImage:
    """Decode an Image or a CompressedImage.

    Parameters
    ----------
    message : sensor_msgs/Image or sensor_msgs/CompressedImage
        Message with any ``step`` and byte order, or a whole JPEG or PNG file.
    name : str
        Name of the image in errors.
    size : (int, int), optional
        Width and height that it must have; no other one is decoded.

    Returns
    -------
    DecodedImage
        Shares the bytes of the message where these need no conversion.

    Raises
    ------
    ImageError
        If the encoding is unknown, bytes are missing, the file cannot be decoded, or its size is
        another or implausible.

    """
    if hasattr(message, 'format'):
        image, encoding = _decode_file(message, name, size)
    else:
        if size:
            check_image_size((int(message.width), int(message.height)), size, name)
        image, encoding = image_samples(message, name), known_encoding(message.encoding)
        code = ENCODINGS[encoding].decode
        if code is not None:
            image = cv2.cvtColor(image, code)
    if ENCODINGS[encoding].decode is not None and ENCODINGS[encoding].encode is None:
        encoding = plain_encoding(image)
    return DecodedImage(image, encoding)


def image_samples(message: Any, name: str = 'image') -> Image:
    """Return the samples of an Image, (H, W) or (H, W, C), channels in the order of the message.

    Raises an ImageError if the encoding is unknown or bytes are missing.
    """
    encoding = ENCODINGS.get(known_encoding(message.encoding))
    if encoding is None:
        raise ImageError(
            f'{name} has encoding {message.encoding!r}; convert it to one of'
            f' {", ".join(ENCODINGS)}'
        )
    width, height, step = int(message.width), int(message.height), int(message.step)
    dtype = np.dtype(encoding.dtype)
    pixel = dtype.itemsize * encoding.channels
    if width <= 0 or height <= 0 or (encoding.channels == 2 and width % 2):
        raise ImageError(f'{name} cannot be {width}x{height} px as {message.encoding}')
    if step < width * pixel:
        raise ImageError(
            f'{name} has a step of {step} bytes, {width} px of {message.encoding} take'
            f' {width * pixel}; correct the driver'
        )
    data = np.frombuffer(message.data, np.uint8)
    if data.size < step * height:
        raise ImageError(
            f'{name} holds {data.size} bytes, step x height is {step} x {height} ='
            f' {step * height}; it was truncated'
        )
    shape: tuple[int, ...] = (height, width)
    strides: tuple[int, ...] = (step, pixel)
    if encoding.channels > 1:
        shape, strides = (*shape, encoding.channels), (*strides, dtype.itemsize)
    ordered = dtype.newbyteorder('>' if message.is_bigendian else '<')
    samples: Image = np.ndarray(shape, ordered, data, 0, strides)
    samples = np.ascontiguousarray(samples, dtype)
    if dtype == np.uint16:
        check_byte_order(samples, bool(message.is_bigendian), name)
    return samples


def plain_encoding(image: Image) -> str:
    """Return the encoding of a grey, BGR or BGRA image; empty if its type has none."""
    return _PLAIN.get(_kind(image), '')


def fill_image(message: Any, image: Image, encoding: str, header: Any) -> None:
    """Fill an Image message.

    Parameters
    ----------
    message : sensor_msgs/Image
        Message to fill.
    image : (H, W) or (H, W, C)
        Grey, BGR or BGRA, as `read_image` returns it.
    encoding : str
        Encoding of the message; no Bayer mosaic or YUV.
    header : std_msgs/Header
        Header of the message.

    Raises
    ------
    ImageError
        If the image cannot be written in this encoding.

    """
    spec = ENCODINGS.get(encoding, Encoding('', 0))
    channels = _kind(image)[1]
    if _kind(image) != spec[:2] or (spec.decode and spec.encode is None):
        raise ImageError(
            f'image of {image.dtype} with {channels} channels cannot be written as {encoding!r}'
        )
    if spec.encode is not None:
        image = cv2.cvtColor(image, spec.encode)
    message.header = header
    message.height, message.width = image.shape[:2]
    message.encoding = encoding
    message.is_bigendian = int(sys.byteorder == 'big')
    message.step = message.width * channels * image.itemsize
    assign_array(message, 'data', image)


def assign_array(message: Any, member: str, values: npt.NDArray[Any]) -> None:
    """Set an array member of a message, keeping its array type, with a single copy.

    Assigning a numpy array to a message of rclpy copies element by element, which takes a second
    for an image, and assigning an `array.array` copies it; its own array is filled instead.
    """
    present = getattr(message, member)
    if isinstance(present, array.array):
        present = _emptied(message, member)
        if values.size:
            present.frombytes(np.ascontiguousarray(values).data.cast('B'))
    else:
        flat = np.ascontiguousarray(values).reshape(-1)
        setattr(message, member, flat.view(present.dtype))


def new_array(message: Any, member: str, shape: tuple[int, ...]) -> npt.NDArray[np.uint8]:
    """Give a byte array member of a message a size, and return it, zeros, to be filled in place.

    The message's array type is kept; the memory of a message that is used again, too, if its size
    does not change.
    """
    count = math.prod(shape)
    present = getattr(message, member)
    if not isinstance(present, array.array):
        values = np.zeros(count, np.uint8)
        setattr(message, member, values.view(present.dtype))
        return values.reshape(shape)
    if len(present) == count:
        filled = np.frombuffer(present, np.uint8).reshape(shape)
        filled[...] = 0
        return filled
    present = _emptied(message, member)
    if count:
        present.append(0)
        present *= count
    return np.frombuffer(present, np.uint8).reshape(shape)


def _emptied(message: Any, member: str) -> Any:
    """Return the `array.array` of a message, without content; another if somebody looks at it."""
    present = getattr(message, member)
    try:
        del present[:]
    except BufferError:
        setattr(message, member, array.array(present.typecode))
        present = getattr(message, member)
    return present


def _kind(image: Image) -> tuple[str, int]:
    """Return type and number of channels, like the first two members of `Encoding`."""
    return image.dtype.str[1:], 1 if image.ndim == 2 else image.shape[2]


def _decode_file(message: Any, name: str, size: tuple[int, int] | None) -> tuple[Image, str]:
    """Return the image of a CompressedImage, grey, BGR or BGRA, and its encoding."""
    # image_transport writes 'ENCODING; CODEC compressed ORDER', older senders only 'CODEC'
    encoding, _, codec = str(message.format).partition(';')
    data = np.frombuffer(message.data, np.uint8).tobytes()
    try:
        image = decoded_image(data, name, size)
    except ImageError as error:
        raise ImageError(f'{error} (the message says {message.format!r})') from error
    if 'compressed rgb' in codec and image.ndim == 3:  # encoded with red and blue swapped
        image = cv2.cvtColor(
            image, cv2.COLOR_RGB2BGR if image.shape[2] == 3 else cv2.COLOR_RGBA2BGRA
        )
    encoding = known_encoding(encoding)
    spec = ENCODINGS.get(encoding)
    if spec is None or spec[:2] != _kind(image):
        plain = plain_encoding(image)
        if not plain:
            kind, channels = _kind(image)
            raise ImageError(
                f'{name} is a file of type {kind} with {channels} channels; send 8 or 16 bits per'
                ' sample and 1 or 3 channels'
            )
        return image, plain
    if spec.decode is not None and spec.encode is None:
        image = cv2.cvtColor(image, spec.decode)
        return image, plain_encoding(image)
    return image, encoding
