# SPDX-License-Identifier: Apache-2.0
"""CameraInfo messages."""

from __future__ import annotations

import array
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from binocular_recon.camera import Camera, StereoRig
from binocular_recon.errors import CalibrationError
from binocular_recon.io.messages.camera_infos import (
    camera_from_message,
    fill_camera_info,
    rig_from_messages,
    states_size,
)

HEADER = SimpleNamespace(stamp=SimpleNamespace(sec=3, nanosec=7), frame_id='left')


def rig() -> StereoRig:
    K = np.array([[500.0, 0, 320], [0, 501, 240], [0, 0, 1]])
    P = np.array([[480.0, 0, 300, 0], [0, 480, 250, 0], [0, 0, 1, 0]])
    D = np.array([0.1, -0.2, 0.001, 0.002, 0.3])
    right = P + np.array([[0, 0, 32.8, -480 * 0.5], [0] * 4, [0] * 4])
    return StereoRig(
        Camera(640, 480, K, D, np.eye(3), P), Camera(640, 480, K, D, np.eye(3), right)
    )


def info_message(camera: Camera, **members: Any) -> SimpleNamespace:
    message = SimpleNamespace(
        d=array.array('d'),
        k=np.zeros(9),
        r=np.zeros(9),
        p=np.zeros(12),
        binning_x=0,
        binning_y=0,
        roi=SimpleNamespace(x_offset=0, y_offset=0, width=0, height=0),
    )
    fill_camera_info(message, camera, HEADER)
    vars(message).update(members)
    return message


def test_camera_info_keeps_every_digit() -> None:
    left, right = rig().left, rig().right
    again = rig_from_messages(info_message(left), info_message(right))
    for camera, copy in ((left, again.left), (right, again.right)):
        assert copy.size == camera.size and copy.distortion_model == 'plumb_bob'
        for key in 'KDRP':
            np.testing.assert_array_equal(getattr(copy, key), getattr(camera, key))
    assert again.disparity_offset_px == pytest.approx(-32.8)


def test_camera_info_of_ros_1() -> None:
    message = info_message(rig().right)
    for key in 'kdrp':
        setattr(message, key.upper(), getattr(message, key))
        delattr(message, key)
    np.testing.assert_array_equal(camera_from_message(message).P, rig().right.P)


def test_binning_and_region_of_interest() -> None:
    roi = SimpleNamespace(x_offset=40, y_offset=20, width=400, height=300)
    camera = camera_from_message(info_message(rig().left, binning_x=2, binning_y=4, roi=roi))
    assert camera.size == (200, 75)
    np.testing.assert_allclose(camera.K, np.array([[250, 0, 140], [0, 125.25, 55], [0, 0, 1.0]]))
    np.testing.assert_allclose(
        camera.P[:, :3], np.array([[240, 0, 130], [0, 120, 57.5], [0, 0, 1.0]])
    )


@pytest.mark.parametrize(
    ('members', 'error'),
    [
        ({'k': np.zeros(9)}, r'right camera: camera is not calibrated \(fx = 0, fy = 0 px\)'),
        ({'d': [0.1, 0.2, 0.3]}, 'right camera: plumb_bob takes 0 or 4 or 5 .* got 3'),
        ({'distortion_model': 'mystery'}, "right camera: distortion model 'mystery' is not one"),
        ({'p': rig().left.P.ravel()}, 'baseline must be positive, got 0 m'),
        ({'k': np.full(9, np.nan)}, 'right camera: K holds values that are not finite'),
    ],
)
def test_bad_camera_info(members: dict[str, Any], error: str) -> None:
    with pytest.raises(CalibrationError, match=error):
        rig_from_messages(info_message(rig().left), info_message(rig().right, **members))


def test_infos_without_a_size_take_that_of_the_image() -> None:
    left, right = (info_message(camera, width=0, height=0) for camera in (rig().left, rig().right))
    assert not states_size(left)
    assert rig_from_messages(left, right, size=(640, 480)).left.size == (640, 480)
    with pytest.raises(CalibrationError, match='left camera: image size must be positive, got 0x'):
        rig_from_messages(left, right)
    stated = info_message(rig().left, height=360)
    assert states_size(stated)
    assert camera_from_message(stated, size=(9, 9)).size == (640, 360)


@pytest.mark.parametrize(
    'members',
    [
        {'binning_x': 2, 'binning_y': 2},
        {'roi': SimpleNamespace(x_offset=40, y_offset=20, width=400, height=300)},
    ],
)
def test_binning_and_region_are_not_applied_to_an_image_of_the_whole_sensor(
    members: dict[str, Any],
) -> None:
    message = info_message(rig().left, **members)
    assert not states_size(message)
    camera = camera_from_message(message, size=(640, 480))
    assert camera.size == (640, 480)
    np.testing.assert_array_equal(camera.K, rig().left.K)
    (notice,) = camera.notices
    assert 'are not applied: the image has all 640x480 px, not' in notice
    applied = camera_from_message(message)
    assert camera_from_message(message, size=applied.size).size == applied.size
    assert camera_from_message(message, size=applied.size).notices == ()


def test_binning_that_was_already_applied_is_said() -> None:
    """The driver halves K and P, and states binning too."""
    full = rig()
    infos = []
    for camera in (full.left, full.right):
        message = info_message(camera, binning_x=2, binning_y=2)
        for member in 'kp':
            values = np.array(getattr(message, member)).reshape(3, -1)
            values[:2] /= 2
            setattr(message, member, values.ravel())
        infos.append(message)
    twice = rig_from_messages(*infos)
    assert twice.left.size == (320, 240)
    assert [text[:11] for text in twice.warnings] == ['left camera', 'right camer']
    assert 'as in a calibration for 160x120 px (scale 0.50)' in twice.warnings[0]


def test_infos_of_rectified_images_need_only_p() -> None:
    left, right = (
        info_message(camera, k=np.zeros(9), d=[1.0, 2.0], r=np.zeros(9))
        for camera in (rig().left, rig().right)
    )
    found = rig_from_messages(left, right, rectified=True)
    assert found.baseline_m == pytest.approx(0.5)
    assert [text[:11] for text in found.notices] == ['left camera', 'right camer']
    with pytest.raises(CalibrationError, match='left camera: camera is not calibrated'):
        rig_from_messages(left, right)
