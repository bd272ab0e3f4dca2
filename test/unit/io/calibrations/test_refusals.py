# SPDX-License-Identifier: Apache-2.0
"""What is missing, mistaken or not read is said, with the remedy; which camera is left too."""

from __future__ import annotations

import gzip
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from scipy.io import savemat

from binocular_recon.errors import CalibrationError, FileError
from binocular_recon.io.calibration_yaml import read_rig
from binocular_recon.io.calibrations.raw_rig import Choice
from binocular_recon.io.calibrations.registry import read_calibration
from test.unit.io.calibrations.foreign_files import (
    LEFT_D,
    LEFT_K,
    RIGHT_D,
    RIGHT_K,
    SIZE,
    Pose,
    R,
    T,
    colmap,
    euroc,
    kalibr,
    matlab_structure,
    metashape,
    mrcal,
    opencv_matrices,
    opencv_one_file,
    opencv_sample,
    true_rig,
)

Change = Callable[[dict[str, Any]], object]


def put(*path: str, value: Any) -> Change:
    """Return a change that sets a value of nested mappings; None removes it."""

    def change(content: dict[str, Any]) -> None:
        for key in path[:-1]:
            content = content[key]
        if value is None:
            content.pop(path[-1])
        else:
            content[path[-1]] = value

    return change


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
        (put('cam1', 'resolution', value=[640, 480]), 'left camera is 752x480, right is 640x480'),
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


def test_faults_of_opencv(tmp_path: Path) -> None:
    intrinsics, extrinsics = opencv_sample(tmp_path)
    rig = true_rig()

    def pose(**values: Any) -> None:
        matrices = {'R': R, 'T': T[:, None], 'R1': rig.left.R, 'R2': rig.right.R}
        matrices |= {'P1': rig.left.P, 'P2': rig.right.P, **values}
        opencv_matrices(extrinsics, **{k: v for k, v in matrices.items() if v is not None})

    for values, message in (
        ({'P1': None}, r'the image size is missing \(OpenCV\)'),
        ({'P1': rig.left.P + np.eye(3, 4, 2) / 9}, 'the image size is missing'),
        ({'T': -T[:, None]}, r'R and T contradict R1, R2, P1 and P2: T is \(0.9100, '),
        ({'R': R.T}, 'R and T contradict'),
        ({'R': np.diag([1.0, 1, -1])}, 'R is not a rotation but a reflection'),
        ({'T': np.zeros((2, 1))}, 'T must have 3 values, got 2'),
    ):
        pose(**values)
        with pytest.raises(CalibrationError, match=message):
            read_calibration([intrinsics, extrinsics])
    opencv_sample(tmp_path, size=True)
    pose(P1=rig.left.P + 1)
    with pytest.raises(CalibrationError, match=r'P\[0, 1\] is 1, it must be 0'):
        read_calibration([intrinsics, extrinsics])
    pose(R1=2 * rig.left.R)
    with pytest.raises(CalibrationError, match=r'M1: R is not a rotation: R R\^T is 3'):
        read_calibration([intrinsics, extrinsics])
    text = extrinsics.read_text()
    extrinsics.write_text(text.replace('rows: 3', 'rows: 4', 1))
    with pytest.raises(CalibrationError, match='must have 4 x 3 values, got 9'):
        read_calibration([intrinsics, extrinsics])
    extrinsics.unlink()
    with pytest.raises(CalibrationError, match=r'pose of camera 1 is missing, .*R and T of st'):
        read_calibration([intrinsics])
    single = [
        opencv_matrices(tmp_path / f'{name}.yml', camera_matrix=K, distortion_coefficients=D)
        for name, K, D in (('a', LEFT_K, LEFT_D), ('b', RIGHT_K, RIGHT_D))
    ]
    with pytest.raises(CalibrationError, match='calibrated alone, without a pose'):
        read_calibration(single)
    with pytest.raises(CalibrationError, match=r'one camera only \(a\)'):
        read_calibration(single[:1])
    pose()
    with pytest.raises(CalibrationError, match='holds the pose only; the cameras are missing'):
        read_calibration([extrinsics.rename(tmp_path / 'pose.yml')])


