# SPDX-License-Identifier: Apache-2.0
"""Stations become one cloud: by control points, or by what they both see."""

from __future__ import annotations

import json
import shutil
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from binocular_recon.apps.stored_frame import stored_frames
from binocular_recon.apps.survey.measured_folder import MeasuredFolder
from binocular_recon.apps.survey.stations import merge_stations
from binocular_recon.camera import Camera, FloatArray, StereoRig
from binocular_recon.cli.main import main
from binocular_recon.config import ChainConfig
from binocular_recon.errors import ConfigError, DependencyError, FileError, MeasurementError
from binocular_recon.images import ByteImage
from binocular_recon.io.exports.point_table import PointChunk
from binocular_recon.io.files import write_json
from binocular_recon.io.ply import read_ply
from binocular_recon.measurement.site.tie import SiteTie
from binocular_recon.merging.overlap import find_pose
from binocular_recon.merging.voxels import VoxelCloud
from binocular_recon.rotations import rotation
from binocular_recon.stereo.filtering.wls_filter import Filtered
from binocular_recon.stereo.matching.matcher import Match
from binocular_recon.stereo.pipeline import Reconstruction
from binocular_recon.stereo.search_range import RangeChoice, SearchRange
from binocular_recon.stereo.triangulation import triangulate
from binocular_recon.stereo.validity import Validity
from test.frame_results import store_frames

WIDTH, HEIGHT, FOCAL, BASELINE_M, NOISE_PX = 240, 180, 210.0, 1.0, 0.06
P = np.array([[FOCAL, 0, 120, 0], [0, FOCAL, 90, 0], [0, 0, 1, 0]])
RIG = StereoRig(
    *(
        Camera(WIDTH, HEIGHT, P[:, :3], np.zeros(5), np.eye(3), p)
        for p in (P, P + np.array([[0, 0, 0, -FOCAL * BASELINE_M], [0] * 4, [0] * 4]))
    )
)
# Of each station: turn (rad) and place (m) in the room.
POSES = [
    (np.array([0.0, 0.0, 0.0]), np.array([0.0, 0.0, 0.0])),
    (np.array([0.02, 0.15, -0.03]), np.array([-1.2, 0.1, 0.4])),
    (np.array([-0.01, -0.12, 0.02]), np.array([1.0, -0.1, 0.2])),
]
# Floor, wall and side wall of the room: axis and place along it, m.
SURFACES = [(1, 2.0), (2, 11.0), (0, 4.5)]


def textures(seed: int) -> list[ByteImage]:
    rng = np.random.default_rng(seed)
    found = []
    for _ in SURFACES:
        image = sum(
            cv2.resize(rng.uniform(0, 255, (n, n)), (900, 900), interpolation=cv2.INTER_CUBIC)
            for n in (60, 150, 300)
        )
        found.append(cv2.normalize(np.asarray(image), None, 20, 235, cv2.NORM_MINMAX))
    return [one.astype(np.uint8) for one in found]


class Room:
    """Three surfaces with texture, and what a station sees of them."""

    def __init__(self, seed: int = 1) -> None:
        self.textures = textures(seed)
        self.rng = np.random.default_rng(seed)

    def frame(self, pose: tuple[FloatArray, FloatArray]) -> Reconstruction:
        R, place = rotation(pose[0]), pose[1]
        rows, columns = np.mgrid[:HEIGHT, :WIDTH].astype(np.float64)
        rays = np.stack([(columns - 120) / FOCAL, (rows - 90) / FOCAL, np.ones_like(rows)], -1)
        rays = rays @ R.T
        depth, grey = np.full(rows.shape, np.inf), np.zeros(rows.shape)
        for (axis, along), texture in zip(SURFACES, self.textures, strict=True):
            towards = np.where(rays[..., axis] == 0, 1e-9, rays[..., axis])
            reach = (along - place[axis]) / towards
            nearer = (reach > 0.1) & (reach < depth)
            depth = np.where(nearer, reach, depth)
            points = place + np.where(nearer, reach, 1.0)[..., None] * rays
            u, v = (np.clip(points[..., k], -30, 30) for k in range(3) if k != axis)
            shown = cv2.remap(
                texture, (40 * u + 400).astype(np.float32), (40 * v + 300).astype(np.float32),
                cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT,
            )  # fmt: skip
            grey = np.where(nearer, shown, grey)
        disparity = FOCAL * BASELINE_M / depth + self.rng.normal(0, NOISE_PX, depth.shape)
        disparity_px = disparity.astype(np.float32)
        sigma_px = np.full_like(disparity_px, NOISE_PX)
        measured = np.full(depth.shape, Validity.MEASURED, np.uint8)
        grey += self.rng.normal(0, 1, grey.shape)
        image = np.repeat(np.clip(np.rint(grey), 0, 255).astype(np.uint8)[..., None], 3, axis=-1)
        return Reconstruction(
            image, image, Match(disparity_px, sigma_px, measured),
            Filtered(disparity_px, sigma_px, measured, 1, 0.0),
            triangulate(disparity_px, sigma_px, measured, RIG, ChainConfig().cloud),
            RangeChoice(SearchRange(0, 128)),
        )  # fmt: skip


