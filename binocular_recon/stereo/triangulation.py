# SPDX-License-Identifier: Apache-2.0
"""Triangulation: from disparities to metric points and their standard deviation (eq. 16-18)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from binocular_recon._jit import over_strips
from binocular_recon.camera import StereoRig
from binocular_recon.cloud_config import CloudConfig
from binocular_recon.errors import ImageError
from binocular_recon.images import ByteImage, FloatImage
from binocular_recon.rotations import quarter_turn
from binocular_recon.stereo._triangulation_kernels import triangulate_rows
from binocular_recon.stereo.orientation import lying_rig, turn
from binocular_recon.stereo.point_covariance import variance_grid
from binocular_recon.stereo.validity import Validity


@dataclass(frozen=True, eq=False)
class Cloud:
    """Organised point cloud in the left rectified optical frame.

    Attributes
    ----------
    points_xyz : (H, W, 3) float32
        Metres; NaN = no point.
    sigma_m : (H, W, 3) or (H, W, 1) float32
        One standard deviation of x, y and z, metres, with the shares of matching and of the
        calibration; without the covariance of the calibration of z only, with the share of
        matching. NaN = no point.

    """

    points_xyz: FloatImage
    sigma_m: FloatImage

    @property
    def sigma_z_m(self) -> FloatImage:
        """One standard deviation of the depth, (H, W) float32, metres; NaN = no point."""
        return self.sigma_m[..., -1]

    @property
    def calibrated(self) -> bool:
        """Whether the standard deviations hold the calibration's share."""
        return bool(self.sigma_m.shape[-1] == 3)

    @property
    def sigmas_m(self) -> dict[str, FloatImage]:
        """The known standard deviations by their names in files and messages, (H, W) float32."""
        names = ('sigma_x', 'sigma_y', 'sigma_z')[-self.sigma_m.shape[-1] :]
        return {name: self.sigma_m[..., i] for i, name in enumerate(names)}

    @property
    def depth_m(self) -> FloatImage:
        """Depth of each pixel, (H, W) float32, metres; NaN = no point."""
        return self.points_xyz[..., 2]


def triangulate(
    disparity_px: FloatImage,
    sigma_px: FloatImage,
    validity: ByteImage,
    rig: StereoRig,
    config: CloudConfig,
) -> Cloud:
    """Triangulate a disparity map.

    Parameters
    ----------
    disparity_px : (H, W) float32
        Raw disparity x_left - x_right; NaN = none.
    sigma_px : (H, W) float32
        One standard deviation of the disparity.
    validity : (H, W) uint8
        `Validity` of the disparity; extrapolated pixels become no points.
    rig : StereoRig
        Rectified rig.
    config : CloudConfig
        Limits of the points to keep.

    Returns
    -------
    Cloud
        NaN where there is no disparity, where it is at or beyond infinity, outside the depth
        range, and where the standard deviation exceeds ``config.max_sigma`` or a third of the
        depth.

    Raises
    ------
    ImageError
        If the maps differ in size from each other or from the images of the rig.

    Notes
    -----
    Eq. 16-18 of the paper, but the two cameras may have different principal points: the disparity
    of a point at infinity is ``o = cx_left - cx_right``, so ``z = f B / (d - o)``. To first order,
    matching contributes ``z^2 / (f B) sigma_d`` along the ray of the pixel; the calibration's
    share, where the rig has its covariance, is that of `point_covariance`.

    """
    size = (rig.left.height, rig.left.width)
    if {disparity_px.shape, sigma_px.shape, validity.shape} != {size}:
        raise ImageError(
            f'disparity is {disparity_px.shape}, its sigma {sigma_px.shape} and its validity'
            f' {validity.shape} (rows, columns), the rig has {size}; use the calibration of these'
            ' images'
        )
    if rig.turns:
        return _turned_cloud(disparity_px, sigma_px, validity, rig, config)
    kept = Validity.MEASURED | (Validity.FILLED if config.keep == 'all' else 0)
    points_xyz = np.empty((*size, 3), np.float32)
    sigma_m = np.empty((*size, 3 if rig.covariance else 1), np.float32)
    over_strips(
        triangulate_rows,
        size[0],
        np.ascontiguousarray(disparity_px, np.float32),
        np.ascontiguousarray(sigma_px, np.float32),
        np.ascontiguousarray(validity, np.uint8),
        int(kept),
        rig.left.P,
        rig.focal_px * rig.baseline_m,
        rig.disparity_offset_px,
        (config.min_depth, config.max_depth),
        config.sigma_limit,
        variance_grid(rig),
        points_xyz,
        sigma_m,
    )
    return Cloud(points_xyz, sigma_m)


def _turned_cloud(
    disparity_px: FloatImage,
    sigma_px: FloatImage,
    validity: ByteImage,
    rig: StereoRig,
    config: CloudConfig,
) -> Cloud:
    """Triangulate maps of a rig with one camera above the other, turned, and turn back."""
    turns = rig.turns
    lying = triangulate(
        turn(disparity_px, turns),
        turn(sigma_px, turns),
        turn(validity, turns),
        lying_rig(rig),
        config,
    )
    points_xyz = turn(lying.points_xyz, -turns) @ quarter_turn(turns).astype(np.float32)
    sigma_m = turn(lying.sigma_m, -turns)
    if lying.calibrated:
        sigma_m = np.ascontiguousarray(sigma_m[..., [1, 0, 2]])
    return Cloud(points_xyz, sigma_m)