def test_older_and_other_notations_of_opencv(tmp_path: Path) -> None:
    """The header of OpenCV 2 to 4, names as ORB-SLAM has them, matrices in base64."""
    rig = true_rig()
    lines = ['%YAML:1.0', '---', 'LEFT.height: 480', 'LEFT.width: 752']
    for side, camera in (('LEFT', rig.left), ('RIGHT', rig.right)):
        for key in 'KDRP':
            value = np.atleast_2d(getattr(camera, key))
            lines += [f'{side}.{key}: !!opencv-matrix', f'   rows: {len(value)}']
            lines += [
                f'   cols: {value.shape[1]}',
                '   dt: d',
                f'   data: {value.ravel().tolist()}',
            ]
    path = tmp_path / 'slam.yaml'
    path.write_text('\n'.join(lines))
    read = read_rig(path)
    np.testing.assert_allclose(read.right.P, rig.right.P)
    assert read.left.size == SIZE
    path.write_text('M1: {rows: 3, cols: 3, dt: d, data: !!binary AAAA}')
    with pytest.raises(CalibrationError, match='M1 is stored in base64; write the file without'):
        read_rig(path)


def test_rotation_vectors_sizes_and_units_of_opencv(tmp_path: Path) -> None:
    import cv2

    path = opencv_matrices(
        tmp_path / 'a.xml', M1=LEFT_K, D1=LEFT_D, M2=RIGHT_K, D2=RIGHT_D,
        R=cv2.Rodrigues(R)[0], T=1000 * T,
    )  # fmt: skip
    rig = read_calibration([path], Choice(image_size=SIZE)).rig
    assert rig.left.size == SIZE
    assert 'if it is in millimetres, divide P[0, 3] by 1000 (0.9' in rig.warnings[0]
    with pytest.raises(CalibrationError, match='have 752x480 px, not the size that --image-size'):
        read_calibration(opencv_one_file(tmp_path), Choice(image_size=(640, 480)))
    scaled = read_calibration([path], Choice(image_size=SIZE, baseline_m=0.9109)).rig
    assert scaled.baseline_m == pytest.approx(0.9109) and not scaled.warnings
    stated = read_calibration(opencv_sample(tmp_path), Choice(baseline_m=2.5)).rig
    assert stated.baseline_m == pytest.approx(2.5)


def test_faults_of_other_formats(tmp_path: Path) -> None:
    for lens in ('SPLINED_STEREOGRAPHIC_order=3_Nx=30_Ny=20_fov_x_deg=170', 'CAHVOR', 'LATLON'):
        with pytest.raises(CalibrationError, match=r'is not read.*mrcal-convert-lensmodel LENSM'):
            read_calibration(mrcal(tmp_path, lens=lens))
    models = mrcal(tmp_path)
    with pytest.raises(CalibrationError, match=r'one camera only \(left\)'):
        read_calibration(models[:1])
    models[1].write_text(models[0].read_text())
    with pytest.raises(CalibrationError, match='left and right stand at the same place'):
        read_calibration(models)
    (tmp_path / 'a.cahvor').write_text('Model = CAHVOR')
    with pytest.raises(CalibrationError, match='convert it with mrcal-to-cameramodel'):
        read_calibration([tmp_path / 'a.cahvor'])

    folder = tmp_path / 'euroc'
    folder.mkdir()
    first, _ = euroc(folder)
    first.write_text(first.read_text().replace('radial-tangential', 'fov'))
    with pytest.raises(CalibrationError, match="distortion model 'fov' is not read"):
        read_rig(folder)
    first.unlink()
    with pytest.raises(CalibrationError, match=r'one camera only \(cam1\) \(EuRoC\)'):
        read_rig(folder)

    for scale, message in (('<k4>0.1</k4>', 'k4 of a frame camera is 0.1'), ('<p3>1</p3>', 'p3')):
        with pytest.raises(CalibrationError, match=message):
            read_calibration(metashape(tmp_path, scale))
    (path,) = metashape(tmp_path)
    text = path.read_text()
    for old, new, message in (
        ('type="frame" class', 'type="spherical" class', "type 'spherical' is not read"),
        ('<f>', '<fx>', 'not a camera file: mismatched tag'),
        ('sensor_id="1"', 'sensor_id="7"', "its sensor '7' is missing"),
        ('transform>', 'moved>', 'pose of left is missing.*export the cameras'),
    ):
        path.write_text(text.replace(old, new))
        with pytest.raises(CalibrationError, match=message):
            read_calibration([path])
    path.write_text('<calibration><projection>frame</projection><f>1000</f></calibration>')
    with pytest.raises(CalibrationError, match=r'the image size \(resolution\) is missing'):
        read_calibration([path])


