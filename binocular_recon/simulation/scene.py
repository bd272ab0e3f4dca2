# SPDX-License-Identifier: Apache-2.0
"""A survey scene at 10-20 m: two people and a bicycle of known size between textured walls."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from binocular_recon._jit import over_strips
from binocular_recon.camera import FloatArray, StereoRig
from binocular_recon.images import ByteImage
from binocular_recon.simulation._scene_kernels import (
    COLUMNS,
    ELLIPSOID,
    NOTHING,
    PLATE,
    paint_rows,
    trace_rows,
)
from binocular_recon.simulation.render import Sensor, expose
from binocular_recon.simulation.rig import RawRig, View, raw_camera
from binocular_recon.simulation.scene_things import (
    CAMERA_HEIGHT_M,
    UP,
    WHEELBASE_M,
    Builder,
    add_bicycle,
    add_person,
    surroundings,
)

PERSON_HEIGHTS_M = (1.795, 1.810)
SUN = np.array([0.45, -0.7, -0.55]) / np.linalg.norm([0.45, -0.7, -0.55])


@dataclass(frozen=True, eq=False)
class Scene:
    """Solids and the points whose distances are known.

    Attributes
    ----------
    solids : (N, 22) float64
        Solids as the kernels take them, in the rig's frame, m.
    owners : tuple of str
        What each solid belongs to: ``person_1``, ``bicycle``, ``ground`` ...
    points_xyz : dict of str to (3,) float64
        End points on the surface: ``person_1_top`` and ``_sole``, ``bicycle_front`` and ``_rear``
        hub, m.
    lengths_m : dict of str to float
        True sizes: heights are the difference of top and sole along ``up_xyz``, the wheelbase
        is the distance of the hubs.
    up_xyz : (3,) float64
        Unit vector against gravity in the rig's frame.

    """

    solids: FloatArray
    owners: tuple[str, ...]
    points_xyz: dict[str, FloatArray]
    lengths_m: dict[str, float]
    up_xyz: FloatArray = field(default_factory=lambda: UP)


def build_scene(rng: np.random.Generator) -> Scene:
    """Draw a scene: people and bicycle at 10-20 m, turned 0-60 degrees, side by side."""
    solids, owners = [], []
    points: dict[str, FloatArray] = {}
    lengths: dict[str, float] = {}
    bearings = rng.permutation(np.array([-0.17, 0.03, 0.23])) + rng.uniform(-0.035, 0.035, 3)
    for name, bearing in zip(('person_1', 'person_2', 'bicycle'), bearings, strict=True):
        depth = rng.uniform(10.0, 20.0)
        foot = np.array([bearing * depth, CAMERA_HEIGHT_M, depth])
        turn = float(rng.choice([-1, 1]) * np.deg2rad(rng.uniform(0.0, 60.0)))
        builder = Builder(rng, foot, turn)
        if name == 'bicycle':
            ends = add_bicycle(builder)
            lengths[name] = WHEELBASE_M
        else:
            lengths[name] = PERSON_HEIGHTS_M[int(name[-1]) - 1]
            ends = add_person(builder, lengths[name], rng)
        points |= {f'{name}_{end}': place for end, place in ends.items()}
        solids += builder.solids
        owners += [name] * len(builder.solids)
    around = surroundings(rng)
    solids += [solid for _, solid in around]
    owners += [owner for owner, _ in around]
    level = cv2.Rodrigues(rng.uniform((-0.03, 0.0, -0.02), (0.03, 0.0, 0.02)))[0]
    table = np.stack(solids)
    assert table.shape[1] == COLUMNS
    table[:, 1:4] = table[:, 1:4] @ level.T
    table[:, 4:13] = (table[:, 4:13].reshape(-1, 3, 3) @ level.T).reshape(-1, 9)
    points = {name: level @ point for name, point in points.items()}
    return Scene(table, tuple(owners), points, lengths, level @ UP)


def render_scene(scene: Scene, view: View, sensor: Sensor, rng: np.random.Generator) -> ByteImage:
    """Return what a raw camera sees: (H, W, 3) uint8, anti-aliased, with blur and noise."""
    width, height = view.camera.size
    image = np.zeros((height, width, 3), np.float32)
    over_strips(
        paint_rows, height, scene.solids, _boxes(scene, view), view.numbers, _pose(view),
        _sun(scene), image,
    )  # fmt: skip
    return expose(image, sensor, rng)


def trace_scene(scene: Scene, view: View) -> tuple[FloatArray, npt.NDArray[np.int32]]:
    """Return what the middle of each pixel sees.

    Returns
    -------
    depth_m : (H, W) float64
        Along the camera's axis; NaN = nothing.
    solid : (H, W) int32
        Index into ``scene.owners``; -1 = nothing.

    """
    width, height = view.camera.size
    depth = np.empty((height, width))
    label = np.full((height, width), NOTHING, np.int32)
    over_strips(
        trace_rows, height, scene.solids, _boxes(scene, view), view.numbers, _pose(view),
        depth, label,
    )  # fmt: skip
    return depth, label


def rectified_view(rig: StereoRig) -> View:
    """Return the rectified left camera of a rig as a view of the scene."""
    P = rig.left.P
    camera = raw_camera(rig.left.size, (P[0, 0], P[1, 1]), (P[0, 2], P[1, 2]))
    return View(camera, rig.left.R, np.zeros(3))


def true_disparity(scene: Scene, rig: StereoRig) -> npt.NDArray[np.float32]:
    """Return x_left - x_right of the rectified left image: (H, W) float32, NaN = none."""
    depth, _ = trace_scene(scene, rectified_view(rig))
    disparity = rig.focal_px * rig.baseline_m / depth + rig.disparity_offset_px
    return disparity.astype(np.float32)


def scene_truth(scene: Scene, rig: RawRig) -> dict[str, Any]:
    """Return the scene's truth under the keys of ``truth.json``."""
    left, right = rig.views()
    rectified = rectified_view(rig.stereo_rig())
    return {
        'rig': rig.to_mapping(),
        'lengths_m': scene.lengths_m,
        'up_xyz': scene.up_xyz.tolist(),
        'points': {
            name: {
                'xyz_m': point.tolist(),
                'left_px': left.project(point).tolist(),
                'right_px': right.project(point).tolist(),
                'rectified_left_px': rectified.project(point).tolist(),
            }
            for name, point in scene.points_xyz.items()
        },
    }


