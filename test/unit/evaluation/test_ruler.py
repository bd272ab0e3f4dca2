# SPDX-License-Identifier: Apache-2.0
"""Sizes measured in exact and in damaged clouds of a scene whose sizes are known."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from binocular_recon.camera import FloatArray, StereoRig
from binocular_recon.cloud_config import CloudConfig
from binocular_recon.errors import MeasurementError
from binocular_recon.measurement.frame import MeasuredFrame
from binocular_recon.measurement.picks import Pick
from binocular_recon.measurement.robust_fits import consensus_fit
from binocular_recon.measurement.ruler import Ruler
from binocular_recon.simulation.rig import survey_rig
from binocular_recon.simulation.scene import build_scene, rectified_view, true_disparity
from binocular_recon.stereo.rectification import Rectifier
from binocular_recon.stereo.validity import Validity

SCALE = 0.5


def at(column: float, row: float) -> Pick:
    return Pick(f'{column} {row}', np.array([column, row]))


@dataclass
class Site:
    rig: StereoRig
    disparity_px: npt.NDArray[np.float32]
    picks: dict[str, FloatArray]

    def frame(self, disparity_px: npt.NDArray[np.float32] | None = None) -> MeasuredFrame:
        disparity = self.disparity_px if disparity_px is None else disparity_px
        sigma = np.full_like(disparity, 0.1)
        measured = np.full(disparity.shape, Validity.MEASURED, np.uint8)
        grey = np.random.default_rng(0).integers(0, 256, disparity.shape, np.uint8)
        texture = np.stack([grey] * 3, axis=-1)
        limits = CloudConfig(max_depth=21.5)
        return MeasuredFrame(self.rig, disparity, sigma, measured, texture, limits=limits)

    def ruler(self, disparity_px: npt.NDArray[np.float32] | None = None) -> Ruler:
        return Ruler(self.frame(disparity_px))

    def ends(self, name: str) -> tuple[Pick, Pick]:
        both = ('rear', 'front') if name == 'bicycle' else ('top', 'sole')
        first, last = (f'{name}_{end}' for end in both)
        return Pick(first, self.picks[first]), Pick(last, self.picks[last])


@pytest.fixture(scope='module')
def site() -> Site:
    raw = survey_rig(SCALE).stereo_rig()
    scene, view = build_scene(np.random.default_rng(4)), rectified_view(raw)
    picks = {name: view.project(point) for name, point in scene.points_xyz.items()}
    return Site(Rectifier(raw).rig, true_disparity(scene, raw), picks)


def test_exact_cloud_gives_exact_sizes(site: Site) -> None:
    """A body's surface is some centimetres before its axis, of 13-16 m: a few mm of height."""
    ruler = site.ruler()
    assert ruler.camera_height_m == pytest.approx(1.5, abs=1e-3)
    for name, height in (('person_1', 1.795), ('person_2', 1.81)):
        ends = site.ends(name)
        assert ruler.height(*ends).values[0] == pytest.approx(height, abs=0.006)
        assert ruler.height_above_ground(*ends).values[0] == pytest.approx(height, abs=0.003)
        # a percentile leaves out the very top
        assert -0.04 < ruler.automatic_height_m(*ends) - height < 0.002
    assert ruler.wheelbase(*site.ends('bicycle')).values[0] == pytest.approx(1.0, abs=0.003)


def test_noise_and_outliers_in_the_cloud_change_little(site: Site) -> None:
    """0.1 px of noise everywhere, and one point in twenty somewhere else."""
    rng = np.random.default_rng(1)
    disparity = site.disparity_px + rng.normal(0, 0.1, site.disparity_px.shape)
    wrong = rng.random(disparity.shape) < 0.05
    disparity[wrong] += rng.uniform(-15, 15, wrong.sum())
    ruler = site.ruler(disparity.astype(np.float32))
    assert ruler.height(*site.ends('person_1')).values[0] == pytest.approx(1.795, abs=0.006)
    assert ruler.wheelbase(*site.ends('bicycle')).values[0] == pytest.approx(1.0, abs=0.008)


def test_a_hub_that_was_not_reconstructed_is_no_loss(site: Site) -> None:
    """What the cloud has there lies far behind; wheels and frame are enough."""
    disparity = site.disparity_px.copy()
    x, y = np.rint(site.picks['bicycle_front']).astype(int)
    cv2.circle(disparity, (x, y), 6, 25.0, -1)
    ruler = site.ruler(disparity)
    assert ruler.wheelbase(*site.ends('bicycle')).values[0] == pytest.approx(1.0, abs=0.006)


def test_wheels_that_matching_flattened_keep_their_distance(site: Site) -> None:
    """Half the slope within each wheel is lost; its middle is where it was."""
    disparity = site.disparity_px.copy()
    ends = site.ends('bicycle')
    length_px = ends[1].pixel[0] - ends[0].pixel[0]
    hubs_px = [site.disparity_px[round(y) - 2, round(x)] for x, y in (e.pixel for e in ends)]
    slope = (hubs_px[1] - hubs_px[0]) / length_px
    assert abs(slope) > 0.02
    half = round(0.36 * abs(length_px))
    for x, y in (end.pixel for end in ends):
        window = slice(round(y) - half, round(y) + half), slice(round(x) - half, round(x) + half)
        columns = np.arange(window[1].start, window[1].stop)
        disparity[window] -= 0.5 * slope * (columns - x)
    found = site.ruler(disparity).wheelbase(*ends).values[0]
    assert found == pytest.approx(1.0, abs=0.002)


def test_a_wheel_that_was_not_reconstructed_leaves_the_frame(site: Site) -> None:
    """In its place the cloud has what lies a metre behind."""
    disparity = site.disparity_px.copy()
    x, y = np.rint(site.picks['bicycle_front']).astype(int)
    behind = disparity[y, x] - 4.5
    disparity[y - 40 : y + 40, x - 10 : x + 40] = behind
    found = site.ruler(disparity).wheelbase(*site.ends('bicycle')).values[0]
    assert found == pytest.approx(1.0, abs=0.08)


def test_a_cloud_without_ground_or_thing_is_refused(site: Site) -> None:
    nothing = np.full_like(site.disparity_px, np.nan)
    with pytest.raises(MeasurementError, match='too few to find the ground'):
        site.ruler(nothing)
    upright = np.full_like(nothing, 50.0)
    with pytest.raises(MeasurementError, match='no level ground'):
        site.ruler(upright)
    hollow = site.disparity_px.copy()
    hollow[:280] = np.nan
    ruler = site.ruler(hollow)
    with pytest.raises(MeasurementError, match='no point between'):
        ruler.height(at(200.0, 50), at(200.0, 250))
    with pytest.raises(MeasurementError, match='no bicycle between'):
        ruler.wheelbase(at(200.0, 100), at(250.0, 100))


def test_consensus_is_the_line_of_the_majority() -> None:
    rng = np.random.default_rng(2)
    x = rng.uniform(-1, 1, 400)
    y = 3.0 + 2.0 * x + rng.normal(0, 0.01, 400)
    y[:150] = -2.0 * x[:150]
    design = np.stack([np.ones_like(x), x], -1)
    found = consensus_fit(design, y, np.ones(400), 0.05)
    assert found is not None
    np.testing.assert_allclose(found, np.array([3.0, 2.0]), atol=0.01)
    assert consensus_fit(design, y, np.ones(400), 0.05, lambda _: False) is None
