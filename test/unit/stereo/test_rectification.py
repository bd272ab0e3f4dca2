# SPDX-License-Identifier: Apache-2.0
"""Rectification against OpenCV, against projected points and on a really unrectified rig."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from binocular_recon.camera import Camera, FloatArray, StereoRig
from binocular_recon.errors import CalibrationError, ConfigError, ImageError
from binocular_recon.images import Image
from binocular_recon.stereo.rectification import Rectifier, rectification_maps, rectified_points

SIZE = (320, 200)
K_LEFT = np.array([[250.0, 0, 158], [0, 252, 103], [0, 0, 1]])
K_RIGHT = np.array([[260.0, 0, 163], [0, 259, 97], [0, 0, 1]])
DISTORTIONS = {
    'plumb_bob': [-0.28, 0.07, 2e-4, 2e-5, 0.01],
    'rational_polynomial': [0.3, -0.1, 1e-4, -2e-4, 0.02, 0.5, -0.05, 0.01],
    'equidistant': [-0.02, 0.01, -0.003, 0.001],
}


def make_rig(model: str = 'plumb_bob') -> tuple[StereoRig, FloatArray, FloatArray]:
    """Return a misaligned rig rectified by OpenCV with its R and T (x_right = R x_left + T)."""
    rotation = cv2.Rodrigues(np.array([0.02, -0.03, 0.01]))[0]
    translation = -rotation @ np.array([0.5, 0.01, -0.02])
    distortion = np.array(DISTORTIONS[model])
    # distortion does not enter with alpha = -1, so plain stereoRectify serves all models
    result = cv2.stereoRectify(
        K_LEFT, np.zeros(5), K_RIGHT, np.zeros(5), SIZE, rotation, translation.reshape(3, 1),
        alpha=-1, flags=0,
    )  # fmt: skip
    r_left, r_right, p_left, p_right = result[:4]
    rig = StereoRig(
        Camera(*SIZE, K_LEFT, distortion, r_left, p_left, model),
        Camera(*SIZE, K_RIGHT, distortion, r_right, p_right, model),
    )
    return rig, rotation, translation


def project(points: FloatArray, camera: Camera) -> FloatArray:
    """Project points in the camera's own frame to its raw image."""
    zero = np.zeros(3)
    module = cv2.fisheye if camera.distortion_model == 'equidistant' else cv2
    pixels: FloatArray = module.projectPoints(points[:, None], zero, zero, camera.K, camera.D)[0]
    return pixels[:, 0]


@pytest.mark.parametrize('model', DISTORTIONS)
def test_maps_lead_to_where_the_raw_camera_sees_the_point(model: str) -> None:
    rig, _, _ = make_rig(model)
    rng = np.random.default_rng(1)
    for camera in (rig.left, rig.right):
        pixels = np.column_stack([rng.integers(0, 320, 200), rng.integers(0, 200, 200)])
        rays = np.column_stack([pixels, np.ones(200)]) @ np.linalg.inv(camera.P[:, :3]).T
        expected = project(rays @ camera.R, camera)
        map_x, map_y = rectification_maps(camera)
        found = np.stack([m[pixels[:, 1], pixels[:, 0]] for m in (map_x, map_y)], axis=-1)
        assert np.abs(found - expected).max() < 1e-3


@pytest.mark.parametrize('model', DISTORTIONS)
def test_maps_equal_opencv(model: str) -> None:
    camera = make_rig(model)[0].left
    module = cv2.fisheye if model == 'equidistant' else cv2
    expected = module.initUndistortRectifyMap(
        camera.K, camera.D, camera.R, camera.P[:, :3], SIZE, cv2.CV_32FC1
    )
    for found, wanted in zip(rectification_maps(camera), expected, strict=True):
        np.testing.assert_allclose(found, wanted, atol=1e-3)


def test_rows_of_a_scene_correspond_and_depth_is_metric() -> None:
    rig, rotation, translation = make_rig()
    rng = np.random.default_rng(2)
    points = rng.uniform([-2, -1, 5], [2, 1, 15], (100, 3))
    in_right = points @ rotation.T + translation
    rows = []
    for camera, own in ((rig.left, points), (rig.right, in_right)):
        image = own @ camera.R.T @ camera.P[:, :3].T
        if camera is rig.left:
            depth = image[:, 2]
        rows.append(image[:, :2] / image[:, 2:])
    assert np.abs(rows[0][:, 1] - rows[1][:, 1]).max() < 1e-9
    disparity = rows[0][:, 0] - rows[1][:, 0] - rig.disparity_offset_px
    np.testing.assert_allclose(rig.focal_px * rig.baseline_m / disparity, depth, rtol=1e-9)
    assert rig.baseline_m == pytest.approx(np.linalg.norm(translation), rel=1e-9)


