# SPDX-License-Identifier: Apache-2.0
"""Cameras and rigs: derived quantities and what is refused."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from binocular_recon.camera import Camera, StereoRig
from binocular_recon.errors import CalibrationError

K = np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]])


def make_camera(cx: float = 320.0, tx: float = 0.0) -> Camera:
    projection = np.array([[500.0, 0, cx, tx], [0, 500, 240, 0], [0, 0, 1, 0]])
    return Camera(640, 480, K, np.zeros(5), np.eye(3), projection)


@pytest.mark.parametrize('D', [[], np.zeros(4)])
def test_a_camera_without_a_distortion_model_has_no_distortion(D: Any) -> None:
    camera = dataclasses.replace(make_camera(), D=D, distortion_model='')
    assert camera.distortion_model == 'plumb_bob'
    np.testing.assert_array_equal(camera.D, np.zeros(5))


def test_baseline_focal_length_and_offset() -> None:
    rig = StereoRig(make_camera(), make_camera(cx=350.0, tx=-400.0))
    assert rig.baseline_m == pytest.approx(0.8)
    assert rig.focal_px == 500.0
    assert rig.disparity_offset_px == pytest.approx(-30.0)


@pytest.mark.parametrize(
    ('change', 'message'),
    [
        ({'K': np.zeros((3, 3))}, 'camera is not calibrated .*fx = 0'),
        ({'K': np.eye(2)}, 'K must have 9 values, got 4'),
        ({'K': K * np.nan}, 'K holds values that are not finite'),
        ({'P': np.zeros((3, 4))}, 'P is not that of a rectified camera'),
        ({'D': np.zeros(3)}, 'plumb_bob takes 0 or 4 or 5 distortion coefficients, got 3'),
        ({'distortion_model': 'fov'}, "distortion model 'fov' is not one of plumb_bob"),
        ({'distortion_model': '', 'D': np.array([0.1])}, "distortion model '' is not one of"),
        ({'width': 0}, 'image size must be positive, got 0x480'),
    ],
)
def test_bad_camera_is_refused(change: dict[str, Any], message: str) -> None:
    with pytest.raises(CalibrationError, match=message):
        dataclasses.replace(make_camera(), **change)


@pytest.mark.parametrize(
    ('right', 'message'),
    [
        (make_camera(tx=400.0), 'baseline must be positive, got -0.8 m'),
        (make_camera(tx=0.0), 'baseline must be positive, got 0 m'),
        (dataclasses.replace(make_camera(tx=-400.0), width=320), 'left camera is 640x480, right'),
        (
            dataclasses.replace(
                make_camera(), P=np.array([[500.0, 0, 320, -9], [0, 500, 230, 0], [0, 0, 1, 0]])
            ),
            'must share fx, fy and cy',
        ),
    ],
)
def test_bad_rig_is_refused(right: Camera, message: str) -> None:
    with pytest.raises(CalibrationError, match=message):
        StereoRig(make_camera(), right)
