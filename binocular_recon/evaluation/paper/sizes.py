# SPDX-License-Identifier: Apache-2.0
"""Sizes of the people and the bicycle of a site, from picks, and their errors."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from binocular_recon.camera import Camera, FloatArray
from binocular_recon.evaluation.paper.site import Pixels, Site
from binocular_recon.measurement.ruler import Ruler, VerticalPlane
from binocular_recon.stereo.rectification import rectified_points

PEOPLE = 'person_1', 'person_2'

BICYCLE = 'bicycle'


def rectified(pick: Pixels, camera: Camera) -> Pixels:
    """Return raw pixels of a camera as pixels of its rectified image."""
    return {name: rectified_points(camera, raw[None])[0] for name, raw in pick.items()}


def heights(measure: Callable[[FloatArray, FloatArray], float], pick: Pixels) -> dict[str, float]:
    """Return the height of each person by ``measure``, m."""
    return {name: measure(pick[f'{name}_top'], pick[f'{name}_sole']) for name in PEOPLE}


def measured_sizes(ruler: Ruler, pick: Pixels) -> dict[str, float]:
    """Return the heights and the wheelbase that a pick gives in the cloud, m."""
    wheelbase = ruler.wheelbase_m(pick['bicycle_rear'], pick['bicycle_front'])
    return {**heights(ruler.height_m, pick), BICYCLE: wheelbase}


def ideal_sizes(site: Site, pick: Pixels) -> dict[str, float]:
    """Return the sizes that noisy picks yield on true planes, with the true calibration."""
    points, view = site.scene.points_xyz, site.rig.views()[0]
    up = site.scene.up_xyz
    side = np.cross([0.0, 0.0, 1.0], up)
    side /= np.linalg.norm(side)
    level = np.stack([side, up, np.cross(up, side)])

    def met(name: str, inverse: FloatArray) -> FloatArray:
        return VerticalPlane(inverse, level, 1.0).point(view.rays(pick[name]))

    def facing(name: str) -> FloatArray:
        return met(name, np.array([1 / (level[2] @ points[name]), 0.0]))

    hubs = [f'{BICYCLE}_rear', f'{BICYCLE}_front']
    across, _, ahead = (np.stack([points[name] for name in hubs]) @ level.T).T
    wheels = np.linalg.solve(np.stack([np.ones(2), across / ahead], -1), 1 / ahead)
    rear, front = (met(name, wheels) for name in hubs)
    return {
        **{n: float(up @ (facing(f'{n}_top') - facing(f'{n}_sole'))) for n in PEOPLE},
        BICYCLE: float(np.linalg.norm(front - rear)),
    }


def errors_mm(site: Site, sizes: list[dict[str, float]]) -> dict[str, list[float]]:
    """Return measured minus true sizes, one for each pick, mm."""
    true = site.scene.lengths_m
    return {name: [1e3 * (size[name] - true[name]) for size in sizes] for name in sizes[0]}