def _pose(view: View) -> FloatArray:
    """Return rotation and centre of a view as the kernels take them: (4, 3) float64."""
    return np.vstack([view.R, view.centre_xyz])


def _sun(scene: Scene) -> FloatArray:
    """Return the direction to the sun, which shines from where it does whatever the rig's roll."""
    side = np.cross(scene.up_xyz, [0.0, 0.0, 1.0])
    side /= np.linalg.norm(side)
    ahead = np.cross(side, scene.up_xyz)
    sun: FloatArray = SUN[0] * side - SUN[1] * scene.up_xyz + SUN[2] * ahead
    return sun


def _boxes(scene: Scene, view: View) -> npt.NDArray[np.int64]:
    """Return first column and row, last column and row of the pixels each solid may cover."""
    width, height = view.camera.size
    boxes = np.tile(np.array([0, 0, width - 1, height - 1]), (len(scene.solids), 1))
    centres = scene.solids[:, 1:4] @ view.R.T + view.T
    for i, solid in enumerate(scene.solids):
        if solid[0] == PLATE:
            continue
        size = solid[13:16]
        reach = max(size) if solid[0] == ELLIPSOID else size[0] + size[1]
        pixel = view.project(scene.solids[i, 1:4])
        # a ball is seen a little larger off the axis
        half = 1.4 * reach / max(centres[i, 2] - reach, 0.1) * view.camera.K[0, 0] + 3
        boxes[i] = [*np.floor(pixel - half), *np.ceil(pixel + half)]
    return boxes.astype(np.int64)
