# SPDX-License-Identifier: Apache-2.0
"""Kernels that cast rays at banded cylinders."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from binocular_recon._jit import inline_kernel, kernel
from binocular_recon.camera import FloatArray
from binocular_recon.images import Mask

Canvas = npt.NDArray[np.float32]
Spans = npt.NDArray[np.int64]

MISS = -1
# Fixed-point steps; each gains about a factor of 10 on ordinary lenses.
UNDISTORT_STEPS = 8
# Rays per pixel across an edge or side: SUB x SUB, no two in one row or column.
SUB = 8


@inline_kernel
def ray_of_pixel(x: float, y: float, camera: FloatArray) -> tuple[float, float]:
    """Return the undistorted ray (X / Z, Y / Z) of a raw pixel.

    ``camera`` is fx, fy, cx, cy, k1, k2, p1, p2, k3 (plumb_bob).
    """
    x0, y0 = (x - camera[2]) / camera[0], (y - camera[3]) / camera[1]
    u, v = x0, y0
    for _ in range(UNDISTORT_STEPS):
        r2 = u * u + v * v
        radial = 1 + r2 * (camera[4] + r2 * (camera[5] + r2 * camera[8]))
        u_next = (x0 - 2 * camera[6] * u * v - camera[7] * (r2 + 2 * u * u)) / radial
        v = (y0 - camera[6] * (r2 + 2 * v * v) - 2 * camera[7] * u * v) / radial
        u = u_next
    return u, v


@kernel
def _hit(u: float, v: float, rod: FloatArray, marks: FloatArray) -> tuple[int, float]:
    """Return the band that a ray hits (MISS = none) and the light that it reflects.

    ``rod`` is foot (3), direction (3), sun (3), radius, length, ambient, grime, seed.
    """
    a0, a1, a2 = rod[3], rod[4], rod[5]
    along_ray = u * a0 + v * a1 + a2
    along_foot = rod[0] * a0 + rod[1] * a1 + rod[2] * a2
    # ray and foot without their parts along the axis
    d0, d1, d2 = u - along_ray * a0, v - along_ray * a1, 1 - along_ray * a2
    f0, f1, f2 = rod[0] - along_foot * a0, rod[1] - along_foot * a1, rod[2] - along_foot * a2
    dd = d0 * d0 + d1 * d1 + d2 * d2
    df = d0 * f0 + d1 * f1 + d2 * f2
    disc = df * df - dd * (f0 * f0 + f1 * f1 + f2 * f2 - rod[9] * rod[9])
    if disc <= 0:
        return MISS, 0.0
    s = (df - math.sqrt(disc)) / dd
    height = s * along_ray - along_foot
    normal = (s * d0 - f0) * rod[6] + (s * d1 - f1) * rod[7] + (s * d2 - f2) * rod[8]
    normal /= rod[9]
    if height > rod[10]:
        # over the rim: the top disc, if the ray enters it from above
        s = (rod[10] + along_foot) / along_ray
        r0, r1, r2 = s * d0 - f0, s * d1 - f1, s * d2 - f2
        if along_ray >= 0 or r0 * r0 + r1 * r1 + r2 * r2 > rod[9] * rod[9]:
            return MISS, 0.0
        height = rod[10]
        normal = a0 * rod[6] + a1 * rod[7] + a2 * rod[8]
    if s <= 0 or height < 0:
        return MISS, 0.0
    band = 0
    while band < marks.size and height >= marks[band]:
        band += 1
    light = rod[11] + (1 - rod[11]) * max(0.0, normal)
    phase = 7.3 * rod[13]
    light *= 1 + rod[12] * math.sin(23 * height + phase) * math.sin(
        9 * height + 2 * normal + phase
    )
    return band, light


@kernel
def draw_cylinder(
    canvas: Canvas,
    spans: Spans,
    camera: FloatArray,
    rod: FloatArray,
    marks: FloatArray,
    light_bands: Mask,
    colors: FloatArray,
) -> None:
    """Draw a banded cylinder over ``canvas`` (H, W, 3), within ``spans`` (row, first, last).

    ``light_bands`` (M + 1,) and ``colors`` (2, 3): which bands have the second colour.
    """
    for k in range(spans.shape[0]):
        y = spans[k, 0]
        for x in range(spans[k, 1], spans[k, 2] + 1):
            band, light, uniform = _probe(x, y, camera, rod, marks)
            if uniform:
                if band != MISS:
                    for c in range(3):
                        canvas[y, x, c] = light * colors[int(light_bands[band]), c]
                continue
            dark, bright, covered = _cover(x, y, camera, rod, marks, light_bands)
            for c in range(3):
                canvas[y, x, c] = (
                    (1 - covered) * canvas[y, x, c] + dark * colors[0, c] + bright * colors[1, c]
                )


@inline_kernel
def _probe(
    x: int, y: int, camera: FloatArray, rod: FloatArray, marks: FloatArray
) -> tuple[int, float, bool]:
    """Return band and light of a pixel, and whether its corners agree on the band."""
    u, v = ray_of_pixel(x, y, camera)
    band, light = _hit(u, v, rod, marks)
    total = light
    for i in range(4):
        u, v = ray_of_pixel(x - 0.5 + (i & 1), y - 0.5 + (i >> 1), camera)
        corner, light = _hit(u, v, rod, marks)
        if corner != band:
            return band, 0.0, False
        total += light
    return band, total / 5, True


@inline_kernel
def _cover(
    x: int, y: int, camera: FloatArray, rod: FloatArray, marks: FloatArray, light_bands: Mask
) -> tuple[float, float, float]:
    """Return the light from dark bands, from light bands, and the covered share of a pixel."""
    dark = bright = 0.0
    hits = 0
    for i in range(SUB):
        for j in range(SUB):
            # a sheared grid: SUB * SUB different rows and columns
            sx = x - 0.5 + (i + (j + 0.5) / SUB) / SUB
            sy = y - 0.5 + (j + (i + 0.5) / SUB) / SUB
            u, v = ray_of_pixel(sx, sy, camera)
            band, light = _hit(u, v, rod, marks)
            if band != MISS:
                hits += 1
                if light_bands[band]:
                    bright += light
                else:
                    dark += light
    share = 1.0 / (SUB * SUB)
    return dark * share, bright * share, hits * share
