# SPDX-License-Identifier: Apache-2.0
"""Painted backgrounds that must not fool a rod detector."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
import numpy.typing as npt

from binocular_recon.images import ByteImage

GreyField = npt.NDArray[np.float32]


def paint(kind: str, size: tuple[int, int], rng: np.random.Generator) -> ByteImage:
    """Paint a background.

    Parameters
    ----------
    kind : str
        One of ``KINDS``.
    size : tuple of int
        Width and height, px.
    rng : numpy.random.Generator
        Source of everything random.

    Returns
    -------
    (H, W, 3) uint8
        Blue, green, red.

    """
    return np.clip(KINDS[kind](size, rng), 0, 255).astype(np.uint8)


def fractal_noise(
    size: tuple[int, int], coarsest_px: float, rng: np.random.Generator, stretch: float = 1.0
) -> GreyField:
    """Return noise with equal strength at every scale from ``coarsest_px`` down to 2 px.

    ``stretch`` > 1 makes it longer along the columns. Mean 0, standard deviation 1, (H, W).
    """
    width, height = size
    total = np.zeros((height, width), np.float32)
    step = float(coarsest_px)
    while step >= 2:
        grid = (max(2, round(height / step / stretch)) + 3, max(2, round(width / step)) + 3)
        octave = rng.standard_normal(grid, np.float32)
        total += cv2.resize(octave, size, interpolation=cv2.INTER_CUBIC)
        step /= 2
    total -= total.mean()
    total /= total.std()
    return total


def _shade(field: GreyField, color: tuple[float, float, float], contrast: float) -> GreyField:
    """Return a colour modulated by noise, (H, W, 3)."""
    light = np.float32(1) + np.float32(contrast) * field
    shaded: GreyField = light[..., None] * np.array(color, np.float32)
    return shaded


def _forest(size: tuple[int, int], rng: np.random.Generator) -> GreyField:
    """Foliage with sky shining through, over snow or earth, and many trunks."""
    width, height = size
    leaves = fractal_noise(size, 64, rng)
    image = _shade(leaves, (60, 75, 55), 0.45)
    image[leaves > rng.uniform(0.8, 1.6)] = (225, 220, 210)
    horizon = int(height * rng.uniform(0.45, 0.7))
    ground = (215, 205, 195) if rng.random() < 0.5 else (60, 85, 95)
    image[horizon:] = _shade(fractal_noise((width, height - horizon), 128, rng), ground, 0.12)
    for _ in range(rng.integers(15, 40)):
        thick = int(rng.choice([4, 8, 15, 30, 60, 120]) * rng.uniform(0.7, 1.4))
        top = np.array([rng.uniform(0, width), -10.0])
        foot = top + np.array([rng.normal(0, 0.06 * height), horizon * rng.uniform(0.95, 1.5)])
        mask = np.zeros((height, width), np.uint8)
        cv2.line(mask, tuple(top.astype(int)), tuple(foot.astype(int)), 255, thick, cv2.LINE_AA)
        left = int(np.clip(min(top[0], foot[0]) - thick, 0, width))
        right = int(np.clip(max(top[0], foot[0]) + thick, 0, width))
        if right - left < 2:
            continue
        bark = fractal_noise((right - left, height), 32, rng, stretch=4)
        color = np.array((45, 52, 60), np.float32) * rng.uniform(0.5, 2.2)
        alpha = (mask[:, left:right, None] / np.float32(255)).astype(np.float32)
        image[:, left:right] += alpha * (_shade(bark, tuple(color), 0.35) - image[:, left:right])
    return image


def _fence(size: tuple[int, int], rng: np.random.Generator) -> GreyField:
    """Pickets and rails, evenly spaced like rods, some with a snow cap or a shadow across."""
    width, height = size
    image = _shade(fractal_noise(size, 256, rng), (120, 130, 120), 0.25)
    picket = int(rng.uniform(5, 40))
    pitch = int(picket * rng.uniform(1.6, 6))
    top, bottom = int(height * rng.uniform(0.1, 0.4)), int(height * rng.uniform(0.7, 0.95))
    color = np.array(rng.choice([(40, 50, 60), (210, 210, 205), (70, 110, 150)]), np.float32)
    for x in range(int(rng.integers(0, pitch)), width, pitch):
        wood = fractal_noise((picket, bottom - top), 32, rng, stretch=6)
        image[top:bottom, x : x + picket] = _shade(wood, tuple(color), 0.12)[:, : width - x]
        image[top : top + picket // 2, x : x + picket] = 235
    for _ in range(rng.integers(2, 5)):
        y = int(rng.uniform(top, bottom - picket))
        image[y : y + picket] = color * rng.uniform(0.6, 1.1)
    return image


def _facade(size: tuple[int, int], rng: np.random.Generator) -> GreyField:
    """Bricks, rows of windows with glazing bars, drain pipes with sockets."""
    width, height = size
    image = _shade(fractal_noise(size, 16, rng), (95, 115, 150), 0.08)
    brick = int(rng.uniform(8, 24))
    image[::brick] *= 1.35
    for row, y in enumerate(range(0, height, brick)):
        image[y : y + brick, (row % 2) * brick :: 2 * brick] *= 1.35
    w, h = int(rng.uniform(60, 200)), int(rng.uniform(100, 260))
    bar = max(3, w // 14)
    for y in range(int(rng.integers(0, h)), height, int(h * 1.6)):
        for x in range(int(rng.integers(0, w)), width, int(w * 1.8)):
            image[y : y + h, x : x + w] = 225
            pane = np.array((70, 60, 50), np.float32) * rng.uniform(0.4, 1.6)
            for part in range(2):
                for level in range(3):
                    y0, x0 = y + bar + level * h // 3, x + bar + part * w // 2
                    y1, x1 = y0 + h // 3 - 2 * bar, x0 + w // 2 - 2 * bar
                    image[y0:y1, x0:x1] = pane
    for _ in range(rng.integers(0, 4)):
        x, thick = int(rng.uniform(0, width)), int(rng.uniform(6, 24))
        image[:, x : x + thick] = rng.uniform(40, 220)
        for y in range(0, height, int(rng.uniform(60, 200))):
            image[y : y + thick // 2, x - 2 : x + thick + 2] = rng.uniform(40, 220)
    return image


def _grass(size: tuple[int, int], rng: np.random.Generator) -> GreyField:
    """Blades of grass, light and dark, over the whole image."""
    width, height = size
    image = _shade(fractal_noise(size, 128, rng), (60, 110, 100), 0.3)
    canvas = np.ascontiguousarray(np.clip(image, 0, 255).astype(np.uint8))
    for _ in range(4000):
        foot = rng.uniform((0, 0), (width, height))
        length = rng.uniform(0.01, 0.12) * height
        tip = foot + length * np.array([rng.normal(0, 0.4), -1])
        tone = np.array((70, 130, 125)) * rng.uniform(0.3, 1.9)
        ends = tuple(foot.astype(int)), tuple(tip.astype(int))
        cv2.line(canvas, *ends, tuple(tone), int(rng.integers(1, 5)), cv2.LINE_AA)
    return canvas.astype(np.float32)


def _snow(size: tuple[int, int], rng: np.random.Generator) -> GreyField:
    """Bright snow with soft shadows and thin dark twigs, under a dark or bright sky."""
    width, height = size
    image = _shade(fractal_noise(size, 512, rng), (225, 215, 205), 0.06)
    image[: int(height * rng.uniform(0, 0.4))] = rng.uniform(60, 240)
    canvas = np.ascontiguousarray(np.clip(image, 0, 255).astype(np.uint8))
    for _ in range(rng.integers(50, 300)):
        point = rng.uniform((0, 0), (width, height))
        heading = rng.uniform(-2.5, -0.6)
        for _ in range(6):
            end = point + rng.uniform(5, 40) * np.array([np.cos(heading), np.sin(heading)])
            ends = tuple(point.astype(int)), tuple(end.astype(int))
            cv2.line(canvas, *ends, (50, 55, 60), int(rng.integers(1, 4)), cv2.LINE_AA)
            point, heading = end, heading + rng.normal(0, 0.4)
    return canvas.astype(np.float32)


def _barriers(size: tuple[int, int], rng: np.random.Generator) -> GreyField:
    """Paint other striped things: barrier boards, a ladder, banded posts of wrong spacing."""
    width, height = size
    image = _shade(fractal_noise(size, 200, rng), (110, 125, 135), 0.3)
    for _ in range(rng.integers(2, 5)):
        y, thick = int(rng.uniform(0.2, 0.9) * height), int(rng.uniform(12, 50))
        stripe = int(rng.uniform(20, 90))
        for x in range(0, width, 2 * stripe):
            image[y : y + thick, x : x + stripe] = (30, 30, 200)
            image[y : y + thick, x + stripe : x + 2 * stripe] = (235, 235, 235)
    for _ in range(rng.integers(2, 6)):
        x, thick = int(rng.uniform(0, width)), int(rng.uniform(4, 40))
        band = thick * rng.uniform(0.8, 9)
        top, bands = rng.uniform(0, 0.5) * height, int(rng.integers(2, 9))
        for level in range(bands):
            y0, y1 = int(top + level * band), int(top + (level + 1) * band)
            image[y0:y1, x : x + thick] = 30 if level % 2 else 220
            band *= rng.choice([1.0, rng.uniform(0.8, 1.3)])
    x, rung = int(rng.uniform(0, width)), int(rng.uniform(15, 60))
    for y in range(0, height, rung):
        image[y : y + max(3, rung // 6), x : x + 3 * rung] = 200
    image[:, x : x + max(3, rung // 5)] = 190
    image[:, x + 3 * rung : x + 3 * rung + max(3, rung // 5)] = 190
    return image


KINDS: dict[str, Callable[[tuple[int, int], np.random.Generator], GreyField]] = {
    'forest': _forest,
    'fence': _fence,
    'facade': _facade,
    'grass': _grass,
    'snow': _snow,
    'barriers': _barriers,
}
