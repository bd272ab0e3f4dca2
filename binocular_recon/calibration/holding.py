# SPDX-License-Identifier: Apache-2.0
"""Whether a calibration still holds: its rows and its scale on marks captured later."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from scipy import special

from binocular_recon.calibration.screening import Rejected
from binocular_recon.calibration.target.capture import Capture
from binocular_recon.calibration.target.rods import RodBoard
from binocular_recon.calibration.target.target import Target, seen_scale
from binocular_recon.camera import FloatArray, StereoRig
from binocular_recon.errors import CalibrationError
from binocular_recon.inputs.common_size import CommonSize
from binocular_recon.number_text import counted, significant
from binocular_recon.stereo.point_covariance import calibration_derivatives
from binocular_recon.stereo.rectification import rectified_points
from binocular_recon.stereo.row_check import MOST_ROWS_PX

# A scale that is off by more standard deviations than this contradicts the calibration ...
MOST_SIGMAS = 3.0
# ... unless it is off by less than this: tapes and the edges of bands are no better.
LEAST_SCALE = 0.002
# Boards agree within these; of this many, most tell which are odd.
AGREEING_PX, AGREEING_SCALE, LEAST_AGREEING = 3.0, 0.05, 3


@dataclass(frozen=True)
class Holding:
    """How well a calibration explains the marks of new boards.

    Attributes
    ----------
    boards, marks : int
        Boards compared, and marks seen by both cameras on them.
    rows_px : float
        Mean absolute difference of the rectified rows of left and right marks, px.
    systematic_rows_px : float
        What is not noise of it: mean absolute value of a plane fitted to the differences over
        the image, px.
    scale : float
        Lengths measured with the calibration over those of the target, 1 = right.
    scale_sigma : float
        One standard deviation of it, shares of the marks and of the calibration together.
    calibration_sigma : float
        The share of the calibration; NaN if its covariance is not known.
    depth_m : float
        Median depth of the marks, m.
    left_out : tuple of Rejected
        Boards that contradict most of the others.
    lines : str
        What corresponds in the images: 'rows', or 'columns' if one camera stands above the other.

    """

    boards: int
    marks: int
    rows_px: float
    systematic_rows_px: float
    scale: float
    scale_sigma: float
    calibration_sigma: float
    depth_m: float
    left_out: tuple[Rejected, ...] = ()
    lines: str = 'rows'

    @property
    def faults(self) -> tuple[str, ...]:
        """What contradicts the calibration, a sentence each; empty if it holds."""
        faults = []
        if self.systematic_rows_px > MOST_ROWS_PX:
            faults.append(
                f'{self.lines} differ by {self.systematic_rows_px:.2f} px without the noise of the'
                f' marks (at most {MOST_ROWS_PX:g} px): a camera has moved'
            )
        off = abs(self.scale - 1)
        if off > LEAST_SCALE and off > MOST_SIGMAS * self.scale_sigma:
            faults.append(
                f'lengths are {self._scale_text} off, {off / self.scale_sigma:.1f} standard'
                f' deviations (at most {MOST_SIGMAS:g}): depth at {significant(self.depth_m)} m is'
                ' off by about as much'
            )
        return tuple(faults)

    def __str__(self) -> str:
        """Say by how much rows differ and lengths are off."""
        text = f'{self.lines} differ by {self.rows_px:.2f} px'
        if not np.isfinite(self.scale_sigma):
            return f'{text} ({counted(self.marks, "mark")}; too few to compare lengths)'
        known = np.isfinite(self.calibration_sigma)
        share = (
            f'of it {significant(100 * self.calibration_sigma, 2)} % stated by the calibration'
            if known
            else 'the sigma of the calibration is not known'
        )
        return (
            f'{text} ({self.systematic_rows_px:.2f} px without noise) and lengths at'
            f' {significant(self.depth_m)} m are {self._scale_text} off, sigma'
            f' {significant(100 * self.scale_sigma, 2)} % ({share})'
        )

    @property
    def _scale_text(self) -> str:
        return f'{100 * (self.scale - 1):+.2f} %'


def check_holding(
    rig: StereoRig,
    captures: Sequence[Capture],
    target: RodBoard | Target,
    size: tuple[int, int],
    right_size: tuple[int, int] | None = None,
) -> Holding:
    """Compare a calibration with marks that were captured later.

    Lengths are measured along each rod, where marks are exact, or over each board of points.

    Parameters
    ----------
    rig : StereoRig
        The calibration, with its covariance where that is known.
    captures : sequence of Capture
        Marks of each board; NaN = not found.
    target : RodBoard or Target
        Rods as in ``rods.yaml``, or the points of a board.
    size : (int, int)
        Width and height of the images, px.
    right_size : (int, int), optional
        That of the right images, where they differ from the left ones.

    Raises
    ------
    CalibrationError
        If the images differ in size from those of the calibration, or no mark was found in both
        images.

    """
    if isinstance(target, RodBoard):
        target = Target.from_rods(target)
    sizes = CommonSize(size, right_size or size)
    calibrated = CommonSize(rig.left.size, rig.right.size)
    if sizes != calibrated:
        raise CalibrationError(
            f'the images are {sizes}, the calibration is for {calibrated}; capture with the'
            ' settings of the calibration'
        )
    boards = [_measured(rig, capture, target) for capture in captures]
    seen = [board for board in boards if len(board.rows_px)]
    if not seen:
        raise CalibrationError(
            f'none of {len(captures)} boards has a mark in both images; capture boards that both'
            ' cameras see'
        )
    kept, odd = _agreeing(seen)
    scales = np.concatenate([board.scales for board in kept])
    known, calibration_sigma = rig.covariance, np.nan
    if known is not None and len(scales):
        gradient = np.concatenate([board.gradients for board in kept]).mean(axis=0)
        calibration_sigma = float(np.sqrt(gradient @ known.matrix @ gradient))
    rows = np.concatenate([board.rows_px for board in kept])
    return Holding(
        boards=len(kept),
        marks=len(rows),
        rows_px=float(np.mean(np.abs(rows))),
        systematic_rows_px=_systematic(np.concatenate([board.places_px for board in kept]), rows),
        scale=float(np.mean(scales)) if len(scales) else np.nan,
        scale_sigma=float(np.hypot(_standard_error(scales), np.nan_to_num(calibration_sigma))),
        calibration_sigma=calibration_sigma,
        depth_m=float(np.median(np.concatenate([board.depths_m for board in kept]))),
        left_out=odd,
        lines='columns' if rig.turns else 'rows',
    )


class _Board(NamedTuple):
    """What a calibration measures on a board of N marks in both images and G rods.

    Places in the left rectified image (N, 2) px, differences of rows (N,) px and depths (N,) m of
    the marks; scales (G,) of the rods and their derivatives by the parameters (G, p).
    """

    name: str
    places_px: FloatArray
    rows_px: FloatArray
    depths_m: FloatArray
    scales: FloatArray
    gradients: FloatArray

    @property
    def figures(self) -> FloatArray:
        """Median difference of rows and scale in the units in which boards must agree, (2,)."""
        scale = np.median(self.scales) if len(self.scales) else 1.0
        return np.array([np.median(self.rows_px) / AGREEING_PX, scale / AGREEING_SCALE])


def _measured(rig: StereoRig, capture: Capture, target: Target) -> _Board:
    left, right = (
        rectified_points(camera, pixels.reshape(-1, 2))
        for camera, pixels in ((rig.left, capture.left_px), (rig.right, capture.right_px))
    )
    seen = np.isfinite(left).all(axis=1) & np.isfinite(right).all(axis=1)
    points = np.full((len(left), 3), np.nan)
    if seen.any():
        found = cv2.triangulatePoints(rig.left.P, rig.right.P, left[seen].T, right[seen].T)
        points[seen] = (found[:3] / found[3]).T
    across = 1 - abs(rig.turns)
    return _Board(
        capture.name,
        left[seen],
        left[seen, across] - right[seen, across],
        points[seen, 2],
        *_scales(rig, points.reshape(*target.shape, 3), target),
    )


def _agreeing(boards: Sequence[_Board]) -> tuple[list[_Board], tuple[Rejected, ...]]:
    """Leave out boards that say something else than most: a rig changes for all of them alike."""
    figures = np.array([board.figures for board in boards])
    off = np.abs(figures - np.median(figures, axis=0))
    odd = off.max(axis=1) > 1
    if len(boards) < LEAST_AGREEING or odd.sum() > len(boards) / 2:
        return list(boards), ()
    reason = (
        'its rows or lengths differ from those of most boards: its images are exchanged, or the'
        ' rods moved in between'
    )
    kept = [board for board, out in zip(boards, odd, strict=True) if not out]
    return kept, tuple(Rejected(b.name, reason) for b, out in zip(boards, odd, strict=True) if out)


def _scales(rig: StereoRig, points: FloatArray, target: Target) -> tuple[FloatArray, FloatArray]:
    """Return the scale of each rod, or of the board: (G,), and derivatives by parameters (G, p).

    The marks (R, M, 3) are in the left rectified frame, m; NaN = not seen by both.

    Source: Umeyama, "Least-squares estimation of transformation parameters" (1991).
    """
    known = target.nominal_m
    if not target.has_rods:  # one group of points
        known, points = known.reshape(1, -1, 3), points.reshape(1, -1, 3)
    scales, gradients = [], []
    for group, nominal in zip(points, known, strict=True):
        seen = np.isfinite(group[:, 0])
        if seen.sum() < (2 if target.has_rods else 4):
            continue
        places = nominal[seen] - nominal[seen].mean(axis=0)
        spread = float(np.sum(places**2))
        u, strength, vt = np.linalg.svd(group[seen].T @ places)
        scale = float(strength.sum() / spread)
        if target.has_rods:
            ends = group[seen][[0, -1]]
            scale /= seen_scale(ends, target.radius_m, rig.right_centre_m)
        scales.append(scale)
        if rig.covariance is not None:
            turned = places @ ((u * (strength > 1e-9 * strength[0])) @ vt).T
            moved = calibration_derivatives(group[seen], rig)
            gradients.append(np.einsum('ni,nip->p', turned, moved) / spread)
    count = 0 if rig.covariance is None else len(rig.covariance.parameters)
    return np.array(scales), np.array(gradients).reshape(len(gradients), count)


def _standard_error(values: FloatArray) -> float:
    """Return the standard error of a mean, widened so that 3 of it are as rare as of a normal."""
    if len(values) < 2:
        return float('nan')
    normal = special.ndtr(-MOST_SIGMAS)
    wider = -special.stdtrit(len(values) - 1, normal) / MOST_SIGMAS
    return float(wider * np.std(values, ddof=1) / np.sqrt(len(values)))


def _systematic(places_px: FloatArray, rows_px: FloatArray) -> float:
    """Return the mean absolute value of a plane fitted to differences of rows, px."""
    columns = np.column_stack([np.ones(len(rows_px)), places_px - places_px.mean(axis=0)])
    plane = columns @ np.linalg.lstsq(columns, rows_px, rcond=None)[0]
    return float(np.mean(np.abs(plane)))
