# SPDX-License-Identifier: Apache-2.0
"""The calibration's share of points' covariance, against calibrations drawn from it."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from scipy.linalg import block_diag

from binocular_recon.calibration.adjustment.uncertainty import depth_derivatives
from binocular_recon.calibration.model import StereoCalibration
from binocular_recon.calibration.rectification.metric_rectification import metric_rig
from binocular_recon.camera import FloatArray, RigCovariance, StereoRig, parameter_names
from binocular_recon.cloud_config import CloudConfig
from binocular_recon.errors import CalibrationError, ImageError
from binocular_recon.measurement.lengths import Length, length_between
from binocular_recon.rotations import quarter_turn, turned_pixels
from binocular_recon.simulation.rig import RawRig, fisheye_rig, survey_rig
from binocular_recon.stereo.point_covariance import (
    add_covariance,
    calibration_derivatives,
    joint_covariance,
)
from binocular_recon.stereo.rectification import Rectifier
from binocular_recon.stereo.triangulation import triangulate
from binocular_recon.stereo.validity import Validity

RIGS = {'plumb_bob': survey_rig, 'equidistant': fisheye_rig}
POINTS = np.array([[1.0, 0.5, 12.0], [-3.0, -1.5, 9.0], [4.0, 2.5, 20.0], [0.2, 0.3, 5.0]])
# One standard deviation of each kind of parameter of an ordinary calibration.
SIGMAS = {'f': 2.0, 'c': 1.5, 'k': 5e-4, 'p': 2e-4, 't': 2e-4, 'T': 1e-3}


def nominal(raw: RawRig) -> StereoCalibration:
    left, right = raw.left, raw.right
    lens = left.distortion_model
    return StereoCalibration(left.size, left.K, left.D, right.K, right.D, raw.R, raw.T, lens)


@lru_cache
def rig_of(lens: str) -> tuple[StereoCalibration, StereoRig]:
    """Return a calibration, and its rig with a covariance whose parameters are correlated."""
    calibration = nominal(RIGS[lens]())
    rig = metric_rig(calibration)
    names = calibration.parameters
    # k4 to k6 of a plumb_bob lens are not estimated
    free = np.array([name[:2] not in {'k4', 'k5', 'k6'} or lens != 'plumb_bob' for name in names])
    scale = free * np.array([SIGMAS[name[0]] for name in names])
    mixing = np.eye(len(names)) + 0.3 * np.random.default_rng(5).normal(size=(len(names),) * 2)
    root = scale[:, None] * mixing / np.linalg.norm(mixing, axis=1, keepdims=True)
    known = RigCovariance(rig.left, rig.right, names, root @ root.T)
    return calibration, StereoRig(rig.left, rig.right, covariance=known)


def observe(
    actual: StereoCalibration, points: FloatArray, assumed: StereoCalibration, rig: StereoRig
) -> FloatArray:
    """Return the three numbers that measure points of the left rectified frame, (N, 3).

    The raw left pixel of a rig that is ``actual``, and the column that its right pixel takes in
    images rectified by ``assumed``.
    """
    local = points @ rig.left.R
    left, right = (actual.project(local, side) for side in ('left', 'right'))
    rays = assumed.lens_model.rays(right, assumed.K_right, assumed.D_right)
    seen = np.concatenate([rays, np.ones_like(rays[:, :1])], axis=-1) @ rig.right.R.T
    return np.column_stack([left, seen[:, 0] / seen[:, 2]])


def measured(
    actual: StereoCalibration, truth: FloatArray, assumed: StereoCalibration, rig: StereoRig
) -> FloatArray:
    """Return the points that ``assumed`` gives for what the rig ``actual`` sees at ``truth``."""
    seen = observe(actual, truth, assumed, rig)
    plane = assumed.lens_model.rays(seen[:, :2], assumed.K_left, assumed.D_left)
    rays = np.concatenate([plane, np.ones_like(plane[:, :1])], axis=-1) @ rig.left.R.T
    rays /= rays[:, 2:]
    depth_m = rig.baseline_m / (rays[:, 0] - seen[:, 2])
    return rays * depth_m[:, None]


@pytest.mark.parametrize('lens', RIGS)
def test_derivatives_are_those_of_points_solved_for(lens: str) -> None:
    calibration, rig = rig_of(lens)
    derivatives = calibration_derivatives(POINTS, rig)
    for index, name in enumerate(calibration.parameters):
        step = np.zeros(len(calibration.parameters))
        step[index] = 0.1 * SIGMAS[name[0]]
        # a rig that differs from its calibration by a step sees the points elsewhere
        moved = [
            measured(calibration.moved(sign * step), POINTS, calibration, rig) for sign in (1, -1)
        ]
        numeric = -(moved[0] - moved[1]) / (2 * step[index])
        limit = 2e-3 * np.abs(numeric).max()
        np.testing.assert_allclose(derivatives[..., index], numeric, atol=limit, err_msg=name)


@pytest.mark.parametrize('lens', RIGS)
def test_depth_moves_as_in_the_calibration(lens: str) -> None:
    calibration, rig = rig_of(lens)
    free = np.ones(len(calibration.parameters), np.bool_)
    free[3] = False
    local = POINTS @ rig.left.R
    found = depth_derivatives(calibration, free, local)
    # along the axis of the left camera, as the calibration states depths
    along = np.einsum('nip,i->np', calibration_derivatives(POINTS, rig), rig.left.R[:, 2])
    np.testing.assert_allclose(found, along[:, free], atol=1e-3 * np.abs(along).max())
    left, right = (calibration.project(local, side) for side in ('left', 'right'))
    for index, column in zip(np.flatnonzero(free), found.T, strict=True):
        step = np.zeros(free.size)
        step[index] = 0.01 * SIGMAS[calibration.parameters[index][0]]
        depths = [
            calibration.moved(sign * step).triangulate(left, right)[:, 2] for sign in (1, -1)
        ]
        numeric = (depths[0] - depths[1]) / (2 * step[index])
        # the direct linear transform shares the error of a row out otherwise
        np.testing.assert_allclose(column, numeric, atol=3e-3 * np.abs(numeric).max() + 1e-3)


def drawn_errors(lens: str, draws: int, seed: int) -> FloatArray:
    """Return errors of `POINTS` for rigs that differ from their calibration, (draws, N, 3) m."""
    calibration, rig = rig_of(lens)
    assert rig.covariance is not None
    rng = np.random.default_rng(seed)
    count = len(calibration.parameters)
    steps = rng.multivariate_normal(np.zeros(count), rig.covariance.matrix, draws)
    return np.stack(
        [measured(calibration.moved(step), POINTS, calibration, rig) - POINTS for step in steps]
    )


@pytest.mark.long
@pytest.mark.parametrize('lens', RIGS)
def test_covariance_is_the_spread_of_drawn_calibrations(lens: str) -> None:
    _, rig = rig_of(lens)
    errors = drawn_errors(lens, 1500, 11).reshape(1500, -1)
    covariance = joint_covariance(POINTS, rig).reshape(12, 12)
    sigmas = np.sqrt(np.diag(covariance))
    assert np.sqrt(np.mean(errors**2, axis=0)) == pytest.approx(sigmas, rel=0.08)
    correlation = covariance / np.outer(sigmas, sigmas)
    np.testing.assert_allclose(np.corrcoef(errors.T), correlation, atol=0.08)


def test_lengths_are_better_known_than_their_ends() -> None:
    _, rig = rig_of('plumb_bob')
    ends = np.array([[0.0, 0.0, 14.0], [0.3, 0.9, 14.2]])
    length = length_between(ends, joint_covariance(ends, rig))
    point_sigma = np.sqrt(joint_covariance(ends[:1], rig)[0, 2, 0, 2])
    assert length.length_m == pytest.approx(np.sqrt(0.3**2 + 0.9**2 + 0.2**2))
    assert length.sigma_m < 0.2 * point_sigma
    # with independent ends nothing cancels
    apart = joint_covariance(ends, rig)
    apart[0, :, 1, :] = apart[1, :, 0, :] = 0
    assert length_between(ends, apart).sigma_m > 3 * length.sigma_m
    assert str(Length(1.7951, 0.0062)) == '1.795 +- 0.006 m'


@pytest.mark.long
def test_length_sigma_is_the_spread_of_drawn_calibrations() -> None:
    _, rig = rig_of('plumb_bob')
    moved = drawn_errors('plumb_bob', 1500, 12) + POINTS
    lengths = np.linalg.norm(moved[:, 0] - moved[:, 1], axis=-1)
    stated = length_between(POINTS[:2], joint_covariance(POINTS[:2], rig))
    assert np.sqrt(np.mean((lengths - stated.length_m) ** 2)) == pytest.approx(
        stated.sigma_m, rel=0.08
    )


def test_noise_of_matching_is_along_the_ray_and_independent() -> None:
    _, rig = rig_of('plumb_bob')
    alone = joint_covariance(POINTS, rig)
    noisy = joint_covariance(POINTS, rig, np.array([0.1, 0.2, 0.3, 0.4]))
    added = noisy - alone
    for i, sigma_px in enumerate((0.1, 0.2, 0.3, 0.4)):
        sigma_z = POINTS[i, 2] ** 2 / (rig.focal_px * rig.baseline_m) * sigma_px
        along = POINTS[i] / POINTS[i, 2] * sigma_z
        np.testing.assert_allclose(added[i, :, i], np.outer(along, along), rtol=1e-9)
    assert not added[0, :, 1:].any()


def test_a_length_between_the_same_point_is_refused() -> None:
    with pytest.raises(ImageError, match='pick two different points'):
        length_between(np.ones((2, 3)), np.zeros((2, 3, 2, 3)))
    with pytest.raises(ImageError, match='pick one that was measured'):
        length_between(np.full((2, 3), np.nan), np.zeros((2, 3, 2, 3)))


@pytest.mark.parametrize('lens', RIGS)
def test_cloud_interpolates_the_variances(lens: str) -> None:
    _, calibrated = rig_of(lens)
    rig = Rectifier(calibrated).rig
    rng = np.random.default_rng(6)
    height, width = rig.left.height, rig.left.width
    columns = np.arange(width, dtype=np.float32)
    right = rng.uniform(0.02, 0.98, (height, width)).astype(np.float32) * columns
    disparity = columns - right + np.float32(rig.disparity_offset_px)
    sigma = np.full_like(disparity, 0.1)
    validity = np.full(disparity.shape, Validity.MEASURED, np.uint8)
    cloud = triangulate(disparity, sigma, validity, rig, CloudConfig(max_sigma='33%'))
    assert cloud.calibrated and set(cloud.sigmas_m) == {'sigma_x', 'sigma_y', 'sigma_z'}
    depth_m = cloud.depth_m
    # beyond 60 degrees from the axis of a fisheye the interpolated variances are too large
    away = np.linalg.norm(cloud.points_xyz[..., :2], axis=-1) + rig.baseline_m
    known = np.argwhere(np.isfinite(depth_m) & (depth_m < 60) & (away < 1.7 * depth_m))
    picked = rng.choice(known, 400, replace=False)
    points = cloud.points_xyz[picked[:, 0], picked[:, 1]].astype(np.float64)
    index = np.arange(len(points))
    exact = joint_covariance(points, rig, 0.1)[index, :, index, :]
    sigmas = np.sqrt(np.diagonal(exact, axis1=1, axis2=2))
    stated = cloud.sigma_m[picked[:, 0], picked[:, 1]]
    assert np.median(np.abs(stated / sigmas - 1)) < 0.01
    # across the ray a variance may be nearly 0 somewhere between two nodes
    off = np.abs(stated - sigmas) / np.linalg.norm(sigmas, axis=-1, keepdims=True)
    assert np.quantile(off, 0.99) < 0.03


def test_coefficients_that_are_not_calibrated_may_be_left_out() -> None:
    """As in a covariance of another program, of five coefficients."""
    _, rig = rig_of('plumb_bob')
    assert rig.covariance is not None
    names = parameter_names(('k1', 'k2', 'p1', 'p2', 'k3'))
    kept = [rig.covariance.parameters.index(name) for name in names]
    known = RigCovariance(rig.left, rig.right, names, rig.covariance.matrix[np.ix_(kept, kept)])
    fewer = StereoRig(rig.left, rig.right, covariance=known)
    np.testing.assert_allclose(joint_covariance(POINTS, fewer), joint_covariance(POINTS, rig))


def test_points_less_certain_than_a_third_of_their_depth_are_left_out() -> None:
    calibration, calibrated = rig_of('plumb_bob')
    assert calibrated.covariance is not None
    known = calibrated.covariance
    poor = RigCovariance(known.left, known.right, known.parameters, 1e4 * known.matrix)
    rig = StereoRig(calibrated.left, calibrated.right, covariance=poor)
    size = calibration.image_size[::-1]
    disparity = np.full(size, 100.0, np.float32)
    cloud = triangulate(
        disparity,
        np.full(size, 0.01, np.float32),
        np.full(size, Validity.MEASURED, np.uint8),
        Rectifier(rig).rig,
        CloudConfig(max_sigma='100%'),
    )
    assert np.isnan(cloud.points_xyz).all()


def test_without_a_covariance_sigma_is_that_of_matching() -> None:
    _, calibrated = rig_of('plumb_bob')
    rig = StereoRig(calibrated.left, calibrated.right)
    with pytest.raises(CalibrationError, match=r'use the folder of a calibration'):
        joint_covariance(POINTS, rig)
    again = add_covariance(rig, calibrated.covariance)
    assert again.covariance is calibrated.covariance
    assert add_covariance(rig, None) is rig


def test_the_covariance_of_another_rig_is_refused() -> None:
    _, calibrated = rig_of('plumb_bob')
    _, other = rig_of('equidistant')
    small = nominal(survey_rig(0.5))
    for rig in (other, metric_rig(small)):
        if rig.baseline_m == calibrated.baseline_m and rig.left.size == calibrated.left.size:
            continue
        with pytest.raises(CalibrationError, match='that of another rig'):
            add_covariance(rig, calibrated.covariance)


@pytest.mark.parametrize('turns', [1, -1])
def test_a_standing_rig_has_the_covariance_of_the_lying_one(turns: int) -> None:
    """The same cameras with images read out turned: only names of parameters change."""
    calibration, lying = rig_of('equidistant')
    turn = quarter_turn(-turns)

    def standing(K: FloatArray) -> FloatArray:
        return turned_pixels(-turns, calibration.image_size) @ K @ turn.T

    twin = replace(
        calibration,
        image_size=calibration.image_size[::-1],
        K_left=standing(calibration.K_left),
        K_right=standing(calibration.K_right),
        R=turn @ calibration.R @ turn.T,
        T=turn @ calibration.T,
    )
    bare = metric_rig(twin)
    assert bare.turns == turns and lying.covariance is not None
    # fx, fy, cx and cy change places, k1 to k4 do not; turn and T are vectors
    intrinsics = np.zeros((8, 8))
    intrinsics[:4, :4] = np.eye(4)[[1, 0, 3, 2]] * [[1], [1], [-turns], [turns]]
    intrinsics[4:, 4:] = np.eye(4)
    change = block_diag(intrinsics, intrinsics, turn, turn)
    known = RigCovariance(
        bare.left, bare.right, lying.covariance.parameters,
        change @ lying.covariance.matrix @ change.T,
    )  # fmt: skip
    standing_rig = Rectifier(StereoRig(bare.left, bare.right, covariance=known)).rig
    lying_rig = Rectifier(lying).rig
    np.testing.assert_allclose(
        joint_covariance(POINTS @ turn.T, standing_rig, 0.1),
        np.einsum('ij,njmk,lk->niml', turn, joint_covariance(POINTS, lying_rig, 0.1), turn),
        rtol=1e-4, atol=1e-12,
    )  # fmt: skip
    rng = np.random.default_rng(1)
    disparity = rng.uniform(60, 200, (lying_rig.left.height, lying_rig.left.width))
    disparity_px, sigma_px = disparity.astype(np.float32), np.full_like(disparity, 0.1, np.float32)
    validity = np.full(disparity.shape, Validity.MEASURED, np.uint8)
    expected = triangulate(disparity_px, sigma_px, validity, lying_rig, CloudConfig())
    found = triangulate(
        np.rot90(disparity_px, -turns), np.rot90(sigma_px, -turns), np.rot90(validity, -turns),
        standing_rig, CloudConfig(),
    )  # fmt: skip
    points, sigma = (np.rot90(one, turns) for one in (found.points_xyz, found.sigma_m))
    np.testing.assert_allclose(points @ turn.astype(np.float32), expected.points_xyz, atol=1e-3)
    np.testing.assert_allclose(sigma[..., [1, 0, 2]], expected.sigma_m, rtol=1e-3)


def test_a_matrix_that_is_no_covariance_is_refused() -> None:
    _, rig = rig_of('plumb_bob')
    known = rig.covariance
    assert known is not None
    count = len(known.parameters)
    skew = known.matrix.copy()
    skew[0, 1] += 1.0
    for matrix, reason in (
        (np.eye(count - 1), f'{count} rows'),
        (np.full((count, count), np.nan), 'finite'),
        (-np.eye(count), 'eigenvalues'),
        (skew, 'symmetric'),
    ):
        with pytest.raises(CalibrationError, match=reason):
            RigCovariance(known.left, known.right, known.parameters, matrix)
    for coefficients in ((), ('k1', 'k2', 'k3'), tuple(f'k{i}' for i in range(12))):
        names = parameter_names(coefficients)
        with pytest.raises(CalibrationError, match=f'is that of {len(coefficients)} distortion'):
            RigCovariance(known.left, known.right, names, np.eye(len(names)))
    with pytest.raises(CalibrationError, match='the parameters of the covariance are'):
        RigCovariance(known.left, known.right, known.parameters[::-1], known.matrix)
