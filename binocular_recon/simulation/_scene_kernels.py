# SPDX-License-Identifier: Apache-2.0
"""Kernels that cast rays at textured solids."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from binocular_recon._jit import inline_kernel, kernel
from binocular_recon.camera import FloatArray
from binocular_recon.images import FloatImage
from binocular_recon.simulation._ray_kernels import ray_of_pixel

IntArray = npt.NDArray[np.int64]

NOTHING = -1
FAR_M = 1e9
# Kinds of solids, each along its own y axis: a rectangle (half sides a, b), an ellipsoid (half
# axes a, b, c), a rod with round ends (radius a, half length b without them), one with flat ends
# (radius a, half length b), a ring (radius a, tube b).
PLATE, ELLIPSOID, CAPSULE, CYLINDER, TORUS = range(5)
# Columns of a table of solids: kind, centre, rotation from the scene (row by row), sizes a, b, c,
# blue, green, red, contrast and coarsest wavelength of the texture, seed.
KIND, CENTRE, ROTATION, SIZE, COLOR, TEXTURE = 0, 1, 4, 13, 16, 19
COLUMNS = 22
# A distance-bounded march is at the surface when it is this near, m.
AT_SURFACE_M = 1e-6
MOST_STEPS = 200
OCTAVES = 6
# Light where no solid is.
SKY = 225.0


@inline_kernel
def _lattice(i: int, j: int, k: int, seed: int) -> float:
    """Return a number of -1..1 for a point of the integer lattice, always the same."""
    h = (i * 374761393 + j * 668265263 + k * 2147483647 + seed * 1274126177) & 0xFFFFFFFF
    h = ((h ^ (h >> 13)) * 1274126177) & 0xFFFFFFFF
    h = ((h ^ (h >> 16)) * 2246822519) & 0xFFFFFFFF
    return ((h ^ (h >> 15)) & 0xFFFFFF) / 8388607.5 - 1.0


@inline_kernel
def _noise(x: float, y: float, z: float, seed: int) -> float:
    """Return smooth noise with a period of about two units."""
    i, j, k = int(math.floor(x)), int(math.floor(y)), int(math.floor(z))  # noqa: RUF046
    u, v, w = x - i, y - j, z - k
    u, v, w = u * u * (3 - 2 * u), v * v * (3 - 2 * v), w * w * (3 - 2 * w)
    total = 0.0
    for c in range(8):
        a, b, d = c & 1, (c >> 1) & 1, c >> 2
        weight = (u if a else 1 - u) * (v if b else 1 - v) * (w if d else 1 - w)
        total += weight * _lattice(i + a, j + b, k + d, seed)
    return total


@inline_kernel
def _texture(solid: FloatArray, x: float, y: float, z: float, pixel_m: float) -> float:
    """Return brightness of a solid's paint at a point of its own frame.

    Octaves finer than two pixels are left out, softly: both cameras see the same.
    """
    length = solid[TEXTURE + 1]
    seed = int(solid[TEXTURE + 2])
    total = 0.0
    for octave in range(OCTAVES):
        seen = min(1.0, max(0.0, length / pixel_m - 1.0))
        if seen > 0:
            total += seen * _noise(x / length, y / length, z / length, seed + octave)
        length *= 0.5
    return float(max(0.1, 1 + solid[TEXTURE] * total))


@inline_kernel
def _distance(kind: int, size: FloatArray, x: float, y: float, z: float) -> float:
    """Return the signed distance of a point from a solid."""
    if kind == CAPSULE:
        beyond = max(0.0, abs(y) - size[1])
        return float(math.sqrt(x * x + beyond * beyond + z * z) - size[0])
    radius = math.sqrt(x * x + z * z)
    if kind == TORUS:
        return float(math.sqrt((radius - size[0]) ** 2 + y * y) - size[1])
    side, end = radius - size[0], abs(y) - size[1]
    outside = math.sqrt(max(side, 0.0) ** 2 + max(end, 0.0) ** 2)
    return float(outside + min(max(side, end), 0.0))


@inline_kernel
def _turn(solid: FloatArray, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Return a vector of the scene in the solid's own frame."""
    r = ROTATION
    return (
        solid[r] * x + solid[r + 1] * y + solid[r + 2] * z,
        solid[r + 3] * x + solid[r + 4] * y + solid[r + 5] * z,
        solid[r + 6] * x + solid[r + 7] * y + solid[r + 8] * z,
    )


