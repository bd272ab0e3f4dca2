# SPDX-License-Identifier: Apache-2.0
"""Faults of cameras and poses are said, and which camera is left; on Kalibr's camchains."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from binocular_recon.errors import CalibrationError
from binocular_recon.io.calibration_yaml import read_rig
from binocular_recon.io.calibrations.raw_rig import Choice
from binocular_recon.io.calibrations.registry import read_calibration
from test.unit.io.calibrations.foreign_files import (
    LEFT_K,
    Change,
    Pose,
    R,
    T,
    kalibr,
    mrcal,
    opencv_sample,
    put,
    true_rig,
)


def step(value: np.ndarray[Any, Any]) -> Change:
    return put('cam1', 'T_cn_cnm1', value=value.tolist())


MIRROR = np.diag([1.0, 1, -1, 1])
POSE = Pose(R, T).matrix


@pytest.mark.parametrize(
    ('change', 'message'),
    [
        (put('cam1', value=None), r'one camera only \(cam0\) \(Kalibr\); a rig needs both'),
        (put('cam1', 'T_cn_cnm1', value=None), 'pose of cam1 is missing.*T_cn_cnm1'),
        (put('cam0', 'resolution', value=None), r'cam0: the image size is missing.*--image-size'),
        (put('cam0', 'resolution', value=[752.5, 480]), 'is 752.5x480 px, it must be two whole'),
        (put('cam0', 'camera_model', value='omni'), "camera model 'omni' is not read, only pinh"),
        (put('cam0', 'camera_model', value='ds'), "camera model 'ds' is not read"),
        (put('cam0', 'camera_model', value='eucm'), "camera model 'eucm' is not read"),
        (put('cam1', 'distortion_model', value=None), 'cam1 has no distortion_model, only'),
        (put('cam1', 'distortion_model', value='fov'), "distortion model 'fov' is not read"),
        (put('cam1', 'intrinsics', value=[1, 2, 3]), 'cam1: intrinsics must have 4 values, got 3'),
        (put('cam1', 'intrinsics', value=None), 'cam1 has no intrinsics, only T_cn_cnm1'),
        (put('cam0', 'intrinsics', value=[0.6, 0.6, 0.5, 0.5]), 'state them in pixels'),
        (put('cam0', 'intrinsics', value=[-1, 1, 5, 5]), 'camera is not calibrated'),
        (put('cam0', 'distortion_coeffs', value=['.nan', 0, 0, 0]), "'.nan', which is not a numb"),
        (
            put('cam0', 'distortion_coeffs', value=[1e300, 0, 0, 0]),
            'not a number below 1000000000000;',
        ),
        (put('cam0', 'distortion_coeffs', value=[True, 0, 0, 0]), "'True', which is not a numb"),
        (put('cam0', 'distortion_coeffs', value=[[0] * 500]), 'more than 256 values'),
        (step(POSE @ MIRROR), r'not a rotation but a reflection \(determinant -1\)'),
        (step(POSE.T), 'last row is -0.91 .*its rows and columns are exchanged'),
        (step(POSE * 1.1), 'it must be 0 0 0 1'),
        (step(np.vstack([POSE[:3] * 1.1, POSE[3:]])), 'R R.T is 0.21 from the identity'),
        (step(np.eye(4)), 'cam0 and cam1 stand at the same place'),
        (step(Pose(np.eye(3), np.array([0.05, 0, -0.9])).matrix), 'one stands in front of the o'),
        (step(Pose(np.diag([-1.0, -1, 1]), T).matrix), 'turned against each other by 180 degrees'),
    ],
)
def test_faults_of_a_camchain(tmp_path: Path, change: Change, message: str) -> None:
    (path,) = kalibr(tmp_path, change)
    with pytest.raises(CalibrationError, match=message) as error:
        read_rig(path)
    assert str(path) in str(error.value)


def test_left_camera_by_the_pose_and_by_names(tmp_path: Path) -> None:
    inverted = np.linalg.inv(POSE)
    found = read_calibration(kalibr(tmp_path, step(inverted)))
    assert found.names == ('cam1', 'cam0')
    assert 'cam0 stands 0.910 m to its right, by their pose' in found.rig.notices[0]

    def named(chain: dict[str, Any]) -> None:
        step(inverted)(chain)
        for name, side in (('cam0', 'left'), ('cam1', 'right')):
            chain[name]['rostopic'] = f'/rig/{side}/image_raw'

    with pytest.raises(CalibrationError, match=r'named right \(cam1\) stands 0.910 m to the left'):
        read_calibration(kalibr(tmp_path, named))
    names = mrcal(tmp_path, ('cam_r', 'cam_l'))
    with pytest.raises(CalibrationError, match=r'named right \(cam_r\) stands .*exchange the nam'):
        read_calibration(names)


def test_one_camera_above_the_other(tmp_path: Path) -> None:
    below = Pose(np.eye(3), np.array([0.01, -0.8, 0.0])).matrix
    rig = read_calibration(kalibr(tmp_path, step(below))).rig
    assert rig.turns == 1 and rig.baseline_m == pytest.approx(np.hypot(0.8, 0.01))
    assert 'cam1 stands 0.800 m below it, so cam0, the first one, is taken' in rig.notices[0]


def test_more_cameras_and_the_choice_of_two(tmp_path: Path) -> None:
    def third(chain: dict[str, Any]) -> None:
        chain['cam2'] = {**chain['cam1'], 'T_cn_cnm1': POSE.tolist()}

    (path,) = kalibr(tmp_path, third)
    whole = path.read_text()
    path.write_text(
        whole.replace('cam2:\n', 'cam2:\n  camera_model: omni\n').replace(
            'camera_model: pinhole\n  distortion_coeffs: [-0.26',
            'was: 1\n  distortion_coeffs: [-0.26',
        )
    )
    found = read_calibration([path])
    assert found.names == ('cam0', 'cam1')
    assert any('3 cameras are stated, cam0 and cam1 are taken' in t for t in found.rig.notices)
    wide = read_calibration([path], Choice(('cam2', 'cam0')))
    assert wide.names == ('cam0', 'cam2')
    assert wide.rig.baseline_m == pytest.approx(np.linalg.norm((POSE @ POSE)[:3, 3]))
    with pytest.raises(CalibrationError, match="has no camera 'cam7', only cam0, cam1, cam2"):
        read_calibration([path], Choice(('cam0', 'cam7')))
    with pytest.raises(CalibrationError, match="'cam0' is chosen twice"):
        read_calibration([path], Choice(('cam0', 'cam0')))


def test_poses_from_the_imu(tmp_path: Path) -> None:
    def by_imu(chain: dict[str, Any]) -> None:
        chain['cam1'].pop('T_cn_cnm1')
        body = Pose(R.T, np.array([0.1, 0.2, 0.3])).matrix
        chain['cam0']['T_cam_imu'], chain['cam1']['T_cam_imu'] = (
            body.tolist(),
            (POSE @ body).tolist(),
        )

    rig = read_calibration(kalibr(tmp_path, by_imu)).rig
    assert rig.baseline_m == pytest.approx(np.linalg.norm(T))
    np.testing.assert_allclose(rig.right.R, true_rig().right.R, atol=1e-9)

    def inverted(chain: dict[str, Any]) -> None:
        by_imu(chain)
        for camera in chain.values():
            camera['T_imu_cam'] = np.linalg.inv(camera.pop('T_cam_imu')).tolist()

    rig = read_calibration(kalibr(tmp_path, inverted)).rig
    np.testing.assert_allclose(rig.right.R, true_rig().right.R, atol=1e-9)


def test_a_fisheye_is_rectified_along_rows(tmp_path: Path) -> None:
    def wide(chain: dict[str, Any]) -> None:
        for camera, bend in (('cam0', -0.01), ('cam1', 0.02)):
            chain[camera] |= {'distortion_model': 'equi', 'distortion_coeffs': [bend, 0.003, 0, 0]}

    rig = read_calibration(kalibr(tmp_path, wide)).rig
    assert rig.left.distortion_model == 'equidistant'
    points = np.random.default_rng(1).uniform([-3, -2, 4], [3, 2, 9], (50, 3))
    seen = []
    for camera, local in ((rig.left, points), (rig.right, points @ R.T + T)):
        turned = local @ camera.R.T
        seen.append((turned / turned[:, 2:]) @ camera.P[:, :3].T)
    depth = (points @ rig.left.R.T)[:, 2]
    np.testing.assert_allclose(seen[0][:, 1], seen[1][:, 1], atol=1e-6)
    disparity = seen[0][:, 0] - seen[1][:, 0]
    np.testing.assert_allclose(disparity, rig.focal_px * rig.baseline_m / depth, rtol=1e-9)
    assert abs(rig.focal_px / LEFT_K[0, 0] - 1) < 0.01  # neither enlarged nor reduced


def test_a_rectified_pair_stays_as_it_is(tmp_path: Path) -> None:
    def straight(chain: dict[str, Any]) -> None:
        chain['cam1']['T_cn_cnm1'] = Pose(np.eye(3), np.array([-0.5, 0, 0])).matrix.tolist()
        for camera in chain.values():
            camera |= {'distortion_model': 'none', 'intrinsics': [400.0, 401.0, 350.0, 230.0]}

    (path,) = kalibr(tmp_path, straight)
    for rectified in (False, True):
        rig = read_rig(path, rectified=rectified)
        np.testing.assert_array_equal(rig.left.P[:, :3], rig.left.K)
        np.testing.assert_array_equal(rig.left.R, np.eye(3))
        assert rig.right.P[0, 3] == -200.0
    (path,) = kalibr(tmp_path)
    with pytest.raises(CalibrationError, match=r'does not state how the images were rectified'):
        read_rig(path, rectified=True)
    assert read_rig(opencv_sample(tmp_path)[0], rectified=True).left.D.any() is np.False_
