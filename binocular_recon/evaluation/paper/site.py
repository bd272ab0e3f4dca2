# SPDX-License-Identifier: Apache-2.0
"""A simulated site: its scene, its image pair, and where a person picks the end points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from binocular_recon.camera import FloatArray
from binocular_recon.images import ByteImage
from binocular_recon.simulation.render import Sensor
from binocular_recon.simulation.rig import RawRig
from binocular_recon.simulation.scene import Scene, build_scene, render_scene

PICKS = 10

PICK_NOISE_PX = 0.3

# Pixels of the raw left image by name of the end point.
Pixels = dict[str, FloatArray]


@dataclass(frozen=True, eq=False)
class Site:
    """A simulated scene, its image pair, and where a person picks the end points.

    Attributes
    ----------
    seed : int
    rig : RawRig
    scene : Scene
    left, right : (H, W, 3) uint8
        Raw images.
    picks : list of dict of str to (2,) float64
        Raw left pixels of every end point, each time with new picking noise.

    """

    seed: int
    rig: RawRig
    scene: Scene
    left: ByteImage
    right: ByteImage
    picks: list[Pixels]


def simulate_site(seed: int, rig: RawRig, picks: int = PICKS) -> Site:
    """Simulate what a crew takes home: one image pair and ``picks`` picks of each end."""
    rng = np.random.default_rng(seed)
    scene = build_scene(rng)
    left, right = (render_scene(scene, view, Sensor(), rng) for view in rig.views())
    ends = {name: rig.views()[0].project(point) for name, point in scene.points_xyz.items()}
    noisy = [
        {name: end + rng.normal(0, PICK_NOISE_PX, 2) for name, end in ends.items()}
        for _ in range(picks)
    ]
    return Site(seed, rig, scene, left, right, noisy)
