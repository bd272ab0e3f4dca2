# SPDX-License-Identifier: Apache-2.0
"""Encodings of Image messages: what they are called, and whether their bytes are in order."""

from __future__ import annotations

import re
from typing import NamedTuple

import cv2
import numpy as np

from binocular_recon.errors import ImageError
from binocular_recon.images import Image


class Encoding(NamedTuple):
    """How samples are stored, and what cv2.cvtColor makes of them."""

    dtype: str
    channels: int = 1
    decode: int | None = None  # to BGR
    encode: int | None = None  # from BGR; none to a mosaic or YUV


# ROS names a Bayer pattern by its first two pixels, OpenCV by the second and third of row two.
ENCODINGS = {
    'mono8': Encoding('u1'),
    '8UC1': Encoding('u1'),
    'mono16': Encoding('u2'),
    '16UC1': Encoding('u2'),
    '32FC1': Encoding('f4'),
    '32FC3': Encoding('f4', 3),
    '64FC1': Encoding('f8'),
    'bgr8': Encoding('u1', 3),
    '8UC3': Encoding('u1', 3),
    'bgra8': Encoding('u1', 4),
    '8UC4': Encoding('u1', 4),
    'bgr16': Encoding('u2', 3),
    '16UC3': Encoding('u2', 3),
    '16UC4': Encoding('u2', 4),
    'bgra16': Encoding('u2', 4),
    'rgb8': Encoding('u1', 3, cv2.COLOR_RGB2BGR, cv2.COLOR_BGR2RGB),
    'rgba8': Encoding('u1', 4, cv2.COLOR_RGBA2BGRA, cv2.COLOR_BGRA2RGBA),
    'rgb16': Encoding('u2', 3, cv2.COLOR_RGB2BGR, cv2.COLOR_BGR2RGB),
    'rgba16': Encoding('u2', 4, cv2.COLOR_RGBA2BGRA, cv2.COLOR_BGRA2RGBA),
    'bayer_rggb8': Encoding('u1', 1, cv2.COLOR_BayerBG2BGR),
    'bayer_bggr8': Encoding('u1', 1, cv2.COLOR_BayerRG2BGR),
    'bayer_gbrg8': Encoding('u1', 1, cv2.COLOR_BayerGR2BGR),
    'bayer_grbg8': Encoding('u1', 1, cv2.COLOR_BayerGB2BGR),
    'bayer_rggb16': Encoding('u2', 1, cv2.COLOR_BayerBG2BGR),
    'bayer_bggr16': Encoding('u2', 1, cv2.COLOR_BayerRG2BGR),
    'bayer_gbrg16': Encoding('u2', 1, cv2.COLOR_BayerGR2BGR),
    'bayer_grbg16': Encoding('u2', 1, cv2.COLOR_BayerGB2BGR),
    'yuv422': Encoding('u1', 2, cv2.COLOR_YUV2BGR_UYVY),
    'uyvy': Encoding('u1', 2, cv2.COLOR_YUV2BGR_UYVY),
    'yuv422_yuy2': Encoding('u1', 2, cv2.COLOR_YUV2BGR_YUY2),
    'yuyv': Encoding('u1', 2, cv2.COLOR_YUV2BGR_YUY2),
}
# What drivers and other libraries call these, in lower case without anything but letters and
# digits. 10 to 14 bits come in 16; NV12, NV21 and NV24 begin with the brightness of all pixels.
_NAMES = {re.sub('[^a-z0-9]', '', name.lower()): name for name in ENCODINGS}
_NAMES |= dict.fromkeys(('y8', 'y800', 'gray8', 'grey8', 'nv12', 'nv21', 'nv24'), 'mono8')
_NAMES |= dict.fromkeys(('y16', 'gray16', 'grey16', 'mono10', 'mono12', 'mono14'), 'mono16')
_NAMES |= {'yuy2': 'yuv422_yuy2', 'yuv4228uyvy': 'uyvy', 'yuv4228': 'yuyv'}
_NAMES |= {
    f'bayer{genicam}{bits}': f'bayer_{pattern}{8 if bits == 8 else 16}'
    for pattern in ('rggb', 'bggr', 'gbrg', 'grbg')
    for genicam in (pattern, pattern[:2])  # BayerRG12 begins with the same two pixels
    for bits in (8, 10, 12, 14, 16)
}
# Bytes of 16-bit samples are exchanged if neighbours then differ by less than the first share of
# the contrast, and by more than the second one as they are (1.13 in noise).
_SMOOTH, _ROUGH = 0.45, 0.8
# Rows that are looked at for that.
_ROWS = 16


def known_encoding(encoding: str) -> str:
    """Return the name of an encoding in `ENCODINGS`; an unknown one as it is."""
    return _NAMES.get(re.sub('[^a-z0-9]', '', encoding.lower()), encoding)


def check_byte_order(samples: Image, big: bool, name: str) -> None:
    """Raise an ImageError if ``is_bigendian`` says the wrong order of bytes."""
    rows = samples[:: max(1, len(samples) // _ROWS)]
    given, exchanged = (_roughness(one) for one in (rows, rows.byteswap()))
    if exchanged < _SMOOTH and given > _ROUGH:
        raise ImageError(
            f'{name} has exchanged bytes: with is_bigendian {int(big)} neighbouring pixels differ'
            f' by {given:.2f} times the contrast, as in noise, with {int(not big)} by'
            f' {exchanged:.2f}; correct is_bigendian in the driver'
        )


def _roughness(rows: Image) -> float:
    """Return the step between neighbours of some rows, as a share of their contrast."""
    levels = rows.astype(np.float32)
    # two columns on: those of a Bayer pattern have another colour in between
    return float(np.mean(np.abs(levels[:, 2:] - levels[:, :-2]))) / max(float(levels.std()), 1e-6)
