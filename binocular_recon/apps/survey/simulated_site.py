# SPDX-License-Identifier: Apache-2.0
"""A simulated survey: what a crew takes home from a site, and the truth to compare with.

The files are those that a real survey has: images of the rods, one board more for the check
distance, an image pair of the site, picks, and coordinates of control and check points.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
import yaml

from binocular_recon.calibration.target.rods import save_rods
from binocular_recon.camera import FloatArray, StereoRig
from binocular_recon.io.files import complete_file, make_folder, write_json
from binocular_recon.io.image_files import write_image_file
from binocular_recon.io.text_files import read_json
from binocular_recon.measurement.picks import write_table
from binocular_recon.measurement.results import MEASUREMENTS_FILE
from binocular_recon.measurement.site.control_points import CONTROL_SIGMA_M
from binocular_recon.measurement.site.tie import TIE_FILE
from binocular_recon.measurement.snapping import PICK_SIGMA_PX
from binocular_recon.simulation.capture import simulate_capture
from binocular_recon.simulation.render import Sensor
from binocular_recon.simulation.rig import TABLE_1_PITCH_RAD, RawRig, survey_rig
from binocular_recon.simulation.rods import paper_board
from binocular_recon.simulation.scene import Scene, build_scene, render_scene, scene_truth
from binocular_recon.simulation.scene_things import Triple
from binocular_recon.simulation.survey_targets import with_targets
from binocular_recon.stereo.rectification import rectified_points

# To the right of the left camera, above the ground, ahead, m; those of CHECKS check the others.
TARGETS: dict[str, Triple] = {
    'T1': (-4.2, 1.6, 13.0),
    'T2': (5.0, 1.2, 14.5),
    'T3': (-1.0, 2.6, 17.0),
    'T4': (1.25, 0.5, 10.0),
    'C1': (-6.4, 2.2, 16.0),
    'C2': (5.6, 2.4, 12.0),
}
CHECKS = ('C1', 'C2')
# Where the left camera stands in UTM zone 32, and the azimuth that it looks along.
EPSG = 25832
PLACE_M, AZIMUTH_RAD = np.array([512345.0, 5412345.0, 301.5]), np.radians(30.0)
# What is measured: kind and picks by the name of the result.
MEASURED = {
    'height of person 1': ('upright', 'person_1_top', 'person_1_sole'),
    'height of person 2': ('upright', 'person_2_top', 'person_2_sole'),
    'wheelbase of the bicycle': ('wheelbase', 'bicycle_rear', 'bicycle_front'),
    'from target T1 to T2': ('distance', 'T1', 'T2'),
}


@dataclass(frozen=True, eq=False)
class SimulatedSite:
    """A site and what is known of it.

    Attributes
    ----------
    folder : Path
        Holds the files.
    rig : RawRig
    scene : Scene
    points_xyz : dict of str to (3,) float64
        Ends of things and middles of targets, in the rig's frame, m.

    """

    folder: Path
    rig: RawRig
    scene: Scene
    points_xyz: dict[str, FloatArray]

    @property
    def true_lengths_m(self) -> dict[str, float]:
        """True value of everything in `MEASURED`."""
        known, points = self.scene.lengths_m, self.points_xyz
        true = {}
        for name, (_, first, last) in MEASURED.items():
            thing = first.rpartition('_')[0]
            apart = float(np.linalg.norm(points[first] - points[last]))
            true[name] = known.get(thing, apart)
        return true

    def placed(self, scale: float = 1.0) -> dict[str, FloatArray]:
        """Return easting, northing and height of each target, m, on a map of this scale."""
        up = self.scene.up_xyz
        ahead = np.array([0.0, 0.0, 1.0]) - up[2] * up
        ahead /= np.linalg.norm(ahead)
        right = np.cross(ahead, up)
        turn = np.array([[np.cos(AZIMUTH_RAD), np.sin(AZIMUTH_RAD)],
                         [-np.sin(AZIMUTH_RAD), np.cos(AZIMUTH_RAD)]])  # fmt: skip
        axes = np.vstack([turn @ np.stack([right, ahead]), up])
        return {name: PLACE_M + scale * axes @ self.points_xyz[name] for name in TARGETS}


def simulate_survey(
    folder: Path,
    *,
    seed: int,
    boards: int,
    size: float = 1.0,
    report: Callable[[str], None] = lambda _: None,
) -> SimulatedSite:
    """Write the images of a survey and ``rods.yaml``.

    Parameters
    ----------
    folder : Path
    seed : int
    boards : int
        Boards to calibrate with.
    size : float
        Of the images, relative to 1920x1200.
    report : callable
        Takes a line for the user now and then.

    Raises
    ------
    FileError
        If they cannot be written.

    """
    rig, board = survey_rig(size, TABLE_1_PITCH_RAD), paper_board()
    for name in ('captures', 'check', 'left', 'right'):
        make_folder(folder / name)
    save_rods(board, folder / 'rods.yaml')
    for index in range(boards + 1):
        capture = simulate_capture(board, rig, np.random.default_rng([seed, index]))
        where = folder / ('captures' if index < boards else 'check')
        for side, image in (('left', capture.left), ('right', capture.right)):
            write_image_file(where / f'{side}_{index + 1:02d}.png', image)
        report(f'board {index + 1} of {boards + 1}')
    rng = np.random.default_rng(seed)
    scene, targets = with_targets(build_scene(rng), TARGETS, rng)
    for side, view in zip(('left', 'right'), rig.views(), strict=True):
        write_image_file(folder / side / '0001.png', render_scene(scene, view, Sensor(), rng))
    site = SimulatedSite(folder, rig, scene, {**scene.points_xyz, **targets})
    truth = scene_truth(scene, rig)
    write_json(folder / 'truth.json', {**truth, 'measured_m': site.true_lengths_m})
    return site


def write_field_book(
    site: SimulatedSite, calibrated: StereoRig, *, seed: int, scale: float
) -> None:
    """Write what a person picks and a total station measures: ``picks.yaml``, ``control.csv``.

    Parameters
    ----------
    site : SimulatedSite
    calibrated : StereoRig
        The calibration in use; picks are in its rectified left image.
    seed : int
        Of the noise of picks (0.3 px) and coordinates (5 mm).
    scale : float
        Of the map.

    Raises
    ------
    FileError
        If they cannot be written.

    """
    rng = np.random.default_rng([seed, 1])
    view = site.rig.views()[0]
    raw = np.stack([view.project(point) for point in site.points_xyz.values()])
    pixels = rectified_points(calibrated.left, raw + rng.normal(0, PICK_SIGMA_PX, raw.shape))
    picks = dict(zip(site.points_xyz, np.round(pixels, 1).tolist(), strict=True))
    content = {
        'picks': [{'name': name, 'frame': 0, 'u': u, 'v': v} for name, (u, v) in picks.items()],
        'measurements': [
            {'name': name, 'kind': kind, 'points': points}
            for name, (kind, *points) in MEASURED.items()
        ],
    }
    with complete_file(site.folder / 'picks.yaml') as file:
        file.write(yaml.safe_dump(content, sort_keys=False, default_flow_style=None).encode())
    rows = []
    for name, place in site.placed(scale).items():
        measured = (place + rng.normal(0, CONTROL_SIGMA_M, 3)).round(3).tolist()
        check = 'yes' if name in CHECKS else ''
        rows.append([name, *measured, *[CONTROL_SIGMA_M] * 3, check])
    columns = ('name', 'x', 'y', 'z', 'sigma_x', 'sigma_y', 'sigma_z', 'check')
    write_table(site.folder / 'control.csv', columns, rows)


class Compared(NamedTuple):
    """A value that the survey gave beside the true one; units are m."""

    name: str
    true: float
    measured: float
    sigma: float

    @property
    def off_sigmas(self) -> float:
        """Measured minus true, in standard deviations."""
        return (self.measured - self.true) / self.sigma


def compare(site: SimulatedSite, folder: Path) -> list[Compared]:
    """Return lengths and check points of an output folder beside the truth.

    Raises
    ------
    FileError
        If ``measurements.json`` or ``georeference.json`` cannot be read.

    """
    true = site.true_lengths_m
    compared = []
    for one in read_json(folder / MEASUREMENTS_FILE, 'measure again')['measurements']:
        main = next(value for value in one.values() if isinstance(value, dict))
        compared.append(Compared(one['name'], true[one['name']], main['value'], main['sigma']))
    for point in read_json(folder / TIE_FILE, 'georeference again')['points']:
        if point['check']:
            values = zip(point['place'], point['error_m'], point['error_sigma_m'], strict=True)
            for axis, (true_m, off, sigma) in zip('ENH', values, strict=True):
                name = f'{axis} of check point {point["name"]}'
                compared.append(Compared(name, true_m, true_m + off, sigma))
    return compared
