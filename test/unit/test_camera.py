# SPDX-License-Identifier: Apache-2.0
"""Cameras and rigs: derived quantities, what is read otherwise, doubted and refused."""

from __future__ import annotations

import dataclasses
import re
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from binocular_recon.camera import Camera, StereoRig
from binocular_recon.errors import CalibrationError
from binocular_recon.inputs.camera_reading import camera_of_image

K = np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]])
D8 = np.array([0.1, -0.2, 1e-3, 2e-3, 0.03, 0.4, 0.05, 0.06])


def make_camera(cx: float = 320.0, tx: float = 0.0) -> Camera:
    projection = np.array([[500.0, 0, cx, tx], [0, 500, 240, 0], [0, 0, 1, 0]])
    return Camera(640, 480, K, np.zeros(5), np.eye(3), projection)


def changed(matrix: npt.NDArray[Any], row: int, column: int, value: float) -> npt.NDArray[Any]:
    result = np.array(matrix, float)
    result[row, column] = value
    return result


@pytest.mark.parametrize('D', [[], np.zeros(4)])
def test_a_camera_without_a_distortion_model_has_no_distortion(D: Any) -> None:
    camera = dataclasses.replace(make_camera(), D=D, distortion_model='')
    assert camera.distortion_model == 'plumb_bob'
    np.testing.assert_array_equal(camera.D, np.zeros(5))
    assert camera.notices == ()


@pytest.mark.parametrize(
    ('model', 'D', 'expected', 'count', 'notice'),
    [
        ('radtan', D8[:4], 'plumb_bob', 4, "distortion model 'radtan' is read as plumb_bob"),
        ('Brown-Conrady', D8[:5], 'plumb_bob', 5, 'is read as plumb_bob'),
        ('fisheye', D8[:4], 'equidistant', 4, "'fisheye' is read as equidistant"),
        ('equi', D8[:4], 'equidistant', 4, "'equi' is read as equidistant"),
        ('Kannala Brandt4', [*D8[:4], 0], 'equidistant', 4, '5 coefficients of equidistant are'),
        ('equidistant', [*D8[:4], 0], 'equidistant', 4, 'are read as 4: the rest is 0'),
        ('plumb_bob', [*D8[:5], 0, 0, 0], 'plumb_bob', 5, '8 coefficients of plumb_bob'),
        ('plumb_bob', np.zeros(3), 'plumb_bob', 4, 'the rest is 0'),
        ('plumb_bob', D8, 'rational_polynomial', 8, 'plumb_bob with 8 coefficients is read as'),
        ('rational_polynomial', D8[:5], 'rational_polynomial', 8, ''),
        ('OPENCV_FISHEYE', D8[:4], 'equidistant', 4, 'is read as equidistant'),
        ('none', np.zeros(2), 'plumb_bob', 5, "model 'none' is read as no distortion"),
        ('Inverse Brown Conrady', np.zeros(5), 'plumb_bob', 5, 'is read as no distortion'),
        ('', D8[:5], 'plumb_bob', 5, "distortion model '' is read as plumb_bob"),
        ('', D8, 'rational_polynomial', 8, "distortion model '' is read as rational_polynomial"),
    ],
)
def test_what_means_the_same_is_accepted_with_a_notice(
    model: str, D: Any, expected: str, count: int, notice: str
) -> None:
    camera = dataclasses.replace(make_camera(), D=D, distortion_model=model)
    assert camera.distortion_model == expected
    assert camera.D.size == count
    rays = np.array([[0.3, -0.2], [-0.1, 0.25]])
    whole = np.concatenate([np.asarray(D, float), np.zeros(8)])[: 4 if count == 4 else 8]
    np.testing.assert_array_equal(camera.lens.distort(rays, camera.D)[0].size, 2)
    np.testing.assert_allclose(camera.D, whole[:count])
    assert notice in '; '.join(camera.notices)
    assert len(dataclasses.replace(camera, width=600).notices) == len(camera.notices)


def test_baseline_focal_length_and_offset() -> None:
    rig = StereoRig(make_camera(), make_camera(cx=350.0, tx=-400.0))
    assert rig.baseline_m == pytest.approx(0.8)
    assert rig.focal_px == 500.0
    assert rig.disparity_offset_px == pytest.approx(-30.0)
    assert rig.notices == () and rig.warnings == ()


