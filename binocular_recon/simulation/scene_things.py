# SPDX-License-Identifier: Apache-2.0
"""The things of a survey scene, put together from textured solids."""

from __future__ import annotations

import cv2
import numpy as np

from binocular_recon.camera import FloatArray
from binocular_recon.simulation._scene_kernels import (
    CAPSULE,
    CYLINDER,
    ELLIPSOID,
    PLATE,
    TORUS,
)

WHEELBASE_M = 1.0
# Scene axes before the rig is levelled: x right, y down, z ahead; the ground is this far below.
CAMERA_HEIGHT_M = 1.5
WALL_DEPTH_M, WALL_SIDE_M, WALL_HEIGHT_M = 24.0, 10.0, 12.0
UP = np.array([0.0, -1.0, 0.0])
Triple = tuple[float, float, float]


class Builder:
    """Collects the solids of one thing, placed and turned as a whole."""

    def __init__(self, rng: np.random.Generator, foot_xyz: FloatArray, turn_rad: float) -> None:
        self._rng, self._foot = rng, foot_xyz
        self._turn = cv2.Rodrigues(np.array([0.0, turn_rad, 0.0]))[0]
        self.solids: list[FloatArray] = []

    def point(self, x: float, height: float, z: float) -> FloatArray:
        """Return a point of the scene from x, height and z of the thing."""
        placed: FloatArray = self._foot + self._turn @ np.array([x, -height, z])
        return placed

    def add(
        self,
        kind: int,
        centre: FloatArray,
        size: Triple,
        color: Triple,
        axis: FloatArray | None = None,
        contrast: float = 0.22,
        wavelength_m: float = 0.25,
    ) -> None:
        """Add a solid whose y axis lies along ``axis`` (the thing's own up unless given)."""
        rotation = self._turn.T if axis is None else _frame(axis)
        paint = [contrast, wavelength_m, float(self._rng.integers(1 << 20))]
        self.solids.append(np.concatenate([[kind], centre, rotation.ravel(), size, color, paint]))

    def plate(self, centre: FloatArray, one: FloatArray, other: FloatArray, color: Triple) -> None:
        """Add a rectangle from its middle and its two half sides."""
        sizes = float(np.linalg.norm(one)), float(np.linalg.norm(other)), 0.0
        x, z = one / sizes[0], other / sizes[1]
        self.add(PLATE, centre, sizes, color, np.cross(z, x), 0.3, 0.5)
        self.solids[-1][4:13] = np.stack([x, np.cross(z, x), z]).ravel()

    def limb(
        self, start: FloatArray, end: FloatArray, radius: float, color: Triple, kind: int = CAPSULE
    ) -> None:
        """Add a rod between two points of the scene."""
        axis = end - start
        length = float(np.linalg.norm(axis))
        self.add(kind, 0.5 * (start + end), (radius, length / 2, 0.0), color, axis / length)


def _frame(axis: FloatArray) -> FloatArray:
    """Return a rotation into a frame whose y axis is ``axis``."""
    other = np.array([1.0, 0, 0]) if abs(axis[0]) < 0.8 else np.array([0, 0, 1.0])
    x = np.cross(axis, other)
    x /= np.linalg.norm(x)
    frame: FloatArray = np.stack([x, axis, np.cross(x, axis)])
    return frame


def _cloth(rng: np.random.Generator) -> Triple:
    blue, green, red = rng.uniform(60, 190) + rng.uniform(-30, 30, 3)
    return float(blue), float(green), float(red)


def add_person(b: Builder, height: float, rng: np.random.Generator) -> dict[str, FloatArray]:
    """Add a person who stands on one straight leg under the head, the other a step aside."""
    skin = (150.0, 175.0, 205.0)
    # muted: cloth, not paint
    shirt, trousers, hair = (_cloth(rng) for _ in range(3))
    shoe = 0.055
    head_half = 0.125
    hip, shoulder = 0.52 * height, 0.81 * height
    b.add(ELLIPSOID, b.point(0, height - head_half, 0), (0.085, head_half, 0.1), hair,
          wavelength_m=0.1)  # fmt: skip
    b.limb(b.point(0, shoulder, 0), b.point(0, height - 1.6 * head_half, 0), 0.055, skin)
    b.add(ELLIPSOID, b.point(0, 0.5 * (hip + shoulder), 0), (0.2, 0.21 * height, 0.13), shirt)
    step = float(rng.uniform(0.18, 0.3) * rng.choice([-1, 1]))
    # the standing leg reaches the ground with a flat sole
    b.limb(b.point(0, 0.0, 0), b.point(0, 0.1, 0), shoe + 0.01, (60.0, 60.0, 70.0), CYLINDER)
    b.limb(b.point(0, 0.09, 0), b.point(0, hip, 0), 0.075, trousers)
    b.limb(b.point(step, shoe, 0.1), b.point(0.5 * step, hip, 0), 0.07, trousers)
    b.add(ELLIPSOID, b.point(step, 0.05, 0.06), (0.05, 0.05, 0.13), (60.0, 60.0, 70.0))
    for side in (-1, 1):
        elbow = b.point(side * 0.29, 0.63 * height, rng.uniform(-0.05, 0.1))
        b.limb(b.point(side * 0.2, shoulder - 0.03, 0), elbow, 0.05, shirt)
        b.limb(elbow, b.point(side * 0.27, 0.48 * height, rng.uniform(-0.2, 0.0)), 0.042, skin)
    top = b.point(0, height, 0)
    # of the sole's rim the point towards the camera
    axis = b.point(0, 0, 0)
    sight = np.array([-axis[0], 0.0, -axis[2]])
    return {'top': top, 'sole': axis + (shoe + 0.01) * sight / np.linalg.norm(sight)}


