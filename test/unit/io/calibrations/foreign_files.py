# SPDX-License-Identifier: Apache-2.0
"""One rig, written in the formats of other programs from their documented definitions."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
import yaml
from scipy.io import savemat
from scipy.spatial.transform import Rotation

from binocular_recon.camera import Camera, FloatArray, StereoRig

SIZE = 752, 480
LEFT_K = np.array([[458.654, 0, 367.215], [0, 457.296, 248.375], [0, 0, 1]])
RIGHT_K = np.array([[462.587, 0, 379.999], [0, 459.134, 255.238], [0, 0, 1]])
LEFT_D = np.array([-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05])
RIGHT_D = np.array([-0.26368365, 0.06451284, -0.0010473, 0.0013555907])
# turned about all axes, so that no transposed rotation passes for the right one
R = Rotation.from_rotvec([0.021, -0.043, 0.032]).as_matrix()
T = np.array([-0.91, 0.021, -0.034])

# As stereoRectify of OpenCV 5.0.0 finds it with alpha 0; OpenCV 4.6 differs by 0.005 px.
FOCAL_PX = 431.1757399116362


class Pose(NamedTuple):
    """A camera in the frame of the files: x_camera = R x + t."""

    R: FloatArray
    t: FloatArray

    @property
    def matrix(self) -> FloatArray:
        """The same as (4, 4)."""
        return np.vstack([np.column_stack([self.R, self.t]), [0, 0, 0, 1]])


# Both cameras in a frame that is neither's.
BODY = Pose(Rotation.from_rotvec([0.4, 1.2, -0.7]).as_matrix(), np.array([0.3, -0.2, 0.9]))
LEFT = BODY
RIGHT = Pose(R @ BODY.R, R @ BODY.t + T)


def true_rig() -> StereoRig:
    """Return the rig, rectified by OpenCV."""
    R1, R2, P1, P2, *_ = cv2.stereoRectify(
        LEFT_K, LEFT_D, RIGHT_K, RIGHT_D, SIZE, R, T[:, None], flags=cv2.CALIB_ZERO_DISPARITY,
        alpha=-1,
    )  # fmt: skip
    scale = FOCAL_PX / P1[0, 0]
    P1[:2, [0, 1, 3]] *= scale
    P2[:2, [0, 1, 3]] *= scale
    return StereoRig(
        Camera(*SIZE, LEFT_K, LEFT_D, R1, P1), Camera(*SIZE, RIGHT_K, RIGHT_D, R2, P2)
    )


def opencv_matrices(path: Path, **values: Any) -> Path:
    """Write matrices by OpenCV's own FileStorage: YAML, XML or JSON by the ending."""
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for name, value in values.items():
        storage.write(name, np.array(value) if isinstance(value, np.ndarray) else value)
    storage.release()
    return path


def opencv_sample(folder: Path, ending: str = 'yml', *, size: bool = False) -> list[Path]:
    """Write the two files of OpenCV's sample stereo_calib, which has no image size."""
    rig = true_rig()
    extra = {'image_width': SIZE[0], 'image_height': SIZE[1]} if size else {}
    return [
        opencv_matrices(
            folder / f'intrinsics.{ending}', M1=LEFT_K, D1=LEFT_D[None], M2=RIGHT_K,
            D2=RIGHT_D[None], **extra,
        ),
        opencv_matrices(
            folder / f'extrinsics.{ending}', R=R, T=T[:, None], R1=rig.left.R, R2=rig.right.R,
            P1=rig.left.P, P2=rig.right.P, Q=np.eye(4),
        ),
    ]  # fmt: skip


def opencv_one_file(folder: Path, ending: str = 'yaml') -> list[Path]:
    """Write the cameras and their pose only, under longer names."""
    path = opencv_matrices(
        folder / f'stereo.{ending}', image_width=SIZE[0], image_height=SIZE[1],
        cameraMatrix1=LEFT_K, distCoeffs1=LEFT_D[:, None], cameraMatrix2=RIGHT_K,
        distCoeffs2=RIGHT_D[:, None], R=R, T=T[:, None],
    )  # fmt: skip
    return [path]


def opencv_of_ros(
    folder: Path, names: tuple[str, str] = ('left', 'right'), rig: StereoRig | None = None
) -> list[Path]:
    """Write ROS's names by OpenCV's FileStorage."""
    rig = rig or true_rig()
    paths = []
    for name, camera in zip(names, (rig.left, rig.right), strict=True):
        path = opencv_matrices(
            folder / f'{name}.yaml', image_width=camera.width, image_height=camera.height,
            camera_name=name, camera_matrix=camera.K, distortion_model='plumb_bob',
            distortion_coefficients=np.pad(camera.D, (0, 5 - camera.D.size))[None],
            rectification_matrix=camera.R, projection_matrix=camera.P,
        )  # fmt: skip
        paths.append(path)
    return paths


