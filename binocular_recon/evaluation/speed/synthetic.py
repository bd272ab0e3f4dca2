# SPDX-License-Identifier: Apache-2.0
"""Synthetic image pairs with known disparity, for timings and tests."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from binocular_recon.images import ByteImage, FloatImage

# Share of the disparity range that the scene fills.
_NEAREST, _FARTHEST = 0.85, 0.12
_BOXES = 14
_NOISE_GREY_LEVELS = 1.5


@dataclass(frozen=True, eq=False)
class SyntheticPair:
    """A rectified pair with ground truth.

    Attributes
    ----------
    left, right : (H, W, 3) uint8
        Images, BGR.
    disparity_px : (H, W) float32
        Exact disparity of the left image.
    visible : (H, W) bool
        Pixels that the right camera sees too.

    """

    left: ByteImage
    right: ByteImage
    disparity_px: FloatImage
    visible: npt.NDArray[np.bool_]


def synthetic_pair(width: int, height: int, disparity_range: int, seed: int = 0) -> SyntheticPair:
    """Render a slanted ground, a wall and boxes, each a textured plane of disparity.

    Every surface has a texture over the left image's pixels and a disparity
    d = d0 + dx x + dy y, so both views are exact. The textures have the spectrum of natural
    images (amplitude 1/f) at contrasts down to almost none; both images are noisy.

    Parameters
    ----------
    width, height : int
        Size, px.
    disparity_range : int
        All disparities lie within 0..disparity_range - 1.
    seed : int
        Of textures, boxes and noise.

    """
    random = np.random.default_rng(seed)
    x, y = np.meshgrid(np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32))
    left = np.zeros((height, width, 3), np.float32)
    right = np.zeros((height, width, 3), np.float32)
    nearest_left = np.full((height, width), -np.inf, np.float32)
    nearest_right = np.full((height, width), -np.inf, np.float32)
    for plane, (x0, x1, y0, y1) in _surfaces(width, height, disparity_range, random):
        d0, dx, dy = plane
        texture, tint = _texture(width, height, random)
        # a point of the plane lies at x - d in the right image: the left x of a right pixel is
        source_x = (x + d0 + dy * y) / (1 - dx)
        for image, nearest, at_x in ((left, nearest_left, x), (right, nearest_right, source_x)):
            disparity = d0 + dx * at_x + dy * y
            inside = (at_x >= x0) & (at_x < x1) & (y >= y0) & (y < y1) & (disparity > nearest)
            grey = cv2.remap(texture, at_x, y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
            image[inside] = grey[inside, None] * tint
            nearest[inside] = disparity[inside]
    landed = np.rint(x - nearest_left).astype(np.intp)
    in_right = (landed >= 0) & (landed < width)
    there = np.take_along_axis(nearest_right, landed.clip(0, width - 1), axis=1)
    return SyntheticPair(
        _exposed(left, random),
        _exposed(right, random),
        nearest_left,
        in_right & (np.abs(there - nearest_left) < 1.0),
    )


def _surfaces(
    width: int, height: int, disparity_range: int, random: np.random.Generator
) -> list[tuple[tuple[float, float, float], tuple[float, float, float, float]]]:
    """Return planes (d0, dx, dy) with their extent (x0, x1, y0, y1) in the left image."""
    near, far = _NEAREST * (disparity_range - 1), _FARTHEST * (disparity_range - 1)
    endless = (-np.inf, np.inf, -np.inf, np.inf)
    slope = (near - far) / (0.55 * height)
    surfaces = [
        ((far, 0.0, 0.0), endless),
        ((far - 0.45 * height * slope, 0.0, slope), endless),
    ]
    for _ in range(_BOXES):
        w, h = random.uniform(0.05, 0.22) * width, random.uniform(0.1, 0.4) * height
        x0, y0 = random.uniform(0, width - w), random.uniform(0, height - h)
        d = random.uniform(far, near)
        dx = float(random.uniform(-0.25, 0.25)) * (near - d) / width
        surfaces.append(((d - dx * (x0 + w / 2), dx, 0.0), (x0, x0 + w, y0, y0 + h)))
    return surfaces


def _texture(
    width: int, height: int, random: np.random.Generator
) -> tuple[FloatImage, npt.NDArray[np.float32]]:
    """Return 1/f noise, (H, W) float32 grey levels, and its colour, (3,) float32."""
    noise = random.standard_normal((height, width)).astype(np.float32)
    frequency = np.hypot(np.fft.fftfreq(height)[:, None], np.fft.rfftfreq(width)[None])
    spectrum = np.fft.rfft2(noise) / np.maximum(frequency, 1 / max(width, height))
    pattern = np.fft.irfft2(spectrum, s=(height, width))
    contrast = float(random.uniform(4.0, 40.0))
    grey = random.uniform(70, 180) + contrast * pattern / pattern.std()
    tint = random.uniform(0.75, 1.15, 3)
    return grey.astype(np.float32), tint.astype(np.float32)


def _exposed(light: FloatImage, random: np.random.Generator) -> ByteImage:
    noise = random.normal(0.0, _NOISE_GREY_LEVELS, light.shape)
    return np.clip(np.rint(light + noise), 0, 255).astype(np.uint8)