def add_bicycle(b: Builder) -> dict[str, FloatArray]:
    """Add a bicycle that stands broadside before it is turned."""
    radius, tyre, hub_half = 0.34, 0.024, 0.045
    dark, frame = (45.0, 45.0, 50.0), (60.0, 70.0, 190.0)
    across = b.point(0, 0, 1) - b.point(0, 0, 0)
    ends = {}
    hubs = {}
    for name, x in (('rear', -WHEELBASE_M / 2), ('front', WHEELBASE_M / 2)):
        hubs[name] = b.point(x, radius, 0)
        b.add(TORUS, hubs[name], (radius - tyre, tyre, 0), dark, across, wavelength_m=0.1)
        b.add(CYLINDER, hubs[name], (0.07, hub_half, 0), (185.0, 185.0, 190.0), across,
              contrast=0.35, wavelength_m=0.06)  # fmt: skip
        for spoke in range(9):
            angle = 2 * np.pi * spoke / 9
            rim = radius - tyre
            end = b.point(x + rim * np.cos(angle), radius + rim * np.sin(angle), 0)
            b.limb(hubs[name], end, 0.004, (150.0, 150.0, 150.0))
        # the end of the axle on the side of the camera
        side = -np.sign(across @ hubs[name])
        ends[name] = hubs[name] + side * hub_half * across
    crank, seat = b.point(-0.07, 0.29, 0), b.point(-0.2, 0.8, 0)
    head, fork = b.point(0.33, 0.82, 0), b.point(0.36, 0.72, 0)
    for start, end in ((crank, seat), (crank, fork), (seat, head), (hubs['rear'], crank),
                       (hubs['rear'], seat), (hubs['front'], head)):  # fmt: skip
        b.limb(start, end, 0.02, frame)
    b.limb(seat, b.point(-0.22, 0.92, 0), 0.016, dark)
    b.add(ELLIPSOID, b.point(-0.22, 0.95, 0), (0.14, 0.035, 0.07), dark)
    b.limb(head, b.point(0.34, 1.0, 0), 0.016, dark)
    b.limb(b.point(0.36, 1.02, -0.28), b.point(0.36, 1.02, 0.28), 0.016, dark)
    return ends


def surroundings(rng: np.random.Generator) -> list[tuple[str, FloatArray]]:
    """Return ground, back wall, side walls and posts, each with its name."""
    b = Builder(rng, np.zeros(3), 0.0)
    y, half, tall = CAMERA_HEIGHT_M, WALL_DEPTH_M / 2, WALL_HEIGHT_M / 2
    across, ahead = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])
    b.plate(np.array([0, y, half]), across * WALL_SIDE_M, ahead * half, (105.0, 120.0, 125.0))
    back = np.array([0, y - tall, WALL_DEPTH_M])
    b.plate(back, across * WALL_SIDE_M, UP * tall, (110.0, 130.0, 160.0))
    for side in (-1.0, 1.0):
        centre = np.array([side * WALL_SIDE_M, y - tall, half])
        b.plate(centre, ahead * half, UP * tall, (120.0, 125.0, 130.0))
    names = ['ground', 'wall', 'wall', 'wall']
    for _ in range(3):
        x, z = rng.choice([-1, 1]) * rng.uniform(5.5, 8.5), rng.uniform(14, 22)
        foot, top = np.array([x, y, z]), np.array([x, y - rng.uniform(1.5, 4), z])
        b.limb(foot, top, rng.uniform(0.06, 0.2), (90.0, 105.0, 115.0), CYLINDER)
        names.append('post')
    return list(zip(names, b.solids, strict=True))