def test_images_of_metashape(tmp_path: Path) -> None:
    """Every image is a camera: those of one frame and of two sensors are a pair."""
    (path,) = metashape(tmp_path)
    text = path.read_text()
    first, second = (part + '</camera>' for part in text.split('</camera>')[:2])
    first = first[first.index('<camera ') :]
    images = [first.replace('label="left"', f'label="left_{frame}"') for frame in range(3)]
    images.append(second.replace('label="right"', 'label="right_7"'))
    head, tail = text[: text.index('<camera ')], text[text.index('</cameras>') :]
    path.write_text(head + ''.join(images) + tail)
    with pytest.raises(CalibrationError, match='which of the 4 images are of the same frame is n'):
        read_calibration([path])
    found = read_calibration([path], Choice(('left_2', 'right_7')))
    assert found.rig.baseline_m == pytest.approx(np.linalg.norm(T))
    path.write_text(path.read_text().replace('right_7', 'right_0'))
    found = read_calibration([path])
    assert found.names == ('left_0', 'right_0')
    assert any('4 cameras are stated' in notice for notice in found.rig.notices)
    path.write_text(text.replace('<transform><scale>0.5</scale></transform>', ''))
    rig = read_calibration([path]).rig
    assert any('the chunk has no scale' in notice for notice in rig.notices)
    assert rig.baseline_m == pytest.approx(2 * np.linalg.norm(T))


def test_fisheye_of_metashape(tmp_path: Path) -> None:
    (path,) = metashape(tmp_path, '<k3>0.01</k3><k4>0.002</k4>')
    text = path.read_text().replace('type="frame"', 'type="equidistant_fisheye"')
    path.write_text(text)
    with pytest.raises(CalibrationError, match='p1 of a equidistant_fisheye camera is'):
        read_calibration([path])
    for name in ('p1', 'p2'):
        text = re.sub(f'<{name}>.*?</{name}>', '', text)
    path.write_text(text)
    camera = read_calibration([path]).rig.left
    assert camera.distortion_model == 'equidistant'
    np.testing.assert_allclose(camera.D, [*LEFT_D[:2], 0.01, 0.002])


def test_faults_of_colmap(tmp_path: Path) -> None:
    (path,) = colmap(tmp_path)
    notices = read_calibration([path]).rig.notices
    assert any('baseline of 0.9109 is taken as metres' in text for text in notices)
    assert read_calibration([path], Choice(baseline_m=1.5)).rig.baseline_m == pytest.approx(1.5)
    images = tmp_path / 'images.txt'
    whole = images.read_text()
    images.write_text(whole.replace(' 1 left/', ' 1 other').replace(' 2 right/', ' 2 another'))
    with pytest.raises(CalibrationError, match='pose of 1 is missing'):
        read_calibration([path])
    lines = whole.split('\n')
    words = lines[3].split()
    lines[3] = ' '.join([*words[:5], '5', *words[6:]])
    images.write_text('\n'.join(lines[:9]))
    with pytest.raises(CalibrationError, match='differs from frame to frame by'):
        read_calibration([path])
    lines[3] = ' '.join([words[0], '2', *words[2:]])
    images.write_text('\n'.join(lines))
    with pytest.raises(CalibrationError, match=r'line 4: the quaternion has the length 2\.'):
        read_calibration([path])
    images.write_text('1 0.5 0.5')
    with pytest.raises(CalibrationError, match=r'line 1 must have IMAGE_ID'):
        read_calibration([path])
    images.unlink()
    with pytest.raises(CalibrationError, match=r'pose of 1 is missing.*images\.txt of the sa'):
        read_calibration([path])
    text = path.read_text()
    for old, new, message in (
        ('OPENCV', 'THIN_PRISM_FISHEYE', "model 'THIN_PRISM_FISHEYE' is not read"),
        ('OPENCV', 'PINHOLE', 'PINHOLE must have 4 values, got 8'),
        ('\n2 ', '\n1 ', 'camera 1 is there twice'),
        (text.split('\n')[2], '2 OPENCV', 'must have CAMERA_ID, MODEL'),
    ):
        path.write_text(text.replace(old, new))
        with pytest.raises(CalibrationError, match=message):
            read_calibration([path])
    (tmp_path / 'cameras.bin').write_bytes(b'\x02' * 100)
    with pytest.raises(CalibrationError, match='convert it with colmap model_converter'):
        read_calibration([tmp_path / 'cameras.bin'])