@inline_kernel
def _ball(
    o: tuple[float, float, float], d: tuple[float, float, float], a: float, b: float, c: float
) -> tuple[float, float]:
    """Return where a ray enters and leaves an ellipsoid of half axes a, b, c, or FAR_M."""
    ox, oy, oz = o[0] / a, o[1] / b, o[2] / c
    dx, dy, dz = d[0] / a, d[1] / b, d[2] / c
    dd, od = dx * dx + dy * dy + dz * dz, ox * dx + oy * dy + oz * dz
    disc = od * od - dd * (ox * ox + oy * oy + oz * oz - 1)
    if disc <= 0:
        return FAR_M, FAR_M
    root = math.sqrt(disc)
    return (-od - root) / dd, (-od + root) / dd


@inline_kernel
def _hit(solid: FloatArray, o: tuple[float, float, float], d: tuple[float, float, float]) -> float:
    """Return how far along a ray of its own frame a solid is hit, FAR_M if not.

    ``d`` need not be of unit length; the result is in its units.
    """
    kind, size = int(solid[KIND]), solid[SIZE : SIZE + 3]
    if kind == PLATE:
        if abs(d[1]) < 1e-12:
            return FAR_M
        s = -o[1] / d[1]
        if s <= 0 or abs(o[0] + s * d[0]) > size[0] or abs(o[2] + s * d[2]) > size[1]:
            return FAR_M
        return s
    if kind == ELLIPSOID:
        s, last = _ball(o, d, size[0], size[1], size[2])
        return s if s > 0 else FAR_M
    reach = size[0] + size[1]
    s, last = _ball(o, d, reach, reach, reach)
    if s == FAR_M:
        return FAR_M
    unit = math.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
    s = max(s, 0.0)
    for _ in range(MOST_STEPS):
        gap = _distance(kind, size, o[0] + s * d[0], o[1] + s * d[1], o[2] + s * d[2])
        if gap < AT_SURFACE_M:
            return s
        s += gap / unit
        if s > last:
            return FAR_M
    return FAR_M


@inline_kernel
def _gather(boxes: IntArray, x: int, y: int, near: IntArray) -> int:
    """Write the solids whose boxes hold a pixel; return their number."""
    count = 0
    for i in range(boxes.shape[0]):
        if boxes[i, 0] <= x <= boxes[i, 2] and boxes[i, 1] <= y <= boxes[i, 3]:
            near[count] = i
            count += 1
    return count


@inline_kernel
def _nearest(
    solids: FloatArray, near: IntArray, centre: FloatArray, ray: tuple[float, float, float]
) -> tuple[int, float]:
    """Return which of the solids ``near`` a ray hits first (NOTHING = none), how far along it."""
    best, depth = NOTHING, FAR_M
    for i in near:
        solid = solids[i]
        o = _turn(
            solid,
            centre[0] - solid[CENTRE],
            centre[1] - solid[CENTRE + 1],
            centre[2] - solid[CENTRE + 2],
        )
        s = _hit(solid, o, _turn(solid, ray[0], ray[1], ray[2]))
        if s < depth:
            best, depth = i, s
    return best, depth


@inline_kernel
def _normal(solid: FloatArray, p: tuple[float, float, float]) -> tuple[float, float, float]:
    """Return the outward normal (not of unit length) at a surface point of the own frame."""
    kind, size = int(solid[KIND]), solid[SIZE : SIZE + 3]
    x, y, z = p
    if kind == PLATE:
        return 0.0, 1.0, 0.0
    if kind == ELLIPSOID:
        return x / size[0] ** 2, y / size[1] ** 2, z / size[2] ** 2
    e = 1e-4
    here = _distance(kind, size, x, y, z)
    return (
        _distance(kind, size, x + e, y, z) - here,
        _distance(kind, size, x, y + e, z) - here,
        _distance(kind, size, x, y, z + e) - here,
    )