def test_rectified_rig_is_what_interface_promises() -> None:
    rig = make_rig()[0]
    rectified = Rectifier(rig).rig
    for camera, source in ((rectified.left, rig.left), (rectified.right, rig.right)):
        np.testing.assert_array_equal(camera.D, np.zeros(5))
        np.testing.assert_array_equal(camera.R, np.eye(3))
        np.testing.assert_array_equal(camera.K, source.P[:, :3])
        np.testing.assert_array_equal(camera.P, source.P)


@pytest.mark.parametrize('alpha', [0.0, 0.4, 1.0])
def test_alpha_equals_stereo_rectify(alpha: float) -> None:
    _, rotation, translation = make_rig()
    distortion = np.array(DISTORTIONS['plumb_bob'])
    cameras = (K_LEFT, distortion, K_RIGHT, distortion, SIZE, rotation, translation.reshape(3, 1))
    plain = cv2.stereoRectify(*cameras, alpha=-1, flags=0)
    wanted = cv2.stereoRectify(*cameras, alpha=alpha, flags=0)
    rig = StereoRig(
        Camera(*SIZE, K_LEFT, distortion, plain[0], plain[2]),
        Camera(*SIZE, K_RIGHT, distortion, plain[1], plain[3]),
    )
    rectified = Rectifier(rig, alpha).rig
    # OpenCV samples the border at 9 x 9 points only
    np.testing.assert_allclose(rectified.left.P, wanted[2], rtol=5e-3, atol=1e-6)
    np.testing.assert_allclose(rectified.right.P, wanted[3], rtol=5e-3, atol=1e-6)
    assert rectified.baseline_m == pytest.approx(rig.baseline_m, rel=1e-9)


@pytest.mark.parametrize('model', DISTORTIONS)
def test_alpha_0_has_no_empty_pixel_and_alpha_1_loses_none(model: str) -> None:
    rig = make_rig(model)[0]
    white = np.full(SIZE[::-1], 255, np.uint8)
    for rectified in Rectifier(rig, 0.0)(white, white):
        assert (rectified[1:-1, 1:-1] == 255).all()
    full = Rectifier(rig, 1.0).rig
    for camera, source in ((full.left, rig.left), (full.right, rig.right)):
        map_x, map_y = rectification_maps(dataclasses.replace(source, P=camera.P))
        assert map_x.min() <= 1 and map_x.max() >= SIZE[0] - 2
        assert map_y.min() <= 1 and map_y.max() >= SIZE[1] - 2


def test_pixels_are_taken_from_where_the_maps_lead() -> None:
    rig = make_rig()[0]
    ramps = np.meshgrid(*(np.arange(side, dtype=np.float32) for side in SIZE))
    rectifier = Rectifier(rig)
    found = np.array([rectifier(ramp, ramp) for ramp in ramps]).swapaxes(0, 1)
    exact = int(cv2.__version__.partition('.')[0]) >= 5
    for camera, (x, y) in zip((rig.left, rig.right), found, strict=True):
        map_x, map_y = rectification_maps(camera)
        inside = (map_x > 1) & (map_x < SIZE[0] - 2) & (map_y > 1) & (map_y < SIZE[1] - 2)
        error_px = np.abs(np.stack([x - map_x, y - map_y]))[:, inside]
        assert error_px.max() < (1e-3 if exact else 1 / 64 + 1e-3)