def opencv_of_a_tutorial(folder: Path) -> list[Path]:
    """Write the names of a widespread tutorial."""
    path = opencv_matrices(
        folder / 'rig.yml', image_size=np.array(SIZE), mtxL=LEFT_K, distL=LEFT_D[None],
        mtxR=RIGHT_K, distR=RIGHT_D[None], rot=R, R=R, T=T[:, None],
    )  # fmt: skip
    return [path]


def ros_printed(
    folder: Path, names: tuple[str, str] = ('left', 'right'), members: str = 'dkrp'
) -> list[Path]:
    """Write camera infos as `ros2 topic echo` prints them; `rostopic` has capitals."""
    rig = true_rig()
    paths = []
    for name, camera in zip(names, (rig.left, rig.right), strict=True):
        lines = ['header:', '  stamp: {sec: 1, nanosec: 2}', '  frame_id: cam', 'height: 480']
        lines += [f'width: {SIZE[0]}', 'distortion_model: plumb_bob']
        for member in members:
            values = np.ravel(getattr(camera, member.upper()))
            lines += [f'{member}:', *(f'- {float(value)!r}' for value in values)]
        lines += ['binning_x: 0', 'binning_y: 0', 'roi:', '  width: 0', '  do_rectify: false']
        paths.append(folder / f'{name}.yaml')
        paths[-1].write_text('\n'.join([*lines, '---', '']))
    return paths


def tabbed(paths: list[Path]) -> list[Path]:
    """Write tabs and comments where an editor left them."""
    for path in paths:
        text = '# the rig\n' + path.read_text()
        path.write_text(text.replace(': ', ':\t').replace('\n', '\t# as calibrated\r\n'))
    return paths


def kalibr(
    folder: Path, change: Callable[[dict[str, Any]], object] = lambda _: None
) -> list[Path]:
    """Write a camchain: T_cn_cnm1 takes points from the camera before."""
    chain: dict[str, Any] = {}
    for index, (K, D) in enumerate(((LEFT_K, LEFT_D), (RIGHT_K, RIGHT_D))):
        chain[f'cam{index}'] = {
            'cam_overlaps': [1 - index],
            'camera_model': 'pinhole',
            'distortion_coeffs': D.tolist(),
            'distortion_model': 'radtan',
            'intrinsics': [float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2])],
            'resolution': list(SIZE),
            'rostopic': f'/cam{index}/image_raw',
        }
    chain['cam1']['T_cn_cnm1'] = Pose(R, T).matrix.tolist()
    change(chain)
    path = folder / 'camchain.yaml'
    path.write_text(yaml.safe_dump(chain))
    return [path]


def euroc(folder: Path) -> list[Path]:
    """Write sensor.yaml per camera: T_BS takes points from the sensor to the body."""
    paths = []
    for index, (K, D, pose) in enumerate(((LEFT_K, LEFT_D, LEFT), (RIGHT_K, RIGHT_D, RIGHT))):
        path = folder / f'cam{index}' / 'sensor.yaml'
        path.parent.mkdir(exist_ok=True)
        data = np.linalg.inv(pose.matrix).ravel().tolist()
        path.write_text(
            '%YAML:1.0\nsensor_type: camera\ncomment: test\n\nT_BS:\n  cols: 4\n  rows: 4\n'
            f'  data: {data}\nrate_hz: 20\nresolution: {list(SIZE)}\ncamera_model: pinhole\n'
            f'intrinsics: {[K[0, 0].item(), K[1, 1].item(), K[0, 2].item(), K[1, 2].item()]}\n'
            f'distortion_model: radial-tangential\ndistortion_coefficients: {D.tolist()}\n'
        )
        paths.append(path)
    return paths


def mrcal(
    folder: Path, names: tuple[str, str] = ('left', 'right'), lens: str = 'OPENCV4', more: str = ''
) -> list[Path]:
    """Write a model per camera; the pose is a rotation vector and a translation."""
    paths = []
    cameras = ((LEFT_K, LEFT_D, LEFT), (RIGHT_K, RIGHT_D, RIGHT))
    for name, (K, D, pose) in zip(names, cameras, strict=True):
        rt = [*Rotation.from_matrix(pose.R).as_rotvec().tolist(), *pose.t.tolist()]
        core = [K[0, 0], K[1, 1], K[0, 2], K[1, 2], *D]
        count = int(lens.removeprefix('OPENCV')) if lens.startswith('OPENCV') else 4
        core += [0.0] * (count - 4)
        path = folder / f'{name}.cameramodel'
        path.write_text(
            f"{{\n    'lensmodel': 'LENSMODEL_{lens}',\n\n    # fx,fy,cx,cy,distortion0,...\n"
            f"    'intrinsics': {[float(value) for value in core]},\n    'rt_cam_ref': {rt},\n"
            f"    'imagersize': [ 752, 480,],\n{more}}}\n"
        )
        paths.append(path)
    return paths


