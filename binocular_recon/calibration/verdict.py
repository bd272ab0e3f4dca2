# SPDX-License-Identifier: Apache-2.0
"""Checks of a finished adjustment, and warnings for its user."""

from __future__ import annotations

import numpy as np

from binocular_recon.calibration.adjustment.estimation import Estimate
from binocular_recon.calibration.adjustment.linearisation import linearise, marks_in_left
from binocular_recon.calibration.adjustment.split_halves import SplitHalves
from binocular_recon.calibration.adjustment.tone_curve import NO_SHIFT, ToneCurve
from binocular_recon.calibration.adjustment.uncertainty import depth_sigma_m, field_of_view
from binocular_recon.calibration.rectification.homography import ImageGrid
from binocular_recon.calibration.screening import MIN_BOARDS, RECOMMENDED_BOARDS
from binocular_recon.calibration.target.target import DEVIATIONS
from binocular_recon.errors import CalibrationError
from binocular_recon.number_text import counted, significant

# Marks of a good detector scatter by 0.1 to 0.3 px.
NOISE_WARNING_PX, NOISE_LIMIT_PX = 0.6, 3.0
# A mark that is left out in this share of the boards is not where it is said to be.
# Where this share of all marks is left out, no single mark is to blame.
CONTRADICTION_SHARE, OUTLIER_SHARE = 0.5, 0.3
# Displacements of a rod, as shares of the rods' spacing, that no crew produces: its typical
# one, and the one it has in all boards alike.
DISPLACEMENT_SHARE, COMMON_SHARE = 0.05, 0.03
# Heights of marks that are off by this much, in all boards alike, are pointed out.
MARK_OFFSET_M, MARK_OFFSET_SIGMAS = 5e-4, 5.0
# Rods and marks found on fewer boards than this share of the usual number are pointed out.
RARE_SHARE = 0.4
# A board that is certainly bent, by more than this share of its longer side, is pointed out.
WARP_SIGMAS, WARP_SHARE = 3.0, 1e-3
# Depth at the boards whose sigma exceeds these shares of it is poorly, or not, calibrated.
DEPTH_WARNING, DEPTH_LIMIT = 0.02, 0.1


def check_result(found: Estimate) -> None:
    """Raise a CalibrationError if the marks contradict the description or leave depth open."""
    _check_noise(found)
    _check_placement(found)
    _check_marks(found)
    _check_depth(found)


def warnings_of(
    found: Estimate, halves: SplitHalves, tone: ToneCurve = NO_SHIFT
) -> tuple[str, ...]:
    """Return warnings for the user, one sentence each."""
    warnings = [warning for warning in (halves.warning, tone.warning) if warning]
    problem = found.problem
    if len(found.boards) < RECOMMENDED_BOARDS:
        warnings.append(
            f'{counted(len(found.boards), "board was", "boards were")} used; depth is better known'
            f' with {RECOMMENDED_BOARDS} or more'
        )
    worse = problem.placement_scale > 1
    if worse.any():
        spread = ', '.join(
            f'{scale:.1f} times in {name}'
            for name, scale in zip(DEVIATIONS, problem.placement_scale, strict=True)
            if scale > 1
        )
        warnings.append(
            f'the rods stand less exactly than stated ({spread}); the larger spread was used, but'
            ' check the positions in rods.yaml'
        )
    if not found.settled:
        warnings.append(
            'which marks to leave out was not settled; look for a board with many marks left out'
        )
    depth, sigma = _depth_sigma(found)
    if sigma > DEPTH_WARNING * depth:
        warnings.append(
            f'one standard deviation of depth at the boards ({significant(depth)} m) is'
            f' {significant(1e3 * sigma)} mm ({sigma / depth:.1%}; {DEPTH_WARNING:.0%} or less is'
            ' usual); capture more boards, turned by 20 to 50 degrees to either side and at more'
            ' distances'
        )
    if tone.cause != 'either':  # else every mark would seem to be at a wrong height
        warnings += _misplaced_marks(found)
    warnings += _rarely_found(found) + _bent_board(found)
    for side in ('left', 'right'):
        unusable = 1 - ImageGrid.of(found.state.calibration, side).usable_share
        if unusable > 0:
            warnings.append(
                f'lens distortion of the {side} camera is not known in {unusable:.0%} of its'
                ' image, where no marks were seen; capture boards near its corners'
            )
    noise = float(problem.sigma_px.max())
    if noise > NOISE_WARNING_PX:
        exact = problem.target.has_rods and not problem.free_deviations.any()
        cause = (
            'rods.yaml states exactly placed rods: state a placement_sigma'
            if exact
            else 'images may be blurred, or marks not where they are said to be'
        )
        warnings.append(f'marks scatter by {noise:.2f} px, 0.1 to 0.3 px is usual; {cause}')
    return tuple(warnings)


def _check_marks(found: Estimate) -> None:
    left_out = np.any(found.outliers, axis=-1)
    given = left_out | np.any(found.problem.seen, axis=-1)
    shares = left_out.sum(axis=0) / np.maximum(given.sum(axis=0), 1)
    few = left_out.sum() < OUTLIER_SHARE * given.sum()
    if few and len(found.boards) > MIN_BOARDS and shares.max() >= CONTRADICTION_SHARE:
        rod, mark = np.unravel_index(int(np.argmax(shares)), shares.shape)
        what = (
            f'mark {mark + 1} of rod {rod + 1}'
            if found.problem.target.has_rods
            else f'point {rod}'
        )
        raise CalibrationError(
            f'{what} is not where it is said to be: it misses the others in'
            f' {left_out[:, rod, mark].sum()} of {given[:, rod, mark].sum()} boards; measure it'
            ' and correct its description'
        )


