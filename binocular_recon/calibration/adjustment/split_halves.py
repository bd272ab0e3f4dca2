# SPDX-License-Identifier: Apache-2.0
"""Whether halves of the boards agree on depth as well as the stated covariance says.

The covariance of an adjustment knows the noise of single marks and the places of rods. What is
common to the marks of a board (a focus that moved, a board that bends with its pose, distortion
that the lens model lacks) it does not know, and so it is too small. Halves of the boards then
disagree by more than it allows, which needs no truth to be seen. Errors that all boards share
are in both halves and stay unseen.

Source: cross-validation as in mrcal (Kogan, https://mrcal.secretsauce.net), here judged by the
covariance of the difference.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import special

from binocular_recon.calibration.adjustment._normal_equations import NormalEquations, inverse
from binocular_recon.calibration.adjustment.bundle_adjustment import normal_equations
from binocular_recon.calibration.adjustment.estimation import MIN_BOARDS, Estimate
from binocular_recon.calibration.adjustment.linearisation import marks_in_left
from binocular_recon.calibration.adjustment.uncertainty import depth_derivatives, field_of_view
from binocular_recon.camera import FloatArray
from binocular_recon.images import Mask
from binocular_recon.number_text import counted, significant

# Each half must have the boards of a calibration.
LEAST_BOARDS = 2 * MIN_BOARDS
# Ways to split the boards by lot, and the ratio that at most one in 100 calibrations exceeds
# where everything is as modelled (simulated: rods and points, 6 to 20 boards); the second limit is
# that of fewer than 11 boards, whose halves are less linear and have fewer directions.
LOTS, LOT_LIMIT, FEW_LIMIT, FEW_BOARDS = 4, 1.5, 1.75, 11
# For the only split in order of capture: chance by the distribution of chi^2. Its halves may be
# far from balanced, and what is then not linear makes it up to one in 200 (simulated too).
_ORDER_CHANCE = 0.001
# Depths at which halves are compared: from the nearest to the farthest boards.
_DEPTH_QUANTILES = (0.05, 0.5, 0.95)
# Ways in which depth may differ count if their variance is at least this share of the largest.
# By lot: all but those that rounding decides on, since anything may differ from board to board.
# In order: those that depth depends on most, which a change of the cameras shows in.
_LOT_SHARE, _ORDER_SHARE = 1e-3, 0.1


@dataclass(frozen=True)
class DepthDifference:
    """How far halves are apart at one depth.

    Attributes
    ----------
    depth_m : float
        Distance along the left camera's axis, m.
    found_m, stated_m : float
        Difference between halves, and one standard deviation of it by their covariances, m: root
        mean square over the middle half of the image and all splits.

    """

    depth_m: float
    found_m: float
    stated_m: float


@dataclass(frozen=True)
class Comparison:
    """Halves against each other, split in one or several ways.

    Attributes
    ----------
    splits : int
        Ways in which the boards were split.
    ratio : float
        Difference of the halves over its stated standard deviation, root mean square over the
        ways in which depth may differ: with covariance S of the difference d of depths over the
        field of view, chi^2 = d^T S^-1 d over the principal directions of S that count; ratio^2
        is the sum of chi^2 over the number of directions.
    limit : float
        The ratio that at most one in 100 calibrations exceeds where everything is as modelled.
    differences : tuple of DepthDifference
        At the nearest, middle and farthest boards.

    """

    splits: int
    ratio: float
    limit: float
    differences: tuple[DepthDifference, ...]

    @property
    def exceeded(self) -> bool:
        """Whether the halves contradict each other."""
        return self.ratio > self.limit

    @property
    def factor(self) -> float:
        """Factor on stated sigmas that covers the differences, together and at each depth.

        1 if the halves agree.
        """
        if not self.exceeded:
            return 1.0
        return max(self.ratio, *(one.found_m / one.stated_m for one in self.differences))

    def to_mapping(self) -> dict[str, Any]:
        """Return the entry of ``calibration.json``."""
        depths = {
            significant(one.depth_m): {'difference': one.found_m, 'sigma': one.stated_m}
            for one in self.differences
        }
        numbers = {'ratio': self.ratio, 'limit': self.limit, 'splits': self.splits}
        return {**numbers, 'depth_m': depths}


@dataclass(frozen=True)
class SplitHalves:
    """What the comparison of halves of the boards says.

    Attributes
    ----------
    boards : (int, int)
        Boards of the two halves.
    by_lot : Comparison or None
        Boards dealt to the halves by lot, in several ways; None = not compared.
    in_order : Comparison or None
        The first half of the boards against the second one, in order of capture.
    reason : str
        Why the halves were not compared; empty if they were.

    """

    boards: tuple[int, int]
    by_lot: Comparison | None = None
    in_order: Comparison | None = None
    reason: str = ''

    @property
    def comparisons(self) -> tuple[Comparison, ...]:
        """Both, if they were made."""
        return tuple(one for one in (self.by_lot, self.in_order) if one)

    @property
    def factor(self) -> float:
        """Factor on all standard deviations of the calibration; 1 if the halves agree."""
        return max((one.factor for one in self.comparisons), default=1.0)

    def __str__(self) -> str:
        """Say how the halves compare."""
        if not self.by_lot or not self.in_order:
            return self.reason
        return (
            f'halves of the boards differ in depth by {self.by_lot.ratio:.2f} times what the noise'
            f' of the marks explains (by lot, limit {self.by_lot.limit:.2f}) and by'
            f' {self.in_order.ratio:.2f} times (in order of capture, limit'
            f' {self.in_order.limit:.2f})'
        )

    @property
    def warning(self) -> str:
        """What the user should know, empty if the halves agree."""
        if self.factor == 1 or not self.by_lot or not self.in_order:
            return self.reason
        # what differs from board to board sets these halves apart too, but no more than others
        common = self.by_lot.ratio if self.by_lot.exceeded else 1.0
        if self.in_order.ratio > common * self.in_order.limit:
            cause = (
                'something changed in the course of the capture: lock focus and aperture, fix the'
                ' cameras to their bar, and capture anew'
            )
        else:
            cause = (
                'something differed from board to board: lock focus and aperture, let nothing move'
                ' while images are taken, use boards that do not bend, measure them better, or'
                ' capture more'
            )
        return f'{self}; all sigmas were multiplied by {self.factor:.2f}; {cause}'

    def to_mapping(self) -> dict[str, Any]:
        """Return the entry ``split_half`` of ``calibration.json``."""
        worst = max(self.comparisons, key=lambda one: one.ratio / one.limit, default=None)
        return {
            'ratio': worst.ratio if worst else None,
            'limit': worst.limit if worst else None,
            'inflated': self.factor > 1,
            'factor': self.factor,
            'boards': list(self.boards),
            'by_lot': self.by_lot.to_mapping() if self.by_lot else None,
            'in_order': self.in_order.to_mapping() if self.in_order else None,
            'reason': self.reason or None,
        }


def compare_halves(found: Estimate) -> SplitHalves:
    """Adjust halves of the boards, split in several ways, and compare their depths.

    Each half is adjusted by one Gauss-Newton step from the adjustment of all boards, with its
    distortion terms, noise and weights and without the marks that it left out. So the difference
    is as linear as the covariance that it is compared with, however little a half determines.
    """
    count = len(found.boards)
    sizes = (count - count // 2, count // 2)
    if count < LEAST_BOARDS:
        return SplitHalves(
            sizes,
            reason=f'{counted(count, "board is", "boards are")} too few to compare halves, so'
            ' the sigmas rest on'
            f' the residuals alone; capture {LEAST_BOARDS} or more',
        )
    calibration, marks = found.state.calibration, marks_in_left(found.state, found.problem.target)
    depths = np.quantile(marks[..., 2], _DEPTH_QUANTILES)
    points = np.concatenate([field_of_view(calibration, float(depth)) for depth in depths])
    if not len(points):
        return SplitHalves(
            sizes,
            reason='halves of the boards were not compared, because the middle halves of the'
            ' images show nothing in common',
        )
    derivatives = depth_derivatives(calibration, found.problem.free, points)
    equations = normal_equations(found.problem, found.state)
    distances = marks[..., 2].mean(axis=(1, 2))
    lots = [_split(equations, derivatives, _by_lot(distances, seed)) for seed in range(LOTS)]
    order = [_split(equations, derivatives, np.arange(count) < sizes[0])]
    # in standard deviations of all boards together, so that near and far points count alike
    variance = np.einsum('ni,ij,nj->n', derivatives, found.covariance, derivatives)
    by_lot, _ = _ratio(lots, np.sqrt(variance), _LOT_SHARE)
    in_order, directions = _ratio(order, np.sqrt(variance), _ORDER_SHARE)
    lot_limit = LOT_LIMIT if count >= FEW_BOARDS else FEW_LIMIT
    order_limit = float(np.sqrt(special.chdtri(directions, _ORDER_CHANCE) / directions))
    return SplitHalves(
        sizes,
        Comparison(LOTS, by_lot, lot_limit, _differences(lots, points[:, 2])),
        Comparison(1, in_order, order_limit, _differences(order, points[:, 2])),
    )


@dataclass(frozen=True, eq=False)
class _Split:
    """By how much two halves differ in depth, (N,) m, and the covariance of that, (N, N) m^2."""

    difference_m: FloatArray
    covariance: FloatArray


def _by_lot(distances: FloatArray, seed: int) -> Mask:
    """Return which boards are in the first half, (B,) bool.

    Of each two neighbours in distance one goes into each half, so that both determine depth.
    """
    order = np.argsort(distances, kind='stable')
    first = np.zeros(len(order), np.bool_)
    lots = np.random.default_rng(seed).integers(2, size=len(order) // 2)
    first[order[2 * np.arange(len(lots)) + lots]] = True
    if len(order) % 2:
        first[order[-1]] = True
    return first


def _split(equations: NormalEquations, derivatives: FloatArray, first: Mask) -> _Split:
    steps, covariances = [], []
    for half in (equations.select(first), equations.select(~first)):
        steps.append(half.solve(0.0)[0])
        covariances.append(inverse(half.board_information().sum(axis=0) + half.prior))
    # what is known beforehand is known to both halves: it pulls them the same way
    common = covariances[0] @ equations.prior @ covariances[1]
    count = derivatives.shape[1]
    covariance = (covariances[0] + covariances[1] - common - common.T)[:count, :count]
    difference: FloatArray = derivatives @ (steps[0] - steps[1])[:count]
    return _Split(difference, derivatives @ covariance @ derivatives.T)


def _ratio(splits: list[_Split], sigma_m: FloatArray, least_share: float) -> tuple[float, int]:
    """Return the ratio of differences to covariances, and over how many directions in all."""
    chi2, directions = 0.0, 0
    for split in splits:
        values, vectors = np.linalg.eigh(split.covariance / np.outer(sigma_m, sigma_m))
        large = values > least_share * values[-1]
        along = vectors[:, large].T @ (split.difference_m / sigma_m)
        chi2 += float(np.sum(along**2 / values[large]))
        directions += int(large.sum())
    return float(np.sqrt(chi2 / directions)), directions


def _differences(splits: list[_Split], depths_m: FloatArray) -> tuple[DepthDifference, ...]:
    found = np.mean([split.difference_m**2 for split in splits], axis=0)
    stated = np.mean([np.diag(split.covariance) for split in splits], axis=0)
    return tuple(
        DepthDifference(
            float(depth),
            *(float(np.sqrt(np.mean(square[depths_m == depth]))) for square in (found, stated)),
        )
        for depth in np.unique(depths_m)
    )