def colmap(folder: Path, frames: int = 3) -> list[Path]:
    """Write cameras.txt and images.txt: the first pixel has its centre at (0.5, 0.5)."""
    lines = ['# Camera list with one line of data per camera:']
    for index, (K, D) in enumerate(((LEFT_K, LEFT_D), (RIGHT_K, RIGHT_D)), 1):
        values = [K[0, 0], K[1, 1], K[0, 2] + 0.5, K[1, 2] + 0.5, *D]
        text = ' '.join(repr(float(value)) for value in values)
        lines.append(f'{index} OPENCV {SIZE[0]} {SIZE[1]} {text}')
    (folder / 'cameras.txt').write_text('\n'.join(lines) + '\n')
    lines = ['# Image list with two lines of data per image:']
    generator = np.random.default_rng(3)
    for frame in range(frames):
        world = Pose(Rotation.random(random_state=frame).as_matrix(), generator.normal(size=3))
        for index, pose in enumerate((LEFT, RIGHT), 1):
            turn, shift = pose.R @ world.R, pose.R @ world.t + pose.t
            x, y, z, w = Rotation.from_matrix(turn).as_quat()
            text = ' '.join(repr(float(value)) for value in (w, x, y, z, *shift))
            side = ('left', 'right')[index - 1]
            lines.append(f'{2 * frame + index} {text} {index} {side}/{frame:04}.png')
            lines.append('' if frame else '10.5 20.25 -1 30 40 7')
    (folder / 'images.txt').write_text('\n'.join(lines) + '\n')
    return [folder / 'cameras.txt']


def matlab_structure(*, new: bool, order: Sequence[int] = (0, 1)) -> dict[str, Any]:
    """Return what toStruct gives: before R2022b transposed, since then with K and a pose."""
    cameras = [(LEFT_K, LEFT_D), (RIGHT_K, RIGHT_D)]
    content: dict[str, Any] = {'WorldUnits': 'millimeters', 'Version': '1'}
    for index, (K, D) in enumerate(cameras[i] for i in order):
        one_based = K + np.array([[0, 0, 1], [0, 0, 1], [0, 0, 0]])  # the first pixel is (1, 1)
        content[f'CameraParameters{index + 1}'] = {
            'RadialDistortion': D[:2],
            'TangentialDistortion': D[2:4],
            'ImageSize': np.array([SIZE[1], SIZE[0]]),
            'WorldUnits': 'millimeters',
            **({'K': one_based} if new else {'IntrinsicMatrix': one_based.T}),
        }
    turn, shift = (R, T) if tuple(order) == (0, 1) else (R.T, -R.T @ T)
    if new:
        content['PoseCamera2'] = {'Dimensionality': 3, 'R': turn, 'Translation': 1000 * shift}
    else:
        content['RotationOfCamera2'] = turn.T
        content['TranslationOfCamera2'] = 1000 * shift
    return content


def _lists(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _lists(inner) for key, inner in value.items()}
    return value.tolist() if isinstance(value, np.ndarray) else value


def matlab_mat(folder: Path) -> list[Path]:
    """Write the older structure as a MAT-file."""
    savemat(folder / 'rig.mat', {'s': matlab_structure(new=False)})
    return [folder / 'rig.mat']


def matlab_json(folder: Path) -> list[Path]:
    """Write the newer structure as JSON."""
    path = folder / 'rig.json'
    path.write_text(json.dumps({'stereoParams': _lists(matlab_structure(new=True))}))
    return [path]


def matlab_to_opencv(folder: Path) -> list[Path]:
    """Write what stereoParametersToOpenCV returns, in metres."""
    values = {
        'intrinsicMatrix1': LEFT_K, 'distortionCoefficients1': LEFT_D,
        'intrinsicMatrix2': RIGHT_K, 'distortionCoefficients2': RIGHT_D,
        'rotationOfCamera2': R, 'translationOfCamera2': T, 'imageSize': [SIZE[1], SIZE[0]],
    }  # fmt: skip
    savemat(folder / 'rig.mat', values)
    return [folder / 'rig.mat']


