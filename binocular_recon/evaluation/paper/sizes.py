# SPDX-License-Identifier: Apache-2.0
"""Sizes of the people and the bicycle of a site, from picks, and their errors."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TypeVar

import numpy as np

from binocular_recon.camera import Camera, FloatArray
from binocular_recon.evaluation.paper.site import Pixels, Site
from binocular_recon.measurement.picks import Pick
from binocular_recon.measurement.ruler import Ruler, VerticalPlane
from binocular_recon.measurement.uncertain import Uncertain
from binocular_recon.stereo.rectification import rectified_points

PEOPLE = 'person_1', 'person_2'

BICYCLE = 'bicycle'

_Size = TypeVar('_Size', float, Uncertain)


# Picks in the rectified image, by name of the end point.
Picks = dict[str, Pick]


def rectified(pick: Pixels, camera: Camera) -> Picks:
    """Return raw pixels of a camera as picks in its rectified image."""
    return {name: Pick(name, rectified_points(camera, raw[None])[0]) for name, raw in pick.items()}


def heights(measure: Callable[[Pick, Pick], _Size], pick: Picks) -> dict[str, _Size]:
    """Return the height of each person by ``measure``."""
    return {name: measure(pick[f'{name}_top'], pick[f'{name}_sole']) for name in PEOPLE}


def measured_sizes(ruler: Ruler, pick: Picks) -> dict[str, Uncertain]:
    """Return the heights and the wheelbase that a pick gives in the cloud, m."""
    wheelbase = ruler.wheelbase(pick[f'{BICYCLE}_rear'], pick[f'{BICYCLE}_front'])
    return {**heights(ruler.height, pick), BICYCLE: wheelbase}


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


def errors_mm(
    site: Site, sizes: Sequence[Mapping[str, float | Uncertain]]
) -> dict[str, list[float]]:
    """Return measured minus true sizes, one for each pick, mm."""
    true = site.scene.lengths_m
    return {
        name: [1e3 * (_metres(size[name]) - true[name]) for size in sizes] for name in sizes[0]
    }


def sigmas_mm(sizes: Sequence[Mapping[str, Uncertain]]) -> dict[str, list[float]]:
    """Return the stated standard deviation of sizes, one for each pick, mm."""
    return {name: [1e3 * float(size[name].sigma[0]) for size in sizes] for name in sizes[0]}


def _metres(size: float | Uncertain) -> float:
    return float(size.values[0]) if isinstance(size, Uncertain) else size
