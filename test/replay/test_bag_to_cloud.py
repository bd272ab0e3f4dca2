# SPDX-License-Identifier: Apache-2.0
"""From a bag to clouds without ROS, with bounds in px and mm."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from binocular_recon.apps.frame_formats import FRAME_FORMATS
from binocular_recon.camera import Camera, StereoRig
from binocular_recon.cli.main import main
from binocular_recon.io.bags.writer import BagWriter, write_pair
from binocular_recon.io.calibration_yaml import write_camera
from binocular_recon.io.image_files import read_image_file
from binocular_recon.io.pfm import read_pfm
from test.replay.clouds import read_ply

# A wall that slants from 5 to 9 m, seen by a rig with distortion, a turn between the cameras and
# different principal points.
WIDTH, HEIGHT, FOCAL_PX, BASELINE_M, OFFSET_PX = 320, 240, 300.0, 0.6, -3.2
START_NS, PERIOD_NS = 1_600_000_000_000_000_000, 100_000_000


def raw_rig() -> StereoRig:
    cameras = []
    for cx, tx, turn in ((160.0, 0.0, 0.02), (163.2, -FOCAL_PX * BASELINE_M, -0.01)):
        K = np.array([[310.0, 0, 155], [0, 310, 125], [0, 0, 1]])
        P = np.array([[FOCAL_PX, 0, cx, tx], [0, FOCAL_PX, 118.0, 0], [0, 0, 1, 0]])
        R = cv2.Rodrigues(np.array([turn, 2 * turn, -turn]))[0]
        D = np.array([-0.12, 0.05, 1e-3, -5e-4, 0.0])
        cameras.append(Camera(WIDTH, HEIGHT, K, D, R, P))
    return StereoRig(*cameras)


def true_disparity(x_left: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Return x_left - x_right of the wall; a plane's disparity is linear in the image."""
    return OFFSET_PX + 20.0 + 16.0 * (x_left / WIDTH)


def raw_image(camera: Camera, index: int, *, right: bool) -> npt.NDArray[np.uint8]:
    """Return the image that a camera takes of the wall."""
    columns, rows = np.meshgrid(np.arange(WIDTH, dtype=float), np.arange(HEIGHT, dtype=float))
    raw = np.stack([columns, rows], axis=-1).reshape(-1, 1, 2)
    rectified = cv2.undistortPoints(raw, camera.K, camera.D, R=camera.R, P=camera.P[:, :3])
    x, y = rectified.reshape(HEIGHT, WIDTH, 2).transpose(2, 0, 1)
    if right:  # x_right = x_left - OFFSET_PX - 20 - 16 / WIDTH x_left
        x = (x + OFFSET_PX + 20.0) / (1 - 16.0 / WIDTH)
    noise = np.random.default_rng(index).integers(0, 256, (300, 500, 3), np.uint8)
    texture = cv2.GaussianBlur(cv2.resize(noise, None, fx=2, fy=2), (0, 0), 2.0)
    texture = cv2.normalize(texture, None, 0, 255, cv2.NORM_MINMAX)
    # two texture pixels per pixel
    maps = [(2 * at + 150).astype(np.float32) for at in (x, y)]
    return np.asarray(cv2.remap(texture, *maps, cv2.INTER_CUBIC), np.uint8)


def write_wall(path: Path, frames: int = 2) -> Path:
    rig = raw_rig()
    with BagWriter(path) as writer:
        for index in range(frames):
            pair = (
                raw_image(rig.left, index, right=False),
                raw_image(rig.right, index, right=True),
            )
            write_pair(writer, rig, pair, START_NS + index * PERIOD_NS)
    return path


