# SPDX-License-Identifier: Apache-2.0
"""What a format has that is not read, or lacks, is said with the remedy."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.io import savemat

from binocular_recon.errors import CalibrationError
from binocular_recon.io.calibration_yaml import read_rig
from binocular_recon.io.calibrations.raw_rig import Choice
from binocular_recon.io.calibrations.registry import read_calibration
from test.unit.io.calibrations.foreign_files import (
    LEFT_D,
    LEFT_K,
    RIGHT_D,
    RIGHT_K,
    SIZE,
    R,
    T,
    colmap,
    euroc,
    matlab_structure,
    metashape,
    mrcal,
    opencv_matrices,
    opencv_one_file,
    opencv_sample,
    put,
    ros_printed,
    true_rig,
)


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
    with pytest.raises(CalibrationError, match=r'holds the pose only; .*\(it has R, T, R1, '):
        read_calibration([extrinsics.rename(tmp_path / 'pose.yml')])


def test_binning_of_a_printed_camera_info_is_refused(tmp_path: Path) -> None:
    paths = ros_printed(tmp_path)
    paths[0].write_text(paths[0].read_text().replace('binning_y: 0', 'binning_y: 2'))
    with pytest.raises(CalibrationError, match='states binning or a region of interest, which'):
        read_rig(tmp_path)


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
    colmap(tmp_path)
    assert read_rig(tmp_path).left.size == SIZE  # the text beside it
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
