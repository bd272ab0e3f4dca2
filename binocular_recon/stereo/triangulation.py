# SPDX-License-Identifier: Apache-2.0
"""Triangulation: disparities become metric points with an uncertainty (eq. 16-18)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from binocular_recon._jit import over_strips
from binocular_recon.camera import StereoRig
from binocular_recon.config import CloudConfig
from binocular_recon.errors import ImageError
from binocular_recon.images import ByteImage, FloatImage
from binocular_recon.stereo._triangulation_kernels import triangulate_rows
from binocular_recon.stereo.validity import Validity


@dataclass(frozen=True, eq=False)
class Cloud:
    """Organised point cloud in the left rectified optical frame.

    Attributes
    ----------
    points_xyz : (H, W, 3) float32
        Metres; NaN = no point.
    sigma_z_m : (H, W) float32
        One standard deviation of the depth, metres; NaN = no point.

    """

    points_xyz: FloatImage
    sigma_z_m: FloatImage

    @property
    def depth_m(self) -> FloatImage:
        """Depth of each pixel, (H, W) float32, metres; NaN = none."""
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
        `Validity` of the disparity: extrapolated pixels are no points.
    rig : StereoRig
        Rectified rig.
    config : CloudConfig
        Which points are kept.

    Returns
    -------
    Cloud
        Points; none where there is no disparity, at or behind infinity, out of the depth range,
        or where the standard deviation exceeds ``config.max_sigma`` or a third of the depth.

    Raises
    ------
    ImageError
        If the maps differ in size from each other or from the rig's pictures.

    Notes
    -----
    Eq. 16-18 of the paper with the principal points of the two cameras kept apart: the disparity
    of a point at infinity is ``o = cx_left - cx_right``, so ``z = f B / (d - o)``. To first order
    ``sigma_z = z^2 / (f B) sigma_d``.

    """
    size = (rig.left.height, rig.left.width)
    if disparity_px.shape != size or sigma_px.shape != size:
        raise ImageError(
            f'disparity is {disparity_px.shape} and its sigma {sigma_px.shape} (rows, columns),'
            f' the rig has {size}; use the calibration of these pictures'
        )
    kept = Validity.MEASURED | (Validity.FILLED if config.keep == 'all' else 0)
    points_xyz = np.empty((*size, 3), np.float32)
    sigma_z_m = np.empty(size, np.float32)
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
        points_xyz,
        sigma_z_m,
    )
    return Cloud(points_xyz, sigma_z_m)