def stored(folder: Path, frames: list[Reconstruction]) -> MeasuredFolder:
    return store_frames(folder, RIG, frames)


@pytest.fixture(scope='module')
def stations(tmp_path_factory: pytest.TempPathFactory) -> list[MeasuredFolder]:
    room, folder = Room(), tmp_path_factory.mktemp('stations')
    return [stored(folder / str(k), [room.frame(pose)]) for k, pose in enumerate(POSES)]


def cloud_of(folder: Path) -> tuple[FloatArray, FloatArray]:
    """Return points, (N, 3), and sigmas, (N, 3), of ``cloud.ply``."""
    vertices, _ = read_ply(folder / 'cloud.ply')
    part = vertices[:]
    sigmas = [part[f'scalar_sigma_{axis}'] for axis in 'xyz']
    return np.stack([part[axis] for axis in 'xyz'], -1).astype(float), np.stack(sigmas, -1)


def errors(points: FloatArray) -> FloatArray:
    """Return the distance of points to the nearest surface of the room, m."""
    away = [np.abs(points[:, axis] - along) for axis, along in SURFACES]
    nearest: FloatArray = np.min(away, axis=0)
    return nearest


def test_a_pose_is_found_without_a_guess_and_as_exactly_as_it_says(
    stations: list[MeasuredFolder],
) -> None:
    for turn, place in POSES[1:]:
        number = next(k for k, one in enumerate(POSES) if one[1] is place)
        pose = find_pose(stations[number].frame(0), stations[0].frame(0))
        R = rotation(turn)
        here = R.T @ (pose.centre - place)
        off = np.concatenate(
            [cv2.Rodrigues(pose.R @ R.T)[0].ravel(), pose.R @ here + pose.t - pose.centre]
        )
        sigma = np.sqrt(np.diag(pose.covariance))
        assert np.abs(off / sigma).max() < 3.5
        assert np.linalg.norm(off[3:]) < 0.01 and np.linalg.norm(off[:3]) < 0.002
        assert sigma[3:].max() < 0.02


def test_stations_that_overlap_become_one_cloud(
    stations: list[MeasuredFolder], tmp_path: Path
) -> None:
    report: list[str] = []
    text = merge_stations(stations, tmp_path, 0.05, report=report.append)
    assert text.endswith(f'points of 3 stations in {tmp_path}, left rectified optical frame: x'
                         ' right, y down, z forward, metres, of the first station')  # fmt: skip
    points, sigmas = cloud_of(tmp_path)
    assert len(report) == 3 and not any('warning' in line for line in report)
    off = errors(points)
    assert np.median(off) < 0.02 and np.quantile(off, 0.95) < 0.15
    assert np.mean(off < 3 * np.linalg.norm(sigmas, axis=1)) > 0.99
    # each station adds what only it sees
    alone = [len(np.unique(np.floor(one.frame(0).points_xyz.reshape(-1, 3) / 0.05), axis=0))
             for one in stations]  # fmt: skip
    assert max(alone) < len(points) < sum(alone)
    with pytest.raises(FileError, match='holds the cloud of several stations, without images'):
        MeasuredFolder(tmp_path)
    with pytest.raises(FileError, match='give the output folder of one station'):
        next(stored_frames(tmp_path))
    entries = json.loads((tmp_path / 'stations.json').read_text())['stations']
    assert entries[0]['shared_features'] is None
    for entry in entries:
        assert entry['overlap'] > 0.3
        assert abs(entry['distance_median_m']) < 0.01


