# SPDX-License-Identifier: Apache-2.0
"""Triangulation: disparities become metric points with an uncertainty (eq. 16-18)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from binocular_recon._jit import kernel, over_strips
from binocular_recon.camera import FloatArray, StereoRig
from binocular_recon.config import CloudConfig
from binocular_recon.errors import ImageError
from binocular_recon.images import FloatImage


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
    disparity_px: FloatImage, sigma_px: FloatImage, rig: StereoRig, config: CloudConfig
) -> Cloud:
    """Triangulate a disparity map.

    Parameters
    ----------
    disparity_px : (H, W) float32
        Raw disparity x_left - x_right; NaN = none.
    sigma_px : (H, W) float32
        One standard deviation of the disparity.
    rig : StereoRig
        Rectified rig.
    config : CloudConfig
        Depth range.

    Returns
    -------
    Cloud
        Points; none where there is no disparity, at or behind infinity, or out of the depth
        range.

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
    points_xyz = np.empty((*size, 3), np.float32)
    sigma_z_m = np.empty(size, np.float32)
    over_strips(
        _triangulate_rows,
        size[0],
        np.ascontiguousarray(disparity_px, np.float32),
        np.ascontiguousarray(sigma_px, np.float32),
        rig.left.P,
        rig.focal_px * rig.baseline_m,
        rig.disparity_offset_px,
        (config.min_depth, config.max_depth),
        points_xyz,
        sigma_z_m,
    )
    return Cloud(points_xyz, sigma_z_m)


@kernel
def _triangulate_rows(
    disparity_px: FloatImage,
    sigma_px: FloatImage,
    projection: FloatArray,
    focal_baseline: float,
    offset_px: float,
    depth_range_m: tuple[float, float],
    points_xyz: FloatImage,
    sigma_z_m: FloatImage,
    start: int,
    stop: int,
) -> None:
    near, far = depth_range_m
    fx, cx, tx = projection[0, 0], projection[0, 2], projection[0, 3]
    fy, cy = projection[1, 1], projection[1, 2]
    for row in range(start, stop):
        y_over_z = (row - cy) / fy
        for column in range(disparity_px.shape[1]):
            z = focal_baseline / (disparity_px[row, column] - offset_px)  # eq. 18
            # written so that NaN, infinity and what lies behind the rig fail
            if z > 0 and near <= z <= far:
                points_xyz[row, column, 0] = ((column - cx) * z - tx) / fx
                points_xyz[row, column, 1] = y_over_z * z
                points_xyz[row, column, 2] = z
                sigma_z_m[row, column] = z * z / focal_baseline * sigma_px[row, column]
            else:
                points_xyz[row, column, :] = np.nan
                sigma_z_m[row, column] = np.nan