@inline_kernel
def _light(
    solid: FloatArray,
    point: tuple[float, float, float],
    ray: tuple[float, float, float],
    sun: FloatArray,
    pixel_m: float,
) -> float:
    """Return the brightness of a solid at a point of the scene, seen along a ray."""
    p = _turn(
        solid, point[0] - solid[CENTRE], point[1] - solid[CENTRE + 1], point[2] - solid[CENTRE + 2]
    )
    d, toward = _turn(solid, ray[0], ray[1], ray[2]), _turn(solid, sun[0], sun[1], sun[2])
    n = _normal(solid, p)
    lit = (n[0] * toward[0] + n[1] * toward[1] + n[2] * toward[2]) / math.sqrt(
        n[0] ** 2 + n[1] ** 2 + n[2] ** 2 + 1e-30
    )
    if n[0] * d[0] + n[1] * d[1] + n[2] * d[2] > 0:
        lit = -lit
    return _texture(solid, p[0], p[1], p[2], pixel_m) * (0.55 + 0.45 * max(0.0, lit))


@inline_kernel
def _ray(x: float, y: float, camera: FloatArray, pose: FloatArray) -> tuple[float, float, float]:
    """Return the ray of a raw pixel in the scene, of camera depth 1."""
    u, v = ray_of_pixel(x, y, camera)
    return (
        u * pose[0, 0] + v * pose[1, 0] + pose[2, 0],
        u * pose[0, 1] + v * pose[1, 1] + pose[2, 1],
        u * pose[0, 2] + v * pose[1, 2] + pose[2, 2],
    )


@kernel
def trace_rows(
    solids: FloatArray,
    boxes: IntArray,
    camera: FloatArray,
    pose: FloatArray,
    depth: FloatArray,
    label: npt.NDArray[np.int32],
    start: int,
    stop: int,
) -> None:
    """Write what the middle of each pixel of rows start..stop - 1 sees.

    ``pose`` (4, 3): rotation from the scene to the camera, its centre. ``depth`` (H, W): along the
    camera's axis, NaN = nothing; ``label`` (H, W): index of the solid.
    """
    near = np.empty(solids.shape[0], np.int64)
    for y in range(start, stop):
        for x in range(depth.shape[1]):
            count = _gather(boxes, x, y, near)
            solid, s = _nearest(solids, near[:count], pose[3], _ray(x, y, camera, pose))
            label[y, x] = solid
            depth[y, x] = s if solid != NOTHING else np.nan


@kernel
def paint_rows(
    solids: FloatArray,
    boxes: IntArray,
    camera: FloatArray,
    pose: FloatArray,
    sun: FloatArray,
    image: FloatImage,
    start: int,
    stop: int,
) -> None:
    """Write the light of each pixel of rows start..stop - 1, the mean of four rays.

    ``pose`` (4, 3): rotation from the scene to the camera, its centre. ``image`` (H, W, 3).
    """
    near = np.empty(solids.shape[0], np.int64)
    centre = pose[3]
    for y in range(start, stop):
        for x in range(image.shape[1]):
            count = _gather(boxes, x, y, near)
            blue = green = red = 0.0
            for i in range(4):
                # a turned square: four rows and four columns
                ray = _ray(
                    x + (i - 1.5) / 4, y + ((2 * i + 1 - (i >> 1)) % 4 - 1.5) / 4, camera, pose
                )
                solid, s = _nearest(solids, near[:count], centre, ray)
                if solid == NOTHING:
                    blue, green, red = blue + SKY, green + SKY, red + SKY
                    continue
                point = (centre[0] + s * ray[0], centre[1] + s * ray[1], centre[2] + s * ray[2])
                light = _light(solids[solid], point, ray, sun, s / camera[0])
                blue += light * solids[solid, COLOR]
                green += light * solids[solid, COLOR + 1]
                red += light * solids[solid, COLOR + 2]
            image[y, x, 0], image[y, x, 1], image[y, x, 2] = blue / 4, green / 4, red / 4