@pytest.mark.parametrize(
    ('model', 'focal', 'rest', 'lens', 'D'),
    [
        ('SIMPLE_PINHOLE', [500], [], 'plumb_bob', [0, 0, 0, 0]),
        ('PINHOLE', [500, 510], [], 'plumb_bob', [0, 0, 0, 0]),
        ('SIMPLE_RADIAL', [500], [0.1], 'plumb_bob', [0.1, 0, 0, 0]),
        ('RADIAL', [500], [0.1, 0.2], 'plumb_bob', [0.1, 0.2, 0, 0]),
        ('OPENCV_FISHEYE', [500, 510], [0.1, 0, 0.3, 0], 'equidistant', [0.1, 0, 0.3, 0]),
        ('RADIAL_FISHEYE', [500], [0.1, 0.2], 'equidistant', [0.1, 0.2, 0, 0]),
        ('FULL_OPENCV', [500, 510], range(8), 'rational_polynomial', range(8)),
    ],
)
def test_camera_models_of_colmap(
    tmp_path: Path, model: str, focal: list[int], rest: list[float], lens: str, D: list[float]
) -> None:
    (path,) = colmap(tmp_path)
    text = ' '.join(map(str, [*focal, 320.5, 240.5, *rest]))
    path.write_text(f'1 {model} 641 481 {text}\n2 {model} 641 481 {text}\n')
    camera = read_calibration([path]).rig.left
    assert camera.distortion_model == lens and camera.size == (641, 481)
    np.testing.assert_allclose(camera.D, list(D))
    np.testing.assert_array_equal(np.diag(camera.K), [500, focal[-1], 1])
    np.testing.assert_allclose(camera.K[:2, 2], [320, 240])


def test_faults_of_matlab(tmp_path: Path) -> None:
    path = tmp_path / 'rig.mat'
    for change, message in (
        (put('CameraParameters2', value=None), 'CameraParameters2 is missing, so there is one ca'),
        (put('RotationOfCamera2', value=None), 'RotationOfCamera2 is missing; save it with'),
        (put('WorldUnits', value='furlongs'), "WorldUnits 'furlongs' is not one of mm"),
        (put('CameraParameters1', 'ImageSize', value=np.zeros((0, 0))), 'image size is missing'),
        (
            put('CameraParameters1', 'IntrinsicMatrix', value=None),
            r'K \(IntrinsicMatrix\) is miss',
        ),
        (put('RotationOfCamera2', value=2 * np.eye(3)), 'is not a rotation'),
    ):
        content = matlab_structure(new=False)
        change(content)
        savemat(path, {'s': content})
        with pytest.raises(CalibrationError, match=message):
            read_calibration([path])
    savemat(path, {'other': 1})
    with pytest.raises(
        CalibrationError, match='holds no stereoParameters as a structure, only oth'
    ):
        read_calibration([path])
    path.write_bytes(b'MATLAB 7.3 MAT-file, Platform')
    with pytest.raises(CalibrationError, match=r'version 7\.3, which is not read; save it with'):
        read_calibration([path])


def test_a_calibration_of_a_real_world_unit(tmp_path: Path) -> None:
    savemat(tmp_path / 'rig.mat', {'s': matlab_structure(new=False)})
    found = read_calibration([tmp_path / 'rig.mat'])
    assert found.rig.baseline_m == pytest.approx(np.linalg.norm(T))
    assert any('lengths are in millimeters' in text for text in found.rig.notices)