@pytest.fixture(scope='module')
def wall(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Return the bag and the output folder of `reconstruct`."""
    folder = tmp_path_factory.mktemp('wall')
    bag = write_wall(folder / 'bag')
    words = ['reconstruct', str(bag), '--output', str(folder / 'out'), '--disparity-range', '48']
    assert main([*words, '--drawings']) == 0
    return bag, folder / 'out'


def test_disparity_of_raw_distorted_images_is_that_of_the_wall(wall: tuple[Path, Path]) -> None:
    for index in range(2):
        disparity_px = read_pfm(wall[1] / f'{index:06d}_disparity.pfm')
        error_px = np.abs(disparity_px - true_disparity(np.arange(WIDTH, dtype=float)))
        inner = error_px[24:-24, 48:-24]
        assert np.median(inner) < 0.06
        assert np.mean(inner < 0.3) > 0.97


def test_cloud_is_the_wall_to_millimetres(wall: tuple[Path, Path]) -> None:
    vertices = read_ply(wall[1] / '000000.ply')
    x, y, z = vertices['xyz'].astype(float).T
    u, v = FOCAL_PX * x / z + 160.0, FOCAL_PX * y / z + 118.0
    inner = (u > 48) & (u < WIDTH - 24) & (v > 24) & (v < HEIGHT - 24)
    truth_m = FOCAL_PX * BASELINE_M / (true_disparity(u) - OFFSET_PX)
    error_mm = 1000 * np.abs(z - truth_m)[inner]
    # 0.1 px is 14 mm at 5 m and 45 mm at 9 m
    assert np.median(error_mm) < 15
    assert np.percentile(error_mm, 95) < 80
    sigma_mm = 1000 * vertices['sigma_z'][inner]
    assert 3 < np.median(sigma_mm) < 300
    # near things lie to the right
    assert np.median(z[inner & (u < 80)]) > np.median(z[inner & (u > 260)]) + 2


def test_summary_says_what_was_done(wall: tuple[Path, Path]) -> None:
    bag, output = wall
    summary = json.loads((output / 'summary.json').read_text())
    frames = summary['frames']
    assert [frame['index'] for frame in frames] == [0, 1]
    assert [frame['stamp_ns'] for frame in frames] == [START_NS, START_NS + PERIOD_NS]
    for frame in frames:
        assert frame['density'] == 1.0
        z = read_ply(output / f'{frame["index"]:06d}.ply')['xyz'][:, 2]
        assert frame['points'] == len(z)
        expected = {'min': z.min(), 'median': np.median(z), 'max': z.max()}
        assert frame['depth_m'] == pytest.approx(expected, abs=1e-3)
        assert 0 < frame['seconds'] < 60
    assert summary['preset'] == 'default'
    assert summary['options']['match']['disparity_range'] == 48
    assert summary['source']['bag'] == str(bag)
    assert summary['calibration']['baseline_m'] == pytest.approx(BASELINE_M)
    assert summary['calibration']['disparity_offset_px'] == pytest.approx(OFFSET_PX)
    assert summary['calibration']['left']['D'] == raw_rig().left.D.tolist()
    assert summary['left_out'] == summary['damage'] == []
    assert summary['finished'] is True
    assert {'binocular_recon', 'python', 'numpy', 'opencv', 'rosbags'} <= set(summary['versions'])
    names = {path.name for path in output.iterdir()}
    endings = {one.ending for one in FRAME_FORMATS.values() if not one.on_request} | {'_cloud.png'}
    assert names == {'summary.json', 'frames.jsonl'} | {
        f'00000{i}{ending}' for i in (0, 1) for ending in endings
    }
    heat = read_image_file(output / '000000_disparity.png')
    assert heat.shape[0] == HEIGHT and heat.shape[1] > WIDTH  # with a colour bar
    assert summary['baseline_m'] == pytest.approx(BASELINE_M)
    assert summary['focal_px'] == pytest.approx(FOCAL_PX)
    # 48 disparities from 0 on: f B / (d - o)
    searched = [FOCAL_PX * BASELINE_M / (47 - OFFSET_PX), FOCAL_PX * BASELINE_M / -OFFSET_PX]
    assert summary['depth_searched_m'] == pytest.approx(searched)


def test_a_calibration_folder_replaces_that_of_the_bag(
    wall: tuple[Path, Path], tmp_path: Path
) -> None:
    rig = raw_rig()
    left = Camera(WIDTH, HEIGHT, rig.left.K, rig.left.D, rig.left.R, rig.left.P)
    P = rig.right.P * np.array([[1, 1, 1, 0.5]])
    right = Camera(WIDTH, HEIGHT, rig.right.K, rig.right.D, rig.right.R, P)
    write_camera(tmp_path / 'left.yaml', left, 'left')
    write_camera(tmp_path / 'right.yaml', right, 'right')
    words = ['--calibration', str(tmp_path), '--max-frames', '1', '--disparity-range', '48']
    out = tmp_path / 'out'
    assert main(['reconstruct', str(wall[0]), '--output', str(out), *words]) == 0
    half, whole = (read_ply(folder / '000000.ply')['xyz'] for folder in (out, wall[1]))
    assert not (out / '000001.ply').exists()
    np.testing.assert_allclose(half, whole / 2, rtol=1e-4)


def test_thinned_clouds_hold_fewer_points_on_the_same_surface(
    wall: tuple[Path, Path], tmp_path: Path
) -> None:
    """Disparities, and so everything else, are those of the whole cloud."""
    bag, whole = wall
    words = ['reconstruct', str(bag), '--disparity-range', '48', '--max-frames', '1']
    edge_m = 0.25
    counts = {}
    for name, options in (('rows', ['--decimation', '4']), ('cubes', ['--voxel-size', '0.25'])):
        assert main([*words, '--output', str(tmp_path / name), *options]) == 0
        vertices = read_ply(tmp_path / name / '000000.ply')
        summary = json.loads((tmp_path / name / 'summary.json').read_text())
        assert summary['frames'][0]['points'] == len(vertices)
        assert 'turned by 2.807 deg against' in summary['frame']
        counts[name] = len(vertices)
        # the plane of the wall: f B / z = 20 + 16 (f x / z + cx) / WIDTH
        x, _, z = vertices['xyz'].astype(float).T
        true_z = (FOCAL_PX * BASELINE_M - 16 * FOCAL_PX * x / WIDTH) / (20 + 16 * 160.0 / WIDTH)
        assert np.median(np.abs(z - true_z)) < 0.02
        disparity = (tmp_path / name / '000000_disparity.pfm').read_bytes()
        assert disparity == (whole / '000000_disparity.pfm').read_bytes()
    every = read_ply(whole / '000000.ply')
    cells = np.unique(np.floor(every['xyz'] / np.float64(edge_m)), axis=0)
    assert counts['cubes'] == len(cells) < 0.1 * len(every)
    assert counts['rows'] == pytest.approx(len(every) / 16, rel=0.05)