def georeferenced(folder: MeasuredFolder, number: int, off_m: float = 0.0) -> None:
    """Write where a station lies, wrong by ``off_m`` along each axis."""
    turn, place = POSES[number]
    tie = SiteTie(
        rotation(turn), 1.0, np.zeros(3), place + np.array([3.0e5, 5.0e6, 0.0]) + off_m,
        np.diag([1e-8] * 3 + [4e-6] * 3 + [0.0]), np.empty((7, 0)), facts={'crs': None},
    )  # fmt: skip
    write_json(folder.folder / 'georeference.json', tie.to_mapping())


def test_control_points_place_stations_and_a_wrong_one_is_named(tmp_path: Path) -> None:
    room = Room(2)
    folders = [stored(tmp_path / str(k), [room.frame(POSES[k])]) for k in (0, 1)]
    georeferenced(folders[0], 0)
    with pytest.raises(MeasurementError, match=r'1 has no georeference.json, 1 of the other'):
        merge_stations(folders, tmp_path / 'out', 0.05)
    georeferenced(folders[1], 1)
    report: list[str] = []
    text = merge_stations(folders, tmp_path / 'out', 0.05, report=report.append)
    assert text.endswith('frame of the site, metres')
    assert not any('warning' in line for line in report)
    points, sigmas = cloud_of(tmp_path / 'out')
    off = errors(points - np.array([3.0e5, 5.0e6, 0.0]))
    assert np.median(off) < 0.02
    assert np.mean(off < 3 * np.linalg.norm(sigmas, axis=1)) > 0.99
    georeferenced(folders[1], 1, off_m=0.12)
    report.clear()
    merge_stations(folders, tmp_path / 'out', 0.05, report=report.append)
    assert any(line.startswith('warning: ') and 'control points' in line for line in report)