def _check_noise(found: Estimate) -> None:
    noise = float(found.problem.sigma_px.max())
    if noise > NOISE_LIMIT_PX:
        raise CalibrationError(
            f'the marks of {len(found.boards)} boards miss the best calibration by {noise:.1f} px'
            f' (limit {NOISE_LIMIT_PX:g} px): check the heights of the marks, the positions of the'
            ' rods and that both images of a board were taken at the same time'
        )


def _check_placement(found: Estimate) -> None:
    target = found.problem.target
    if not target.has_rods or len(target.anchors_m) < 2:
        return
    spacing = float(np.linalg.norm(np.diff(target.anchors_m, axis=0), axis=1).min())
    for axis, name in ((0, 'x'), (2, 'z')):
        offsets = found.state.deviations[..., axis]
        typical, common = np.median(np.abs(offsets), axis=0), np.median(offsets, axis=0)
        excess = np.maximum(typical / DISPLACEMENT_SHARE, np.abs(common) / COMMON_SHARE)
        rod = int(np.argmax(excess))
        if excess[rod] > spacing and typical[rod] > 3 * target.sigmas[axis]:
            raise CalibrationError(
                f'rods.yaml contradicts the images: rod {rod + 1} stands'
                f' {1e3 * typical[rod]:.0f} mm off its {name} in most boards (median'
                f' {1e3 * common[rod]:+.0f} mm, stated sigma'
                f' {significant(1e3 * target.sigmas[axis])} mm); measure the rods and correct'
                ' their positions'
            )


def _misplaced_marks(found: Estimate) -> list[str]:
    """Name marks that sit elsewhere along the rods than stated, in every board alike."""
    problem = found.problem
    if not problem.target.has_rods:
        return []
    predicted, jacobians = linearise(found.state, problem.target)
    residuals = problem.residuals(predicted)
    # the marks' shift per metre along the rod, in standard deviations
    slopes = jacobians.rod[..., 1].reshape(residuals.shape) / problem.sigma_px
    slopes = slopes * problem.seen[..., None]
    information = np.maximum((slopes**2).sum(axis=(0, 1, 3, 4)), 1e-12)
    offsets = (slopes * residuals).sum(axis=(0, 1, 3, 4)) / information
    return [
        f'mark {mark + 1} sits about {1e3 * offset:+.1f} mm from its height'
        f' {problem.target.heights_m[mark]:g} m on all rods; measure it and correct rods.yaml'
        for mark, offset in enumerate(offsets)
        if abs(offset) > max(MARK_OFFSET_M, MARK_OFFSET_SIGMAS / np.sqrt(information[mark]))
    ]


def _bent_board(found: Estimate) -> list[str]:
    """Say by how much the board is bent, if that is certain and large."""
    target, warp = found.problem.target, found.state.warp_m
    if not target.bends:
        return []
    bend, side = float(np.abs(warp).sum()), float(np.ptp(target.anchors_m, axis=0).max())
    if bend < WARP_SHARE * side or np.all(np.abs(warp) < WARP_SIGMAS * found.warp_sigma_m):
        return []
    parts = ' and '.join(
        f'{1e3 * value:+.2f} +- {1e3 * sigma:.2f} mm along {axis}'
        for value, sigma, axis in zip(warp, found.warp_sigma_m, 'xy', strict=True)
    )
    words = (
        f'the board is bent by {1e3 * bend:.1f} mm ({parts}); this was allowed for, but it may'
        ' bend otherwise on another day: fix it to a stiff plate'
    )
    return [words]


def _rarely_found(found: Estimate) -> list[str]:
    """Name rods and marks that were hardly ever found: they may not be where they are said to be.

    Detection leaves out what does not lie as described.
    """
    if not found.problem.target.has_rods:
        return []
    seen = np.isfinite(found.problem.observed_px).all(axis=-1) | found.outliers.any(axis=-1)
    # boards on which each rod and each mark was found
    rods, marks = (np.any(seen, axis=axis).sum(axis=0) for axis in (2, 1))
    return [
        f'{what} {index + 1} was found on {count} of {len(found.boards)} boards; check its {place}'
        ' in rods.yaml'
        for what, place, counts in (('rod', 'position', rods), ('mark', 'height', marks))
        for index, count in enumerate(counts)
        if count < RARE_SHARE * np.median(counts)
    ]


def _check_depth(found: Estimate) -> None:
    depth, sigma = _depth_sigma(found)
    if not sigma <= DEPTH_LIMIT * depth:
        raise CalibrationError(
            f'the boards do not determine depth: one standard deviation at {significant(depth)} m'
            f' is {significant(sigma, 2)} m (limit {DEPTH_LIMIT:.0%}); capture more boards,'
            ' turned by 20 to 50 degrees to either side and at more distances'
        )


def _depth_sigma(found: Estimate) -> tuple[float, float]:
    """Return the median depth of the marks and its sigma over the view, m; 0 without a view."""
    depth = float(np.median(marks_in_left(found.state, found.problem.target)[..., 2]))
    points = field_of_view(found.state.calibration, depth)
    if not len(points):
        return depth, 0.0
    calibration, free = found.state.calibration, found.problem.free
    sigma = depth_sigma_m(calibration, free, found.covariance, points)
    return depth, float(np.sqrt(np.mean(sigma**2)))