def metashape(folder: Path, more: str = '', scale: float = 0.5) -> list[Path]:
    """Write exported cameras; offsets from the middle, (0.5, 0.5) in the first pixel."""
    sensors, cameras = [], []
    items = (('left', LEFT_K, LEFT_D, LEFT), ('right', RIGHT_K, RIGHT_D, RIGHT))
    for index, (label, K, D, pose) in enumerate(items):
        k1, k2, p1, p2 = D
        cx, cy = K[0, 2] + 0.5 - SIZE[0] / 2, K[1, 2] + 0.5 - SIZE[1] / 2
        sensors.append(
            f'<sensor id="{index}" label="{label}" type="frame">'
            f'<resolution width="{SIZE[0]}" height="{SIZE[1]}"/>'
            '<calibration type="frame" class="initial"><f>1</f></calibration>'
            f'<calibration type="frame" class="adjusted"><resolution width="{SIZE[0]}"'
            f' height="{SIZE[1]}"/><f>{K[1, 1]!r}</f><cx>{cx!r}</cx><cy>{cy!r}</cy>'
            f'<b1>{K[0, 0] - K[1, 1]!r}</b1><k1>{k1!r}</k1><k2>{k2!r}</k2>'
            f'<p1>{p2!r}</p1><p2>{p1!r}</p2>{more}</calibration></sensor>'
        )
        transform = np.linalg.inv(Pose(pose.R, pose.t / scale).matrix).ravel()
        text = ' '.join(repr(float(value)) for value in transform)
        cameras.append(
            f'<camera id="{index}" sensor_id="{index}" label="{label}">'
            f'<transform>{text}</transform></camera>'
        )
    text = (
        (
            '<?xml version="1.0" encoding="UTF-8"?>\n<document version="1.5.0"><chunk label="c">'
            f'<sensors>{"".join(sensors)}</sensors><cameras>{"".join(cameras)}</cameras>'
            f'<transform><scale>{scale}</scale></transform></chunk></document>'
        )
        .replace('np.float64(', '')
        .replace(')', '')
    )
    (folder / 'cameras.xml').write_text(text)
    return [folder / 'cameras.xml']


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


def ros_ini(folder: Path, ending: str = 'ini') -> list[Path]:
    """Write the older format of ROS's camera_calibration_parsers, as cameracalibrator does."""
    rig, paths = true_rig(), []

    def lines(values: FloatArray) -> str:
        return '\n'.join(' '.join(repr(float(one)) for one in row) for row in values)

    for name, camera in (('left', rig.left), ('right', rig.right)):
        path = folder / f'{name}.{ending}'
        path.write_text(
            f'# oST version 5.0 parameters\n\n[image]\n\nwidth\n{SIZE[0]}\n\nheight\n{SIZE[1]}\n\n'
            '[externals]\n\ntranslation\n0 0 0\n\nrotation\n0 0 0\n\n'
            f'[narrow_stereo/{name}]\n\ncamera matrix\n{lines(camera.K)}\n\n'
            f'distortion\n{lines(np.pad(camera.D, (0, 5 - camera.D.size))[None])}\n\n'
            f'rectification\n{lines(camera.R)}\n\nprojection\n{lines(camera.P)}\n'
        )
        paths.append(path)
    return paths


WRITERS: dict[str, Callable[[Path], list[Path]]] = {
    'opencv sample': opencv_sample,
    'opencv sample, xml': lambda folder: opencv_sample(folder, 'xml', size=True),
    'opencv sample, json': lambda folder: opencv_sample(folder, 'json', size=True),
    'opencv sample, gzip': lambda folder: opencv_sample(folder, 'yml.gz', size=True),
    'opencv in one file': opencv_one_file,
    'opencv in one xml': lambda folder: opencv_one_file(folder, 'xml'),
    'opencv as in a tutorial': opencv_of_a_tutorial,
    'ros, printed': ros_printed,
    'ros, printed by ros 1': lambda folder: ros_printed(folder, ('a', 'b'), 'DKRP'),
    'kalibr with tabs': lambda folder: tabbed(kalibr(folder)),
    'ros, ini': ros_ini,
    'ros, ost.txt': lambda folder: ros_ini(folder, 'txt'),
    'ros by opencv': opencv_of_ros,
    'ros by opencv, other names': lambda folder: opencv_of_ros(folder, ('a', 'b')),
    'kalibr': kalibr,
    'euroc': euroc,
    'mrcal': mrcal,
    'mrcal opencv8': lambda folder: mrcal(folder, ('cam0', 'cam1'), 'OPENCV8'),
    'mrcal opencv12': lambda folder: mrcal(folder, ('0', '1'), 'OPENCV12'),
    'colmap': colmap,
    'matlab mat': matlab_mat,
    'matlab json': matlab_json,
    'matlab to opencv': matlab_to_opencv,
    'metashape': metashape,
}