def test_the_report_of_stations_states_their_residuals_and_places(
    stations: list[MeasuredFolder], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(stations[0].folder, tmp_path / 'Süd <0>')
    shutil.copytree(stations[1].folder, tmp_path / 'N')
    folders = [MeasuredFolder(tmp_path / name) for name in ('Süd <0>', 'N')]
    site = tmp_path / 'site'
    merge_stations(folders, site, 0.1)
    entries = json.loads((site / 'stations.json').read_text())['stations']
    assert main(['report', str(site), '--site', 'Quarry', '--date', '2026-05-11']) == 0
    html = (site / 'report.html').read_text()
    assert html.count('<img') == 1 + 2  # the cloud, and what each station saw
    words = ['Süd &lt;0&gt;', '11 May 2026', 'what they both see', '100 mm', 'Client']
    for entry in entries:
        words += [f'{100 * entry["overlap"]:.0f} %', f'{entry["voxels"]}']
        words += [f'{1e3 * entry[f"distance_{name}_m"]:.1f}' for name in ('median', 'rms')]
        words.append(f'{entry["distance_over_sigma"]:.2f}')
    words += [f'{place:.3f} ± ' for place in entries[1]['t']]
    assert [word for word in words if word not in html] == []
    # the second station stands where it was put, within what is stated of its place
    off = np.array(entries[1]['t']) - POSES[1][1]
    assert (np.abs(off) < 4 * np.array(entries[1]['place_sigma_m'])).all()
    assert max(entries[1]['place_sigma_m']) < 0.03
    # every point of the cloud is in the page: their number is that of the file
    count = len(cloud_of(site)[0])
    assert f'{count} of {count} points of all stations' in html
    assert main(['report', str(site), '--frames', '1']) == 2
    assert 'has no frames' in capsys.readouterr().err
    # a station that is gone is said, the rest is stated
    shutil.rmtree(tmp_path / 'N')
    assert main(['report', str(site)]) == 0
    html = (site / 'report.html').read_text()
    assert 'images and control points of N' in html and html.count('<img') == 2
    content = json.loads((site / 'stations.json').read_text())
    for damaged, message in (
        ({**content, 'stations': []}, 'does not list stations'),
        ({**content, 'stations': [{'folder': 3}]}, 'is not as our commands write it'),
        ({**content, 'voxel_size_m': 'x'}, 'is not as our commands write it'),
        ({'stations': content['stations']}, 'older version'),
    ):
        (site / 'stations.json').write_text(json.dumps(damaged))
        assert main(['report', str(site)]) == 1
        assert message in capsys.readouterr().err


def test_the_report_of_tied_stations_shows_control_points_in_the_frame_of_the_site(
    stations: list[MeasuredFolder], tmp_path: Path
) -> None:
    folders = []
    there, moved = tmp_path / 'there', tmp_path / 'moved'
    for number in (0, 1):
        shutil.copytree(stations[number].folder, there / f'station{number}')
        folders.append(MeasuredFolder(there / f'station{number}'))
        georeferenced(folders[-1], number)
        path = folders[-1].folder / 'georeference.json'
        tie = json.loads(path.read_text())
        one = {'name': 'K7', 'check': False, 'place': [1.25, 2.5, 3.75]}
        residual = {'residual_m': [0.0031, -0.002, 0.001], 'residual_sigma_m': [0.004] * 3}
        path.write_text(json.dumps({**tie, 'points': [one | residual]}))
    merge_stations(folders, there / 'site', 0.1)
    there.rename(moved)  # stations are found beside the cloud, too
    assert main(['report', str(moved / 'site')]) == 0
    html = (moved / 'site' / 'report.html').read_text()
    for words in ('station0: Control and check points', 'station1: Control and check points',
                  '+3.1 ± 4.0', 'frame of the site: X, Y, Z, metres, level',
                  '299998.800 ± 0.0020'):  # fmt: skip
        assert words in html, words


def test_stations_that_cannot_be_joined(
    stations: list[MeasuredFolder], tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    elsewhere = stored(tmp_path / 'elsewhere', [Room(9).frame(POSES[0])])
    with pytest.raises(MeasurementError, match=r'elsewhere: only \d+ features are seen in both'):
        merge_stations([stations[0], elsewhere], tmp_path / 'out', 0.05)
    frame = Room(3).frame(POSES[0])
    several = stored(tmp_path / 'several', [frame, frame])
    with pytest.raises(MeasurementError, match='holds 2 frames, a station has one'):
        merge_stations([stations[0], several], tmp_path / 'out', 0.05)
    with pytest.raises(ConfigError, match='holds what the result is made of'):
        merge_stations(stations, stations[1].folder, 0.05)
    again = MeasuredFolder(stations[0].folder / '..' / stations[0].folder.name)
    with pytest.raises(ConfigError, match='is given twice'):
        merge_stations([*stations, again], tmp_path / 'out', 0.05)
    with pytest.raises(ConfigError, match='must be among ply'):
        merge_stations(stations, tmp_path / 'out', 0.05, formats=['tiff'])
    monkeypatch.setitem(sys.modules, 'small_gicp', None)
    with pytest.raises(DependencyError, match=r'binocular_recon\[merge\]'):
        merge_stations(stations, tmp_path / 'out', 0.05)
    names = [str(one.folder) for one in stations]
    assert main(['merge', *names, '--output', str(tmp_path / 'out')]) == 1
    assert 'binocular_recon[merge]' in capsys.readouterr().err
    assert not (tmp_path / 'out' / 'cloud.ply').exists()


def chunk(x: float, sigma: float, validity: int, count: int = 1) -> PointChunk:
    scalars = {f'sigma_{axis}': np.full(count, sigma, np.float32) for axis in 'xyz'}
    xyz = np.tile([x, 0.05, 0.05], (count, 1))
    bits = np.full(count, validity, np.uint8)
    return PointChunk(xyz, np.full((count, 3), 100, np.uint8), {**scalars, 'validity': bits})


def test_points_of_a_cube_are_weighted_and_keep_what_they_share() -> None:
    cloud = VoxelCloud(0.1)
    assert cloud.add([chunk(-3.08, 0.01, 1), chunk(-3.08, 0.01, 1, 5)]) == 1
    cloud.add([chunk(-3.02, 0.02, 1)])
    cloud.add([chunk(-3.05, 0.001, 2), chunk(7.05, 0.03, 2)])
    cloud.add([])
    points = cloud.vertices()
    assert len(points) == 2
    low, high = points[np.argsort(points['x'])]
    assert low['x'] == pytest.approx((-3.08 * 4 - 3.02) / 5, abs=1e-6)
    # stations that contradict each other are not better than their distance
    assert low['scalar_sigma_x'] == pytest.approx(0.06 * np.sqrt(0.8 * 0.2), rel=1e-4)
    assert low['scalar_sigma_y'] == pytest.approx((0.01 * 4 + 0.02) / 5, rel=1e-4)
    assert (low['scalar_validity'], high['scalar_validity']) == (1, 2)
    assert (low['scalar_count'], high['scalar_count']) == (2, 1)
