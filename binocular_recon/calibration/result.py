# SPDX-License-Identifier: Apache-2.0
"""The result of a calibration: the rig, its errors, and the three methods side by side."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from binocular_recon.calibration.adjustment.distortion import Evidence
from binocular_recon.calibration.adjustment.estimation import Estimate
from binocular_recon.calibration.adjustment.linearisation import marks_in_left, predict
from binocular_recon.calibration.adjustment.split_halves import SplitHalves
from binocular_recon.calibration.adjustment.uncertainty import (
    baseline_sigma_m,
    depth_sigma_m,
    field_of_view,
    matching_sigma_m,
)
from binocular_recon.calibration.advice import Advice
from binocular_recon.calibration.model import StereoCalibration
from binocular_recon.calibration.screening import Rejected
from binocular_recon.calibration.target.target import DEVIATIONS
from binocular_recon.camera import INTRINSICS, FloatArray, StereoRig
from binocular_recon.inputs.common_size import CommonSize
from binocular_recon.machine import now_text

# Distances that calibration.json states the depth sigma for, m.
DEPTHS_M = (10.0, 15.0, 20.0)
# Noise of the disparity that goes into it, px: what matching reaches on good texture.
DISPARITY_SIGMA_PX = 0.1
# Parameters in pixels of the right image.
_RIGHT_PX = tuple(f'{name}_right' for name in INTRINSICS)
# Units of parameters; distortion coefficients have none.
_UNITS = {'fx': 'px', 'fy': 'px', 'cx': 'px', 'cy': 'px', 'turn': 'rad', 'T': 'm'}


@dataclass(frozen=True, eq=False)
class Stage:
    """The result of one of the three methods on the same marks.

    Attributes
    ----------
    calibration : StereoCalibration
        Both cameras; those of the corrected images in the stage ``corrected``.
    residuals_px : (B, R, M, 4) float64
        Observed - predicted in the original images (left u, v, right u, v); NaN = not used.
    marks_m : (B, R, M, 3) float64
        Marks reconstructed from both images in this calibration's left camera; NaN = not seen
        by both.
    row_difference_px : (B, R, M) float64
        Row in the left minus row in the right image, of the original images (planar) or the
        rectified ones (corrected, adjusted); NaN = not seen by both. Columns if one camera stands
        above the other.

    """

    calibration: StereoCalibration
    residuals_px: FloatArray
    marks_m: FloatArray
    row_difference_px: FloatArray

    @property
    def board_error_px(self) -> FloatArray:
        """Reprojection error of each board, (B,) px: root mean square per image axis.

        Measured like the noise of a mark, so a perfect calibration shows just that noise.
        """
        squares = self.residuals_px.reshape(len(self.residuals_px), -1) ** 2
        error: FloatArray = np.sqrt(np.nanmean(squares, axis=1))
        return error

    @property
    def error_px(self) -> float:
        """Reprojection error of all boards, px, root mean square per image axis."""
        return float(np.sqrt(np.nanmean(self.residuals_px**2)))


@dataclass(frozen=True, eq=False)
class CalibrationResult:
    """A finished calibration.

    Attributes
    ----------
    names : tuple of str
        Boards that were used, in the order of all arrays.
    sizes : CommonSize
        Sizes of the images. All else but ``rig`` is in pixels of the left one's size.
    rig : StereoRig
        The adjusted calibration with the R and P that rectify it, each camera in its own pixels.
    planar, corrected, adjusted : Stage
        Zhang's method; the same after epipolar correction; the joint adjustment.
    estimate : Estimate
        Adjusted parameters, their covariance, the noise found.
    halves : SplitHalves
        Whether halves of the boards agree as well as that covariance says.
    evidence : tuple of Evidence
        Distortion models compared.
    model : str
        The one that was taken, a key of `Lens.models`.
    rejected : tuple of Rejected
        Boards left out and why.
    warnings : tuple of str
        What the user should know before relying on the result.
    advice : tuple of Advice
        Boards to capture next, best first.
    date : str
        When it was made (ISO 8601).

    """

    names: tuple[str, ...]
    sizes: CommonSize
    rig: StereoRig
    planar: Stage
    corrected: Stage
    adjusted: Stage
    estimate: Estimate
    halves: SplitHalves
    evidence: tuple[Evidence, ...]
    model: str
    rejected: tuple[Rejected, ...]
    warnings: tuple[str, ...]
    advice: tuple[Advice, ...]
    date: str = field(default_factory=now_text)

    @property
    def line(self) -> str:
        """What corresponds in rectified images: a 'row', or a 'column' of cameras above others."""
        return 'column' if self.rig.turns else 'row'

    @property
    def calibration(self) -> StereoCalibration:
        """Both cameras, the right one on a grid of the left one's size."""
        return self.estimate.state.calibration

    @property
    def mark_sigma_px(self) -> FloatArray:
        """Noise of a mark's u and v: (2,) px, or (2, 2) for each camera where sizes differ."""
        return self.estimate.problem.sigma_px / self._pixels_px

    @property
    def _pixels_px(self) -> FloatArray:
        """Pixels of the common grid per pixel, of the shape of ``mark_sigma_px`` or (1,)."""
        pixels: FloatArray = self.estimate.problem.pixel_px[:, None]
        return pixels if self.sizes.differs else np.ones(1)

    @property
    def rms_px(self) -> float:
        """Root mean square distance of observed and predicted marks, px (as OpenCV reports)."""
        return float(np.sqrt(2) * self.adjusted.error_px)

    @cached_property
    def marks_m(self) -> FloatArray:
        """Adjusted marks on the rods' axes in the left camera, (B, R, M, 3) m."""
        return marks_in_left(self.estimate.state, self.estimate.problem.target)

    @cached_property
    def predicted_px(self) -> FloatArray:
        """Marks as the adjusted calibration says they are seen, (B, R, M, 4) px."""
        return predict(self.estimate.state, self.estimate.problem.target)

    @cached_property
    def sigma(self) -> dict[str, float]:
        """One standard deviation of the baseline (m) and of each free parameter."""
        free = self.estimate.problem.free
        covariance = scaled_covariance(self.estimate, self.calibration.parameters, self.sizes)
        sigmas = np.sqrt(np.diag(covariance))[free]
        names = np.array(self.calibration.parameters)[free].tolist()
        found = {'baseline_m': baseline_sigma_m(self.calibration, free, self.estimate.covariance)}
        for name, sigma in zip(names, sigmas, strict=True):
            unit = _UNITS.get(name.partition('_')[0])
            found[f'{name}_{unit}' if unit else name] = float(sigma)
        return found

    def depth_sigma_m(
        self, depth_m: float, disparity_sigma_px: float = DISPARITY_SIGMA_PX
    ) -> float:
        """Return one standard deviation of a matched point's depth, m.

        Parameters
        ----------
        depth_m : float
            Distance along the optical axis, m.
        disparity_sigma_px : float
            Noise of the disparity, px; 0 gives the calibration's own share.

        Returns
        -------
        float
            Root mean square over the middle half of the images; NaN where they do not overlap.

        """
        points = field_of_view(self.calibration, depth_m)
        if not len(points):
            return float('nan')
        own = depth_sigma_m(
            self.calibration, self.estimate.problem.free, self.estimate.covariance, points
        )
        noise = matching_sigma_m(
            self.rig.focal_px, self.rig.baseline_m, np.array(depth_m), disparity_sigma_px
        )
        return float(np.hypot(np.sqrt(np.mean(own**2)), noise))

    def to_mapping(self) -> dict[str, Any]:
        """Return the content of ``calibration.json``."""
        calibration = self.calibration
        covariance = scaled_covariance(self.estimate, calibration.parameters, self.sizes)
        depths = {f'{depth:g}': self.depth_sigma_m(depth) for depth in DEPTHS_M}
        return {
            'image_size': list(calibration.image_size),
            **({'right_image_size': list(self.sizes.right)} if self.sizes.differs else {}),
            'baseline_m': calibration.baseline_m,
            'left': {'K': self.rig.left.K.tolist(), 'D': self.rig.left.D.tolist()},
            'right': {'K': self.rig.right.K.tolist(), 'D': self.rig.right.D.tolist()},
            'R': calibration.R.tolist(),
            'T': calibration.T.tolist(),
            'parameters': list(calibration.parameters),
            'covariance': covariance.tolist(),
            'sigma': self.sigma,
            'depth_sigma_m': {
                depth: sigma if np.isfinite(sigma) else None for depth, sigma in depths.items()
            },
            'boards': self._boards(),
            'row_difference_px': {
                'uncorrected': row_statistics(self.planar.row_difference_px),
                'corrected': row_statistics(self.corrected.row_difference_px),
                'adjusted': row_statistics(self.adjusted.row_difference_px),
            },
            'rejected': [{'name': board.name, 'reason': board.reason} for board in self.rejected],
            'rms_px': self.rms_px,
            'mark_sigma_px': dict(
                zip(
                    ('u', 'v', 'u_right', 'v_right'),
                    self.mark_sigma_px.ravel().tolist(),
                    strict=False,
                )
            ),
            'marks_left_out': int(self.estimate.outliers.sum()),
            'placement_scale': dict(
                zip(DEVIATIONS, self.estimate.problem.placement_scale.tolist(), strict=True)
            ),
            'board_warp_m': self._board_warp(),
            'split_half': self.halves.to_mapping(),
            'distortion': {
                'model': self.model,
                'evidence': [
                    {'model': e.model, 'chi2': e.chi2, 'parameters': e.parameters, 'bic': e.bic}
                    for e in self.evidence
                ],
            },
            'warnings': list(self.warnings),
            'advice': [{**asdict(advice), 'words': str(advice)} for advice in self.advice],
        }

    def _board_warp(self) -> dict[str, Any] | None:
        if not self.estimate.problem.target.bends:
            return None
        values = self.estimate.state.warp_m, self.estimate.warp_sigma_m
        warp, sigma = (dict(zip('xy', value.tolist(), strict=True)) for value in values)
        return {**warp, 'sigma': sigma}

    def _boards(self) -> list[dict[str, Any]]:
        # in both images, as a crew counts them
        counts = np.isfinite(self.adjusted.residuals_px).all(axis=-1).sum(axis=(1, 2))
        return [
            {
                'name': name,
                'marks': int(counts[i]),
                'uncorrected_px': float(self.planar.board_error_px[i]),
                'corrected_px': float(self.corrected.board_error_px[i]),
                'adjusted_px': float(self.adjusted.board_error_px[i]),
            }
            for i, name in enumerate(self.names)
        ]


def row_statistics(row_difference_px: FloatArray) -> dict[str, float]:
    """Return mean and largest row difference, px."""
    rows = np.abs(row_difference_px)
    return {'mean': float(np.nanmean(rows)), 'max': float(np.nanmax(rows))}


def scaled_covariance(
    found: Estimate, parameters: tuple[str, ...], sizes: CommonSize
) -> FloatArray:
    """Return the covariance of all parameters, (p, p), the right camera's in its own pixels."""
    own = [1 / sizes.scale if name in _RIGHT_PX else 1.0 for name in parameters]
    covariance: FloatArray = found.full_covariance * np.outer(own, own)
    return covariance
