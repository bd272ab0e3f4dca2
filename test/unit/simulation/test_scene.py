# SPDX-License-Identifier: Apache-2.0
"""The survey scene: sizes, end points and truth that agree with each other and the images."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from binocular_recon.apps.survey.simulated_site import TARGETS
from binocular_recon.cli.main import main
from binocular_recon.cli.quality import simulate
from binocular_recon.io.bags.reader import Bag
from binocular_recon.io.pfm import read_pfm
from binocular_recon.simulation.render import Sensor
from binocular_recon.simulation.rig import survey_rig
from binocular_recon.simulation.scene import (
    build_scene,
    rectified_view,
    render_scene,
    trace_scene,
    true_disparity,
)
from binocular_recon.simulation.survey_targets import with_targets

RIG = survey_rig(0.25)


def test_people_and_bicycle_have_their_sizes() -> None:
    for seed in range(8):
        scene = build_scene(np.random.default_rng(seed))
        points, up = scene.points_xyz, scene.up_xyz
        for name, height in (('person_1', 1.795), ('person_2', 1.810)):
            rise = (points[f'{name}_top'] - points[f'{name}_sole']) @ up
            assert rise == pytest.approx(height, abs=1e-9)
        wheelbase = np.linalg.norm(points['bicycle_front'] - points['bicycle_rear'])
        assert wheelbase == pytest.approx(1.0, abs=1e-9)
        depth = [point[2] for point in points.values()]
        assert min(depth) > 9.0 and max(depth) < 21.0


@pytest.mark.long
def test_end_points_are_in_both_images_and_on_their_owner() -> None:
    """The ray to an end point meets the thing itself within 15 cm, at the point or next to it."""
    rig = survey_rig()
    left, right = rig.views()
    for seed in range(2):
        scene = build_scene(np.random.default_rng(seed))
        depth, label = trace_scene(scene, left)
        for name, point in scene.points_xyz.items():
            x, y = np.rint(left.project(point)).astype(int)
            assert 0 < x < 1919 and 0 < y < 1199
            assert (right.project(point) > 0).all()
            around = slice(y - 3, y + 4), slice(x - 3, x + 4)
            owners = {scene.owners[i] for i in label[around].ravel() if i >= 0}
            assert name.rsplit('_', 1)[0] in owners
            # what is seen there is this thing: nothing stands in front of it
            assert np.abs(depth[around] - point[2]).min() < 0.15


def test_depth_and_disparity_agree_with_the_projection() -> None:
    """Points traced from the left image, projected to the right: x differs by the disparity."""
    scene = build_scene(np.random.default_rng(1))
    rig = RIG.stereo_rig()
    view = rectified_view(rig)
    depth, _ = trace_scene(scene, view)
    disparity = true_disparity(scene, rig)
    assert np.isfinite(disparity).mean() > 0.99
    y, x = np.mgrid[20:280:37, 30:450:41]
    y, x = y[np.isfinite(depth[y, x])], x[np.isfinite(depth[y, x])]
    rays = view.rays(np.stack([x, y], -1).astype(float))
    points = rays * depth[y, x][..., None]
    right = points @ RIG.R.T + RIG.T
    local = right @ rig.right.R.T
    P = rig.right.P
    x_right = P[0, 0] * local[..., 0] / local[..., 2] + P[0, 2]
    y_right = P[1, 1] * local[..., 1] / local[..., 2] + P[1, 2]
    np.testing.assert_allclose(x - x_right, disparity[y, x], atol=1e-3)
    np.testing.assert_allclose(y_right, y, atol=1e-3)


def test_ground_is_a_plane_below_the_rig() -> None:
    scene = build_scene(np.random.default_rng(2))
    view = rectified_view(RIG.stereo_rig())
    depth, label = trace_scene(scene, view)
    ground = label == scene.owners.index('ground')
    assert ground.mean() > 0.1
    y, x = np.nonzero(ground)
    points = view.rays(np.stack([x, y], -1).astype(float)) * depth[ground][:, None]
    np.testing.assert_allclose(points @ -scene.up_xyz, 1.5, atol=1e-6)


def test_images_are_textured_and_the_same_in_both_cameras() -> None:
    scene = build_scene(np.random.default_rng(3))
    rng = np.random.default_rng(0)
    quiet = Sensor(noise=0.0)
    left, right = (render_scene(scene, view, quiet, rng).astype(float) for view in RIG.views())
    views = RIG.views()
    depth, label = trace_scene(scene, views[0])
    wall = np.isin(label, [i for i, owner in enumerate(scene.owners) if owner == 'wall'])
    assert left[wall].std() > 8.0
    # the wall's texture, looked up in the right image through the true geometry
    y, x = np.nonzero(wall & (np.arange(label.shape[1]) > 150))
    points = views[0].rays(np.stack([x, y], -1).astype(float)) * depth[y, x][:, None]
    u, v = np.rint(views[1].project(points)).astype(int).T
    inside = (u >= 0) & (u < 480) & (v >= 0) & (v < 300)
    same = np.corrcoef(left[y[inside], x[inside], 1], right[v[inside], u[inside], 1])[0, 1]
    assert same > 0.8


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(simulate, 'survey_rig', lambda pitch_rad: survey_rig(0.25, pitch_rad))


@pytest.mark.usefixtures('small')
def test_command_writes_a_bag_that_reconstructs_to_its_truth(tmp_path: Path) -> None:
    out, clouds = tmp_path / 'out', tmp_path / 'clouds'
    scene = ['simulate', 'scene', '--output', str(out), '--seed', '3', '--frames', '2']
    assert main(scene) == 0
    truth = json.loads((out / 'truth.json').read_text())
    assert truth['lengths_m'] == {'person_1': 1.795, 'person_2': 1.81, 'bicycle': 1.0}
    true = read_pfm(out / 'disparity.pfm')
    # dense: every ray below the sky meets something
    assert true.shape == (300, 480) and np.isfinite(true).mean() > 0.99
    done = main(['reconstruct', str(out / 'bag'), '--output', str(clouds), '--max-frames', '1'])
    assert done == 0
    summary = json.loads((clouds / 'summary.json').read_text())
    assert summary['frames'][0]['density'] == 1.0
    with Bag(out / 'bag') as bag:
        counts = {topic.name.lstrip('/'): topic.message_count for topic in bag.topics}
    assert counts['left/image_raw'] == counts['right/camera_info'] == 2
    error = np.abs(read_pfm(clouds / '000000_disparity.pfm') - true)
    # left of column 100 much is seen by one camera only
    assert np.nanmedian(error[:, 100:]) < 0.2
    assert np.nanmean(error[:, 100:] > 1) < 0.12


@pytest.mark.usefixtures('small')
def test_command_says_where_it_cannot_write(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / 'taken').write_text('a file')
    assert main(['simulate', 'scene', '--output', str(tmp_path / 'taken')]) == 1
    assert 'taken cannot be made' in capsys.readouterr().err


def test_targets_stand_where_they_are_said_to() -> None:
    rig = survey_rig(0.3)
    rng = np.random.default_rng(3)
    scene, middles = with_targets(build_scene(rng), TARGETS, rng)
    view = rig.views()[0]
    depth_m, labels = trace_scene(scene, view)
    ground = view.rays(np.array([[290.0, 340.0]]))[0]  # a ray that meets the ground
    ground = ground * depth_m[340, 290]
    for name, middle in middles.items():
        column, row = np.rint(view.project(middle)).astype(int)
        assert scene.owners[labels[row, column]] == 'target', name
        assert depth_m[row, column] == pytest.approx(middle[2], abs=0.02)
        assert (middle - ground) @ scene.up_xyz == pytest.approx(TARGETS[name][1], abs=0.01)