@pytest.mark.parametrize('scale', [2, 2.6, 3.3])
def test_detail_finer_than_a_rectified_pixel_is_averaged(scale: float) -> None:
    rig, _, _ = make_rig()
    fine = np.diag([1 / scale, 1 / scale, 1])
    coarse = StereoRig(
        *(dataclasses.replace(one, P=fine @ one.P, D=np.zeros(5)) for one in (rig.left, rig.right))
    )
    rectifier = Rectifier(coarse)
    columns, rows = np.meshgrid(np.arange(SIZE[0]), np.arange(SIZE[1]))
    stripes = np.where(columns % 2, 255, 0).astype(np.uint8)
    ramp = (1000 * 2 + 20 * columns + 3 * rows).astype(np.float32)
    map_x, map_y = rectification_maps(coarse.left)
    inside = (np.abs(map_x - 160) < 150) & (np.abs(map_y - 100) < 90)
    assert 500 < inside.sum() < 64000 / scale**2
    averaged, _ = rectifier(stripes, stripes)
    assert np.abs(averaged[inside].astype(float) - 127.5).max() <= 45  # a third of the stripes
    assert np.std(cv2.remap(stripes, map_x, map_y, cv2.INTER_LINEAR)[inside]) > 60
    shifted, _ = rectifier(ramp, ramp)
    true = 2000 + 20 * map_x + 3 * map_y
    # OpenCV 4 rounds to 1/32 px of the means
    assert np.abs(shifted - true)[inside].max() < 0.07 * 20


@pytest.mark.parametrize('dtype', [np.uint8, np.uint16, np.float32])
@pytest.mark.parametrize('channels', [(), (3,), (4,)])
def test_shape_and_dtype_are_kept(dtype: type, channels: tuple[int, ...]) -> None:
    image: Image = np.ones((*SIZE[::-1], *channels), dtype)
    left, right = Rectifier(make_rig()[0])(image, image)
    assert left.shape == right.shape == image.shape
    assert left.dtype == right.dtype == dtype


@pytest.mark.parametrize(
    ('R', 'message'),
    [
        (
            np.zeros((3, 3)),
            r'right camera: R is not a rotation \(R R\^T is 1\.0 from the identity, det',
        ),
        (1.01 * np.eye(3), r'R is not a rotation \(R R\^T is 0\.020 from'),
        (
            np.diag([1, 1, -1]),
            r'R is not a rotation .* determinant -1\.0\); calibrate as a stereo rig',
        ),
    ],
)
def test_what_is_not_a_rotation_is_refused(R: FloatArray, message: str) -> None:
    rig = make_rig()[0]
    with pytest.raises(CalibrationError, match=message):
        Rectifier(dataclasses.replace(rig, right=dataclasses.replace(rig.right, R=R)))


def test_a_rotation_written_with_four_digits_is_one() -> None:
    rig = make_rig()[0]
    right = dataclasses.replace(rig.right, R=rig.right.R.round(4))
    Rectifier(dataclasses.replace(rig, right=right))


def test_wrong_size_is_refused() -> None:
    good, bad = np.zeros((200, 320), np.uint8), np.zeros((100, 320), np.uint8)
    rectifier = Rectifier(make_rig()[0])
    with pytest.raises(ImageError, match=r'right image is 320x100 px, .* for 320x200'):
        rectifier(good, bad)


def test_images_larger_than_opencv_takes_are_refused() -> None:
    rig = make_rig()[0]
    left, right = (dataclasses.replace(camera, width=33_000) for camera in (rig.left, rig.right))
    with pytest.raises(ImageError, match=r'of 33000x200 px cannot be rectified: .* 32766 px'):
        Rectifier(StereoRig(left, right))


@pytest.mark.parametrize('D', [[-0.30, 0.10, 0, 0, 0], [-0.32, 0.14, 1e-3, -5e-4, -0.02]])
def test_points_are_rectified_to_where_the_maps_take_them_from(D: list[float]) -> None:
    """Strong distortion: five fixed-point iterations would be off by up to 0.26 px."""
    rig = make_rig()[0]
    for source in (rig.left, rig.right):
        camera = dataclasses.replace(source, D=np.array(D), P=source.P * [[0.8], [0.8], [1]])
        map_x, map_y = rectification_maps(camera)
        inside = (map_x > 0) & (map_x < SIZE[0] - 1) & (map_y > 0) & (map_y < SIZE[1] - 1)
        rows, columns = np.nonzero(inside)
        raw = np.column_stack([map_x[inside], map_y[inside]]).astype(np.float64)
        # the maps are single precision
        np.testing.assert_allclose(
            rectified_points(camera, raw), np.column_stack([columns, rows]), atol=1e-4
        )


def test_alpha_needs_a_border_that_can_be_undistorted() -> None:
    rig = make_rig()[0]
    folded = dataclasses.replace(rig.left, D=np.array([-1.2, 0, 0, 0]))
    match = r'plumb_bob cannot undistort \d+% of the image border .* use alpha -1, or calibrate'
    with pytest.raises(CalibrationError, match=match):
        Rectifier(dataclasses.replace(rig, left=folded), 0.0)
    Rectifier(dataclasses.replace(rig, left=folded))