BOMB = ''.join(
    f'{name}: &{name} [{f"*{before}," * 9}]\n'
    for before, name in zip('abcdefgh', 'bcdefghi', strict=True)
)


@pytest.mark.parametrize(
    ('name', 'text', 'message'),
    [
        ('deep.yaml', '[' * 2_000, 'nested too deeply'),
        ('deep.json', '[' * 100_000, 'nested too deeply'),
        ('deep.xml', f'<opencv_storage>{"<a>" * 9999}{"</a>" * 9999}</opencv_storage>', 'nested'),
        ('deep.cameramodel', '{"lensmodel": ' + '[' * 100_000, 'read as a Python dictionary'),
        ('endless.yaml', 'cam0: {intrinsics: &a [*a]}', 'stand for more than'),
        ('bomb.yaml', f'a: &a [1, 1, 1, 1, 1, 1, 1]\n{BOMB}', 'stand for more than'),
        ('merge.yaml', 'a: &a {<<: [*a, *a]}', 'not a camera file'),
        ('many.json', '[' + '[],' * 300_000 + '1]', 'has more than 500000 values'),
        ('entities.xml', '<!DOCTYPE a [<!ENTITY b "c">]><document/>', 'declares entities'),
        ('object.yaml', '!!python/object/apply:os.getcwd []', 'could not determine a constructor'),
        ('date.yaml', 'M1: 2020-13-45', 'month must be in'),
        ('key.yaml', '? [a]\n: 1\n', 'unhashable key'),
        ('notes.yaml', 'camera: mine\nfocal: 5', r'in notes\.yaml \(it has camera, focal\);'),
        ('empty.yaml', '', r'no calibration is found in empty\.yaml; ROS camera info .* are read'),
        ('a.txt', 'hello', r'no calibration is found in a\.txt'),
    ],
)
def test_hostile_and_unknown_files(tmp_path: Path, name: str, text: str, message: str) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(CalibrationError, match=message):
        read_rig(tmp_path / name)


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(FileError, match=r'nowhere\.yaml cannot be read: No such file'):
        read_rig(tmp_path / 'nowhere.yaml')
    large = tmp_path / 'large.yaml'
    large.write_text('a: [' + '1, ' * 200_000)
    with pytest.raises(FileError, match='more than 512 kB, more than a calibration'):
        read_rig(large)
    packed = tmp_path / 'packed.yml.gz'
    packed.write_bytes(gzip.compress(bytes(65 << 20)))
    with pytest.raises(FileError, match='more than 65536 kB'):
        read_rig(packed)
    packed.write_bytes(gzip.compress(b'a: 1')[:-9])
    with pytest.raises(FileError, match=r'cannot be read: (Compressed file|Error)'):
        read_rig(packed)
    (tmp_path / 'text.yaml').write_bytes('a: 1'.encode('utf-16'))
    with pytest.raises(FileError, match="codec can't decode"):
        read_rig(tmp_path / 'text.yaml')


def test_several_formats_and_left_over_files(tmp_path: Path) -> None:
    files = [*kalibr(tmp_path), *opencv_one_file(tmp_path)]
    with pytest.raises(
        CalibrationError,
        match=r'several formats: camchain.yaml \(Kalibr\); stereo.yaml \(OpenCV\)',
    ):
        read_rig(tmp_path)
    (tmp_path / 'notes.yaml').write_text('a: 1')
    (tmp_path / 'broken.yaml').write_text('[')
    files[1].unlink()
    assert read_rig(tmp_path).left.size == SIZE  # other files of a folder do not matter
    with pytest.raises(
        CalibrationError, match=r'notes\.yaml is no part of a calibration of Kalibr'
    ):
        read_calibration([files[0], tmp_path / 'notes.yaml'])
    with pytest.raises(CalibrationError, match=r'broken\.yaml is not a camera file'):
        read_calibration([files[0], tmp_path / 'broken.yaml'])
    second = tmp_path / 'other.yaml'
    second.write_text(yaml.safe_dump(yaml.safe_load(files[0].read_text())))
    with pytest.raises(CalibrationError, match='two calibrations of Kalibr; give one'):
        read_calibration([files[0], second])
