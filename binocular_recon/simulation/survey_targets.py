# SPDX-License-Identifier: Apache-2.0
"""Survey targets in a scene: plates quartered black and white, on poles, at known places."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from binocular_recon.camera import FloatArray
from binocular_recon.simulation._scene_kernels import CYLINDER
from binocular_recon.simulation.scene import Scene
from binocular_recon.simulation.scene_things import CAMERA_HEIGHT_M, Builder, Triple

# Half side of a plate, and radius of its pole, m.
_HALF_M, _POLE_M = 0.2, 0.02
_BLACK, _WHITE, _GREY = (45.0, 45.0, 45.0), (225.0, 225.0, 225.0), (120.0, 120.0, 120.0)


def with_targets(
    scene: Scene, places: dict[str, Triple], rng: np.random.Generator
) -> tuple[Scene, dict[str, FloatArray]]:
    """Put targets into a scene.

    Parameters
    ----------
    scene : Scene
    places : dict of str to (float, float, float)
        By name: metres to the right of the left camera, above the ground, and ahead.
    rng : numpy.random.Generator
        Source of their texture.

    Returns
    -------
    scene : Scene
        The scene with them; they face the cameras.
    middles : dict of str to (3,) float64
        The middle of each, where the quarters meet, in the rig's frame, m.

    """
    up = scene.up_xyz
    # the rows of the ground's rotation are its axes: to the right, and ahead
    ground = scene.solids[scene.owners.index('ground'), 4:13].reshape(3, 3)
    right, ahead = ground[0], ground[2]
    builder = Builder(rng, np.zeros(3), 0.0)
    middles = {}
    for name, (x, height, z) in places.items():
        foot = x * right - CAMERA_HEIGHT_M * up + z * ahead
        middles[name] = middle = foot + height * up
        builder.limb(foot, middle - _HALF_M * up, _POLE_M, _GREY, CYLINDER)
        for across, above in ((1, 1), (-1, 1), (-1, -1), (1, -1)):
            quarter = middle + 0.5 * _HALF_M * (across * right + above * up)
            colour = _WHITE if across == above else _BLACK
            builder.plate(quarter, 0.5 * _HALF_M * right, 0.5 * _HALF_M * up, colour)
    owners = (*scene.owners, *(['target'] * len(builder.solids)))
    solids = np.vstack([scene.solids, *builder.solids])
    return replace(scene, solids=solids, owners=owners), middles