@pytest.mark.parametrize('alpha', [-0.5, 1.1, float('nan')])
def test_alpha_out_of_range_is_refused(alpha: float) -> None:
    with pytest.raises(ConfigError, match='alpha must be -1'):
        Rectifier(make_rig()[0], alpha)


def _euroc_rig(folder: Path) -> StereoRig:
    poses, cameras = [], []
    for name in ('cam0', 'cam1'):
        text = (folder / name / 'sensor.yaml').read_text().replace('%YAML:1.0', '')
        sensor = yaml.safe_load(text)
        poses.append(np.array(sensor['T_BS']['data']).reshape(4, 4))
        fu, fv, cu, cv = sensor['intrinsics']
        cameras.append(
            (np.array([[fu, 0, cu], [0, fv, cv], [0, 0, 1]]), sensor['distortion_coefficients'])
        )
    width, height = sensor['resolution']
    right_from_left = np.linalg.inv(poses[1]) @ poses[0]
    (k_left, d_left), (k_right, d_right) = cameras
    result = cv2.stereoRectify(
        k_left, np.array(d_left), k_right, np.array(d_right), (width, height),
        right_from_left[:3, :3], right_from_left[:3, 3:], alpha=-1, flags=0,
    )  # fmt: skip
    return StereoRig(
        Camera(width, height, k_left, d_left, result[0], result[2]),
        Camera(width, height, k_right, d_right, result[1], result[3]),
    )


def test_features_of_a_real_unrectified_rig_lie_on_common_rows(shared_data: Path) -> None:
    folder = shared_data / 'raw_stereo'
    rectifier = Rectifier(_euroc_rig(folder))
    detector = cv2.ORB_create(nfeatures=1500)
    matcher = cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True)
    rows, disparities = [], []
    for path in sorted((folder / 'cam0').glob('*.png'))[::3]:
        pair = [cv2.imread(str(folder / cam / path.name), 0) for cam in ('cam0', 'cam1')]
        (left, d_left), (right, d_right) = (
            detector.detectAndCompute(image, None) for image in rectifier(*pair)
        )
        found = [m for m in matcher.match(d_left, d_right) if m.distance < 30]
        shift = np.array([np.subtract(left[m.queryIdx].pt, right[m.trainIdx].pt) for m in found])
        # the descriptor alone has wrong matches: keep those within 2 rows for the disparity's sign
        rows.append(np.abs(shift[:, 1]))
        disparities.append(shift[np.abs(shift[:, 1]) < 2, 0])
    offset = rectifier.rig.disparity_offset_px
    assert np.median(np.concatenate(rows)) <= 0.5
    assert (np.concatenate(disparities) > offset).mean() >= 0.99


def test_rig_of_swapped_cameras_is_refused() -> None:
    rig = make_rig()[0]
    with pytest.raises(
        CalibrationError, match='left and right are exchanged; exchange the cameras'
    ):
        StereoRig(rig.right, rig.left)


@pytest.mark.parametrize('model', DISTORTIONS)
def test_skew_of_the_raw_camera_counts(model: str) -> None:
    """OpenCV leaves K[0, 1] out; it moves a point by K[0, 1] times its distorted y."""
    straight = make_rig(model)[0].left
    skewed = K_LEFT.copy()
    skewed[0, 1] = 2.5
    camera = dataclasses.replace(straight, K=skewed)
    map_x, map_y = rectification_maps(straight)
    found_x, found_y = rectification_maps(camera)
    np.testing.assert_array_equal(found_y, map_y)
    np.testing.assert_allclose(found_x - map_x, 2.5 / 252 * (map_y - 103), atol=1e-4)
    pixels = np.array([[100.0, 60], [200, 150], [10, 190]])
    raw = np.stack(
        [m[pixels[:, 1].astype(int), pixels[:, 0].astype(int)] for m in (found_x, found_y)]
    )
    np.testing.assert_allclose(rectified_points(camera, raw.T.astype(float)), pixels, atol=1e-3)


def test_images_of_another_size_say_the_scale() -> None:
    rectifier = Rectifier(make_rig()[0])
    for size, text in (
        ((400, 640), 'scale K and P by 2; if they are those of this resolution, correct the size'),
        ((400, 500), 'so it was cropped'),
    ):
        image = np.zeros(size, np.uint8)
        with pytest.raises(ImageError, match=f'its calibration is for 320x200; .*{text}'):
            rectifier(image, image)
