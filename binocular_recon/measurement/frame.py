# SPDX-License-Identifier: Apache-2.0
"""One reconstructed image pair as measuring needs it."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from binocular_recon.camera import FloatArray, StereoRig
from binocular_recon.cloud_config import CloudConfig
from binocular_recon.images import ByteImage, FloatImage, Mask, to_bgr8
from binocular_recon.measurement.uncertain import CALIBRATION, Uncertain, root_of
from binocular_recon.stereo.pipeline import Reconstruction
from binocular_recon.stereo.point_covariance import calibration_derivatives
from binocular_recon.stereo.triangulation import triangulate
from binocular_recon.stereo.validity import Validity


@dataclass(frozen=True, eq=False)
class MeasuredFrame:
    """A reconstructed pair: disparities, how well they are known, and the calibration.

    Attributes
    ----------
    rig : StereoRig
        The rectified rig (`Chain.rig`), with the covariance of its calibration where it is known.
    disparity_px, sigma_px : (H, W) float32
        Raw disparity x_left - x_right and one standard deviation of it; NaN = none.
    validity : (H, W) uint8
        Bits of `Validity`.
    left_bgr : (H, W, 3) uint8
        The rectified left image.
    name : str
        What messages call the frame, such as its number.
    limits : CloudConfig
        Which points the cloud holds.

    """

    rig: StereoRig
    disparity_px: FloatImage
    sigma_px: FloatImage
    validity: ByteImage
    left_bgr: ByteImage
    name: str = '0'
    limits: CloudConfig = field(default_factory=CloudConfig)

    @classmethod
    def of(cls, found: Reconstruction, rig: StereoRig, name: str = '0') -> MeasuredFrame:
        """Return what a chain with the rectified rig ``rig`` has reconstructed."""
        return cls(
            rig,
            found.filtered.disparity_px,
            found.filtered.sigma_px,
            found.filtered.validity,
            to_bgr8(found.left, found.levels),
            name,
            found.thinning,
        )

    @property
    def size(self) -> tuple[int, int]:
        """Width and height, px."""
        return self.rig.left.size

    @cached_property
    def points_xyz(self) -> FloatArray:
        """The cloud, (H, W, 3) float64, m; NaN = no point."""
        cloud = triangulate(self.disparity_px, self.sigma_px, self.validity, self.rig, self.limits)
        return cloud.points_xyz.astype(np.float64)

    @cached_property
    def measured(self) -> Mask:
        """Which pixels were matched, (H, W)."""
        matched: Mask = (self.validity & Validity.MEASURED > 0) & np.isfinite(self.disparity_px)
        return matched

    def ray(self, pixel: FloatArray) -> FloatArray:
        """Return the direction of a pixel (..., 2) of the left image, (..., 3), depth 1."""
        P = self.rig.left.P
        across = (pixel[..., 0] - P[0, 2]) / P[0, 0]
        down = (pixel[..., 1] - P[1, 2]) / P[1, 1]
        return np.stack([across, down, np.ones_like(across)], axis=-1)

    def point(self, pixel: FloatArray, disparity_px: FloatArray) -> FloatArray:
        """Return the points (..., 3), m, of pixels (..., 2) and their disparities (...)."""
        depth_m = self.focal_baseline / (disparity_px - self.rig.disparity_offset_px)
        return self.ray(pixel) * np.asarray(depth_m)[..., None]

    @property
    def focal_baseline(self) -> float:
        """Focal length times baseline, px m."""
        return self.rig.focal_px * self.rig.baseline_m

    def calibration_effect(self, points_xyz: FloatArray) -> FloatArray | None:
        """Return what the calibration's errors move at points (N, 3): (3 N, p), m.

        None if the covariance of the calibration is not known.
        """
        derivatives = self.calibration_derivatives(points_xyz)
        return None if derivatives is None else derivatives @ self.calibration_root

    def calibration_derivatives(self, points_xyz: FloatArray) -> FloatArray | None:
        """Return how points (N, 3) move with the calibration's p parameters: (3 N, p).

        None if the covariance of the calibration is not known.
        """
        if self.rig.covariance is None:
            return None
        moved = calibration_derivatives(points_xyz, self.rig)
        return moved.reshape(-1, moved.shape[-1])

    def calibrated(self, points: Uncertain) -> Uncertain:
        """Return points (3 N,) with the effect of the calibration added."""
        effect = self.calibration_effect(points.values.reshape(-1, 3))
        return points if effect is None else points.with_effect(CALIBRATION, effect)

    @cached_property
    def calibration_root(self) -> FloatArray:
        """What independent errors of the calibration do to its p parameters, (p, p)."""
        assert self.rig.covariance is not None
        return root_of(self.rig.covariance.matrix)