@pytest.mark.parametrize(
    ('change', 'message'),
    [
        ({'K': np.zeros((3, 3))}, 'camera is not calibrated .*fx = 0'),
        ({'K': np.eye(2)}, 'K must have 9 values, got 4'),
        ({'K': K * np.nan}, 'K holds values that are not finite'),
        ({'K': changed(K, 1, 0, 2.0)}, r'K\[1, 0\] is 2, it must be 0'),
        (
            {'K': changed(K, 2, 2, 0.0)},
            r'K\[2, 2\] is 0, it must be 1; the last row of K is 0 0 1',
        ),
        ({'K': changed(K, 2, 0, 320)}, r'K\[2, 0\] is 320, it must be 0; .* order of its values'),
        ({'P': np.zeros((3, 4))}, 'P is not that of a rectified camera'),
        ({'P': changed(make_camera().P, 0, 1, 5.0)}, r'P\[0, 1\] is 5, .* rectify without skew'),
        ({'P': changed(make_camera().P, 1, 0, -3.0)}, r'P\[1, 0\] is -3, it must be 0'),
        ({'P': changed(make_camera().P, 2, 1, 0.1)}, r'P\[2, 1\] is 0\.1, it must be 0'),
        (
            {'P': 2 * make_camera().P},
            r'P\[2, 2\] is 2, it must be 1; the last row of P is 0 0 1 0',
        ),
        ({'D': D8[:3]}, 'plumb_bob takes 0 or 4 or 5 distortion coefficients, got 3'),
        ({'D': D8[:5], 'distortion_model': 'equi'}, 'equidistant takes 4 distortion .* got 5'),
        ({'distortion_model': 'none', 'D': D8[:4]}, "distortion model 'none' is not one of"),
        ({'distortion_model': 'fov'}, "distortion model 'fov' is not one of plumb_bob"),
        ({'distortion_model': '', 'D': np.array([0.1])}, "distortion model '' is not one of"),
        ({'width': 0}, 'image size must be positive, got 0x480'),
    ],
)
def test_bad_camera_is_refused(change: dict[str, Any], message: str) -> None:
    with pytest.raises(CalibrationError, match=message):
        dataclasses.replace(make_camera(), **change)


def test_of_a_rectified_image_only_p_counts() -> None:
    P = make_camera().P
    for K_given, D, model in ((0 * K, [], ''), (K, D8[:3], 'plumb_bob'), (K, [1], 'mystery')):
        camera = camera_of_image((640, 480), K_given, D, 0 * K, P, model, rectified=True)
        np.testing.assert_array_equal(camera.K, P[:, :3])
        assert not camera.D.any()
        (notice,) = camera.notices
        assert notice.endswith('the images are rectified, so only P is used')
        assert notice.count(';') == 1  # no remedy for what does no harm
        with pytest.raises(CalibrationError):
            camera_of_image((640, 480), K_given, D, 0 * K, P, model)
    fine = camera_of_image((640, 480), K, D8[:4], np.eye(3), P, 'radtan', rectified=True)
    assert fine.notices == ()
    unknown = np.where(np.eye(3, 4, 2), np.nan, P)
    with pytest.raises(CalibrationError, match='P holds values that are not finite'):
        camera_of_image((640, 480), K, [], np.eye(3), unknown, '', rectified=True)
    with pytest.raises(CalibrationError, match='P is not that of a rectified camera'):
        camera_of_image((640, 480), K, [], np.eye(3), 0 * P, '', rectified=True)


@pytest.mark.parametrize(
    ('left', 'right', 'message'),
    [
        ((0, 0, 0), (400, 0, 0), r'got -0.8 m: P_right\[0, 3\] is 400, it must be -f B, below 0'),
        ((-400, 0, 0), (0, 0, 0), 'got -0.8 m: .*left and right are exchanged; exchange the cam'),
        ((0, 0, 0), (0, 0, 0), 'got 0 m: .*each was calibrated alone; calibrate as a rig'),
        ((0, 0, 0), (-400, 30, 0), r'is 30 px m and -400 px m in .* the pair is not rectified'),
        ((0, 0, 0), (30, -400, 0), r'is -400 px m and 30 px m in .* along rows or columns'),
        ((0, 0, 0), (-400, 0, -0.8), r'P\[2, 3\] is 0 m in the left and -0.8 m in the right'),
    ],
)
def test_baselines_that_are_none(
    left: tuple[float, ...], right: tuple[float, ...], message: str
) -> None:
    cameras = [
        dataclasses.replace(make_camera(), P=np.c_[make_camera().P[:, :3], np.array(shift, float)])
        for shift in (left, right)
    ]
    with pytest.raises(CalibrationError, match=message):
        StereoRig(*cameras)


