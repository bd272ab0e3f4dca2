# SPDX-License-Identifier: Apache-2.0
"""Images of things that look like rods with bands and are none: trunks, windows, stripes."""

from __future__ import annotations

import cv2
import numpy as np

from binocular_recon.images import ByteImage, FloatImage
from binocular_recon.simulation.clutter import paint
from binocular_recon.simulation.render import Sensor, expose

Size = tuple[int, int]


def _soft(size: Size, rng: np.random.Generator, step_px: int) -> FloatImage:
    shape = size[1] // step_px + 2, size[0] // step_px + 2
    coarse = rng.standard_normal(shape).astype(np.float32)
    return np.asarray(cv2.resize(coarse, size, interpolation=cv2.INTER_CUBIC), np.float32)


def _birches(size: Size, rng: np.random.Generator) -> FloatImage:
    """Light trunks with dark bands at any height."""
    image = 90 + 30 * _soft(size, rng, 24) + 15 * _soft(size, rng, 6)
    for _ in range(rng.integers(10, 35)):
        x, lean = rng.uniform(0, size[0]), rng.normal(0, 0.03)
        thick = max(3, int(rng.choice([4, 6, 9, 14, 22]) * rng.uniform(0.7, 1.4)))
        y, dark = -5.0, False
        while y < size[1] * rng.uniform(0.8, 1.3):
            step = rng.uniform(0.4, 1.5) * thick if dark else rng.exponential(3 * thick) + thick
            tone = rng.uniform(20, 60) if dark else rng.uniform(190, 235)
            ends = (int(x + lean * y), int(y)), (int(x + lean * (y + step)), int(y + step))
            cv2.line(image, *ends, float(tone), thick, cv2.LINE_AA)
            y, dark = y + step, not dark
    return image


def _windows(size: Size, rng: np.random.Generator) -> FloatImage:
    """Windows of a tower block in columns, dark or lit, seen at an angle."""
    width, height = size
    image = 150 + 12 * _soft(size, rng, 40) + 4 * _soft(size, rng, 4)
    wide = int(rng.uniform(5, 30))
    high = int(wide * rng.uniform(1, 8))
    right, down = int(wide * rng.uniform(1.6, 6)), int(high * rng.uniform(1.2, 2.5))
    tone = rng.uniform(30, 80) if rng.random() < 0.7 else rng.uniform(200, 240)
    for y in range(int(rng.integers(0, down)), height, down):
        for x in range(int(rng.integers(0, right)), width, right):
            image[y : y + high, x : x + wide] = tone * rng.uniform(0.7, 1.3)
    return _at_an_angle(image, rng, 0.06)


def _at_an_angle(image: FloatImage, rng: np.random.Generator, share: float) -> FloatImage:
    """Move the corners of an image by this share of its width."""
    height, width = image.shape
    corners = np.array([[0, 0], [width, 0], [width, height], [0, height]], np.float32)
    seen = corners + rng.normal(0, share * width, (4, 2)).astype(np.float32)
    view = cv2.getPerspectiveTransform(corners, seen)
    warped = cv2.warpPerspective(image, view, (width, height), borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(warped, np.float32)


def _stripes(size: Size, rng: np.random.Generator) -> FloatImage:
    """Upright stripes, as of corrugated iron, with shadows and joints across."""
    width, height = size
    period, share = rng.uniform(4, 60), rng.uniform(0.2, 0.8)
    light = (np.arange(width) + rng.uniform(0, period)) % period < share * period
    row = np.where(light, rng.uniform(170, 240), rng.uniform(15, 80)).astype(np.float32)
    image = np.tile(row, (height, 1))
    for y in rng.uniform(0, height, int(rng.integers(2, 14))):
        image[int(y) : int(y) + int(rng.uniform(3, 60))] *= rng.uniform(0.2, 0.9)
    return image + 6 * _soft(size, rng, 30)


def _saplings(size: Size, rng: np.random.Generator) -> FloatImage:
    """Many thin dark trunks before snow, with branches across."""
    width, height = size
    image = 200 - 10 * np.abs(_soft(size, rng, 60))
    for _ in range(int(rng.integers(40, 160))):
        x, y, length = rng.uniform((0, -0.3 * height, 0.3 * height), (width, 0.5 * height, height))
        ends = (int(x), int(y)), (int(x + rng.normal(0, 0.05) * length), int(y + length))
        cv2.line(image, *ends, float(rng.uniform(20, 110)), int(rng.integers(1, 12)), cv2.LINE_AA)
    for _ in range(int(rng.integers(50, 300))):
        start, heading = rng.uniform((0, 0), (width, height)), rng.uniform(-0.6, 0.6)
        end = start + rng.uniform(10, 90) * np.array([np.cos(heading), np.sin(heading)])
        ends = tuple(start.astype(int).tolist()), tuple(end.astype(int).tolist())
        cv2.line(image, *ends, float(rng.uniform(30, 250)), int(rng.integers(1, 6)), cv2.LINE_AA)
    return image


_DRAWN = {
    'birches': _birches,
    'windows': _windows,
    'stripes': _stripes,
    'saplings': _saplings,
}
LOOKALIKES = (*_DRAWN, 'forest')


def lookalike(kind: str, size: Size, seed: int) -> ByteImage:
    """Return an image of one of `LOOKALIKES`, (H, W, 3), as a camera takes it."""
    rng = np.random.default_rng([seed, LOOKALIKES.index(kind)])
    if kind not in _DRAWN:
        return expose(paint(kind, size, rng).astype(np.float32), Sensor(), rng)
    return photographed(_DRAWN[kind](size, rng), rng)


def checks(size: Size, rng: np.random.Generator) -> FloatImage:
    """Panels of a facade, light and dark by turns, seen at an angle."""
    width, height = size
    side = rng.uniform(8, 40)
    rows, columns = np.mgrid[:height, :width]
    high = side * rng.uniform(0.5, 3)
    image = np.where((columns // side + rows // high) % 2, 220, 30).astype(np.float32)
    return _at_an_angle(image, rng, 0.06)


def lattice(size: Size, rng: np.random.Generator) -> FloatImage:
    """Bars in two directions, as of a steel lattice or a fence, seen at an angle."""
    width, height = size
    image = rng.uniform(30, 200) + 15 * _soft(size, rng, 30)
    across, down = rng.uniform(10, 70), rng.uniform(8, 70)
    wide, high = across * rng.uniform(0.15, 0.6), down * rng.uniform(0.15, 0.6)
    tone = rng.uniform(10, 245)
    upright = (np.arange(width) + rng.uniform(0, across)) % across < wide
    level = (np.arange(height) + rng.uniform(0, down)) % down < high
    image = np.where(upright | level[:, None], tone, image).astype(np.float32)
    return _at_an_angle(image, rng, 0.06)


def photographed(grey: FloatImage, rng: np.random.Generator) -> ByteImage:
    """Return grey levels (H, W) as a camera takes them, (H, W, 3)."""
    return expose(np.repeat(grey[..., None], 3, axis=2), Sensor(), rng)
