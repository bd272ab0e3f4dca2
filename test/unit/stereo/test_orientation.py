# SPDX-License-Identifier: Apache-2.0
"""Rigs whose cameras stand one above the other give what the same rig gives lying on its side."""

from __future__ import annotations

import numpy as np
import pytest

from binocular_recon.camera import Camera, FloatArray, StereoRig
from binocular_recon.config import ChainConfig
from binocular_recon.evaluation.speed.synthetic import synthetic_pair
from binocular_recon.stereo.orientation import turn
from binocular_recon.stereo.pipeline import Chain
from binocular_recon.stereo.rectification import Rectifier

WIDTH, HEIGHT = 160, 120
LEFT_P = np.array([[150.0, 0, 83, 0], [0, 152, 57, 0], [0, 0, 1, 0]])
RIGHT_P = np.array([[150.0, 0, 79, -75], [0, 152, 57, 0], [0, 0, 1, 0]])
CONFIG = ChainConfig.preset('default', disparity_range=40)


def camera(P: FloatArray, size: tuple[int, int]) -> Camera:
    return Camera(*size, P[:, :3], np.zeros(5), np.eye(3), P)


def upright(P: FloatArray, turns: int) -> FloatArray:
    """Return P of a camera whose images must be turned by ``turns`` to be those of ``P``."""
    (fx, _, cx, tx), (_, fy, cy, _) = P[:2]
    # turned by 1, column and row become row and last column - column
    centre = (HEIGHT - 1 - cy, cx) if turns == 1 else (cy, WIDTH - 1 - cx)
    sign = 1 if turns == 1 else -1
    return np.array([[fy, 0, centre[0], 0], [0, fx, centre[1], sign * tx], [0, 0, 1, 0]])


@pytest.mark.parametrize('turns', [1, -1])
@pytest.mark.parametrize('rectify', [False, True])
def test_a_standing_rig_equals_a_lying_one(turns: int, rectify: bool) -> None:
    made = synthetic_pair(WIDTH, HEIGHT, 40, seed=2)
    lying = StereoRig(camera(LEFT_P, (WIDTH, HEIGHT)), camera(RIGHT_P, (WIDTH, HEIGHT)))
    standing = StereoRig(*(camera(upright(P, turns), (HEIGHT, WIDTH)) for P in (LEFT_P, RIGHT_P)))
    assert standing.turns == turns
    assert standing.disparity_offset_px == pytest.approx(lying.disparity_offset_px)
    expected = Chain(lying, CONFIG, rectify=rectify)(made.left, made.right)
    images = [turn(image, -turns) for image in (made.left, made.right)]
    found = Chain(standing, CONFIG, rectify=rectify)(*images)
    np.testing.assert_array_equal(found.left, images[0])
    for name in ('disparity_px', 'sigma_px', 'validity'):
        np.testing.assert_array_equal(
            turn(getattr(found.filtered, name), turns), getattr(expected.filtered, name)
        )
    np.testing.assert_array_equal(
        turn(found.matched.disparity_px, turns), expected.matched.disparity_px
    )
    # the frame of the camera is turned with its image
    points = turn(found.cloud.points_xyz, turns)
    x, y = (points[..., 1], -points[..., 0]) if turns == 1 else (-points[..., 1], points[..., 0])
    np.testing.assert_allclose(
        np.stack([x, y, points[..., 2]], -1), expected.cloud.points_xyz, atol=1e-4
    )
    assert np.isfinite(x).mean() > 0.4


def test_alpha_scales_the_baseline_of_a_standing_rig() -> None:
    P = upright(RIGHT_P, 1)
    rig = StereoRig(camera(upright(LEFT_P, 1), (HEIGHT, WIDTH)), camera(P, (HEIGHT, WIDTH)))
    assert Rectifier(rig, 0.0).rig.baseline_m == pytest.approx(rig.baseline_m)
