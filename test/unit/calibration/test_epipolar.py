# SPDX-License-Identifier: Apache-2.0
"""Epipolar correction: eq. 1-9 held numerically, and what CameraInfo needs of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import rq

from binocular_recon.calibration.model import StereoCalibration
from binocular_recon.calibration.rectification.epipolar import (
    F_STAR,
    epipoles,
    free_pair,
    fundamental_matrix,
    row_aligning_pair,
)
from binocular_recon.calibration.rectification.homography import Correction, ImageGrid, apply
from binocular_recon.calibration.rectification.metric_rectification import (
    check_order,
    correction_of,
    metric_rig,
)
from binocular_recon.camera import FloatArray
from binocular_recon.errors import CalibrationError
from binocular_recon.rotations import quarter_turn, rotation, turned_pixels
from binocular_recon.stereo.rectification import Rectifier
from test.calibration_tools import truth


def turned(x: float, y: float, z: float, centre: tuple[float, float, float]) -> StereoCalibration:
    """Return the survey rig with another pose of its right camera."""
    R = rotation(np.array([x, y, z]))
    return replace(truth(), R=R, T=-R @ np.array(centre))


RIGS = {
    'survey': truth(),
    'converging': turned(0.01, 0.12, -0.02, (1.0, 0.02, 0.05)),
    'diverging': turned(-0.02, -0.05, 0.03, (0.8, -0.05, -0.1)),
    'ideal': turned(0.0, 0.0, 0.0, (1.0, 0.0, 0.0)),
    'below': turned(0.01, 0.03, -0.02, (0.05, 0.9, 0.04)),
    'above': turned(-0.02, 0.01, 0.03, (-0.03, -0.8, 0.02)),
}


def pairs(calibration: StereoCalibration) -> dict[str, Correction]:
    """Return all corrections; of cameras one above the other to images turned into rows."""
    metric = correction_of(calibration, metric_rig(calibration))
    turn = turned_pixels(calibration.turns, calibration.image_size)
    return {
        'basic': row_aligning_pair(calibration),
        'free': free_pair(calibration),
        'metric': Correction(turn @ metric.H_left, turn @ metric.H_right),
    }


def seen_points(calibration: StereoCalibration) -> tuple[FloatArray, FloatArray, FloatArray]:
    points = np.random.default_rng(0).uniform([-3, -2, 5], [3, 2, 20], (200, 3))
    left, right = (
        calibration.undistort(calibration.project(points, side), side)
        for side in ('left', 'right')
    )
    return points, left, right


@pytest.mark.parametrize('rig', RIGS)
def test_epipolar_constraint_and_epipoles(rig: str) -> None:
    calibration = RIGS[rig]
    _, left, right = seen_points(calibration)
    F = fundamental_matrix(calibration)
    ones = np.ones((len(left), 1))
    residual = np.einsum('ni,ij,nj->n', np.c_[right, ones], F, np.c_[left, ones])
    np.testing.assert_allclose(residual, 0, atol=1e-9)
    e_left, e_right = epipoles(calibration)
    np.testing.assert_allclose(F @ e_left, 0, atol=1e-12)
    np.testing.assert_allclose(e_right @ F, 0, atol=1e-12)


@pytest.mark.parametrize('kind', ['basic', 'free', 'metric'])
@pytest.mark.parametrize('rig', RIGS)
def test_rows_correspond_exactly(rig: str, kind: str) -> None:
    calibration = RIGS[rig]
    pair = pairs(calibration)[kind]
    _, left, right = seen_points(calibration)
    rows = [apply(H, px)[:, 1] for H, px in ((pair.H_left, left), (pair.H_right, right))]
    np.testing.assert_allclose(rows[0], rows[1], atol=1e-7)
    F = (
        np.linalg.inv(pair.H_right).T
        @ fundamental_matrix(calibration)
        @ np.linalg.inv(pair.H_left)
    )
    np.testing.assert_allclose(F / F[1, 2], F_STAR, atol=1e-9)  # eq. 5


@pytest.mark.parametrize('rig', RIGS)
def test_both_pairs_are_members_of_eq_9(rig: str) -> None:
    found = pairs(RIGS[rig])
    for kind in ('free', 'metric'):
        blocks = []
        for side in ('left', 'right'):
            member = found[kind].side(side) @ np.linalg.inv(found['basic'].side(side))
            member /= member[2, 2]
            assert abs(member[1, 0]) < 1e-9 and abs(member[2, 0]) < 1e-12
            blocks.append(member[1:, 1:])
        # s, u0 and q are common
        np.testing.assert_allclose(blocks[0], blocks[1], rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize('rig', RIGS)
def test_metric_pair_is_two_cameras_of_one_orientation(rig: str) -> None:
    calibration = RIGS[rig]
    rectified = metric_rig(calibration)
    pair = correction_of(calibration, rectified)
    found = []
    for side in ('left', 'right'):
        K, _, R, _ = calibration.side(side)
        K_star, R_star = rq(pair.side(side) @ K @ R)  # H M = K* R* [I | -C], eq. 1-2
        signs = np.diag(np.sign(np.diag(K_star)))
        found.append((K_star @ signs / (K_star @ signs)[2, 2], signs @ R_star))
    (K_left, R_left), (K_right, R_right) = found
    np.testing.assert_allclose(R_left, R_right, atol=1e-9)
    assert np.linalg.det(R_left) == pytest.approx(1)
    np.testing.assert_allclose(K_left[0, 1], 0, atol=1e-6)
    across = 0 if rectified.turns else 1
    shared = [0, 1, across], [0, 1, 2]
    np.testing.assert_allclose(K_left[shared], K_right[shared])
    np.testing.assert_allclose(K_left, rectified.left.P[:, :3], atol=1e-6)


@pytest.mark.parametrize('rig', RIGS)
def test_depth_from_disparity_is_metric(rig: str) -> None:
    calibration = RIGS[rig]
    rectified = metric_rig(calibration)
    pair = pairs(calibration)['metric']
    points, left, right = seen_points(calibration)
    disparity = (apply(pair.H_left, left) - apply(pair.H_right, right))[:, 0]
    depth = rectified.focal_px * rectified.baseline_m / (disparity - rectified.disparity_offset_px)
    np.testing.assert_allclose(depth, (points @ rectified.left.R.T)[:, 2], rtol=1e-7)
    assert rectified.baseline_m == pytest.approx(calibration.baseline_m)


def test_points_at_infinity_have_no_disparity_unless_the_cameras_squint() -> None:
    assert metric_rig(RIGS['survey']).disparity_offset_px == pytest.approx(0, abs=1e-9)
    squinting = turned(0.0, 0.25, 0.0, (1.0, 0.0, 0.0))
    assert abs(metric_rig(squinting).disparity_offset_px) > 300


@pytest.mark.parametrize('rig', RIGS)
def test_images_are_resampled_little_and_stay_upright(rig: str) -> None:
    calibration = RIGS[rig]
    found = pairs(calibration)
    departures = {}
    for kind in ('free', 'metric'):
        values = []
        for side in ('left', 'right'):
            grid = ImageGrid.of(calibration, side)
            H = found[kind].side(side)
            values.append(grid.resampling(H))
            centre = np.array([959.5, 599.5])
            step = apply(H, centre + np.eye(2) * 10) - apply(H, centre)
            step = step @ quarter_turn(calibration.turns)[:2, :2]
            assert step[0, 0] > 7 and step[1, 1] > 7
        departures[kind] = float(np.sum(np.square(values)))
    # the metric pair is a member of the free family, so it cannot resample less
    assert departures['free'] <= departures['metric'] * (1 + 1e-6)
    assert np.sqrt(departures['metric'] / (4 * 81)) < 0.08


def test_rectified_images_use_what_is_stated() -> None:
    calibration = RIGS['survey']
    rectifier = Rectifier(metric_rig(calibration))
    point = np.array([[0.4, -0.3, 9.0]])
    images = []
    for side in ('left', 'right'):
        y, x = np.mgrid[:1200, :1920]
        spot = calibration.project(point, side)[0]
        blob = 255 * np.exp(-((x - spot[0]) ** 2 + (y - spot[1]) ** 2) / 18)
        images.append(blob.astype(np.float32))
    rows = []
    for rectified in rectifier(*images):
        weights = rectified.sum(axis=1)
        rows.append(float(weights @ np.arange(1200) / weights.sum()))
    assert rows[0] == pytest.approx(rows[1], abs=0.03)


def test_distortion_that_folds_the_corners_is_left_out() -> None:
    step = np.zeros(30)
    step[[8, 20]] = -1.2
    folded = truth().moved(step)
    assert 0.5 < ImageGrid.of(folded, 'left').usable_share < 1
    rig = metric_rig(folded)
    assert rig.focal_px == pytest.approx(1650, rel=0.25)
    with pytest.raises(CalibrationError, match='distortion of the left camera is not invertible'):
        metric_rig(truth().moved(20 * step))


def test_epipole_inside_the_image_is_refused() -> None:
    forward = turned(0.0, 0.0, 0.0, (0.05, 0.02, 1.0))
    with pytest.raises(CalibrationError, match='epipole of the left image lies inside'):
        row_aligning_pair(forward)
    with pytest.raises(CalibrationError, match='epipole'):
        metric_rig(turned(0.0, 0.0, 0.0, (0.5, 0.0, 1.0)))


def test_epipole_too_close_is_refused() -> None:
    near = turned(0.0, -0.9, 0.0, (1.0, 0.0, 0.9))
    for correct in (free_pair, metric_rig):
        with pytest.raises(CalibrationError, match=r'epipole .* side by side'):
            correct(near)


def test_swapped_cameras_are_refused() -> None:
    with pytest.raises(CalibrationError, match='left and right are swapped'):
        check_order(turned(0.0, 0.0, 0.0, (-1.0, 0.0, 0.0)))