@pytest.mark.parametrize(('ty', 'turns', 'offset'), [(-400.0, 1, -12.0), (400.0, -1, 12.0)])
def test_one_camera_above_the_other(ty: float, turns: int, offset: float) -> None:
    P = make_camera().P.copy()
    P[1, 2:] = 252, ty
    rig = StereoRig(make_camera(), dataclasses.replace(make_camera(), P=P))
    assert (rig.turns, rig.disparity_offset_px) == (turns, offset)
    assert (rig.baseline_m, rig.focal_px) == (0.8, 500.0)
    assert rig.warnings == ()
    P[0, 2] += 5
    with pytest.raises(CalibrationError, match='must share fx, fy and cx, got left 500'):
        StereoRig(make_camera(), dataclasses.replace(make_camera(), P=P))


@pytest.mark.parametrize(
    ('right', 'message'),
    [
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


@pytest.mark.parametrize(
    ('tx', 'warning'),
    [
        (-5.0, ''),
        (-9999.0, ''),
        (-60_000.0, r'baseline is 120 m, outside 0.01 to 20 m: if it is in milli.* \(0.12 m\)'),
        (-0.12, r'baseline is 0.00024 m, .* P\[0, 3\] is the baseline itself \(0.12\)'),
        (-0.005, r'baseline is 1e-05 m, .* check the unit'),
    ],
)
def test_baseline_in_other_units_is_doubted(tx: float, warning: str) -> None:
    warnings = StereoRig(make_camera(), make_camera(tx=tx)).warnings
    assert len(warnings) == bool(warning)
    for text in warnings:
        assert re.search(warning, text)


@pytest.mark.parametrize('place', [(0, 0), (1, 1), (1, 2)])
def test_cameras_of_two_calibrations_are_said(place: tuple[int, int]) -> None:
    """As when a driver has loaded the new file of one camera only."""
    right = make_camera(tx=-400.0)
    P = right.P.copy()
    for off_px, said in ((0.004, False), (0.2, True)):
        P[place] = right.P[place] + off_px
        warnings = StereoRig(make_camera(), dataclasses.replace(right, P=P)).warnings
        assert [('differ by 0.2 px' in text) for text in warnings] == [True] * said


def test_rows_displaced_as_in_published_rectifications_are_said_but_used() -> None:
    """The colour cameras of KITTI 2011_09_26."""
    left, right = (
        dataclasses.replace(make_camera(), P=np.c_[make_camera().P[:, :3], [tx, ty, tz]])
        for tx, ty, tz in ((44.85728, 0.2163791, 0.002745884), (-339.5242, 2.199936, 0.002729905))
    )
    (text,) = StereoRig(left, right).warnings
    assert 'rows are off by 0.52% of the disparity' in text


@pytest.mark.parametrize(
    ('scale', 'rectified', 'warning'),
    [
        (1.0, False, ''),
        (2.0, False, r'as in a calibration for 1280x960 px \(scale 2.00\): depth would be 2.00'),
        (2.0, True, r'as in a calibration for 1280x960 px \(scale 2.00\)'),
        (0.5, False, r'as in a calibration for 320x240 px \(scale 0.50\).* state binning once'),
        (0.5, True, r'as in a calibration for 320x240 px'),
        (1.5, False, r'as in a calibration for 960x720 px'),
    ],
)
def test_calibration_of_another_resolution_is_said(
    scale: float, rectified: bool, warning: str
) -> None:
    full = K.copy()
    full[:2] *= scale
    projection = make_camera().P.copy()
    projection[:2] *= scale
    camera = camera_of_image(
        (640, 480), full, np.zeros(5), np.eye(3), projection, 'plumb_bob', rectified=rectified
    )
    assert bool(camera.warning) == bool(warning)
    assert re.search(warning, camera.warning)


def test_principal_point_of_a_crop_is_said_for_raw_images_only() -> None:
    cropped = changed(K, 0, 2, 460.0)
    camera = dataclasses.replace(make_camera(), K=cropped)
    assert 'region of interest are applied once' in camera.warning
    assert make_camera(cx=460.0).warning == ''  # P moves with rectification
    rig = StereoRig(camera, dataclasses.replace(make_camera(tx=-400.0), K=cropped))
    assert [text.split(':')[0] for text in rig.warnings] == ['left camera', 'right camera']
