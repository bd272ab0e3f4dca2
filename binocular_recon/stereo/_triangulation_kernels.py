# SPDX-License-Identifier: Apache-2.0
"""Kernel of triangulation: from disparities to points and their sigma (eq. 16-18)."""

from __future__ import annotations

import numpy as np

from binocular_recon._jit import kernel
from binocular_recon.camera import FloatArray
from binocular_recon.images import ByteImage, FloatImage


@kernel
def triangulate_rows(
    disparity_px: FloatImage,
    sigma_px: FloatImage,
    validity: ByteImage,
    kept: int,
    projection: FloatArray,
    focal_baseline: float,
    offset_px: float,
    depth_range_m: tuple[float, float],
    sigma_limit: tuple[float, float],
    points_xyz: FloatImage,
    sigma_z_m: FloatImage,
    start: int,
    stop: int,
) -> None:
    """Write the points of rows ``start`` to ``stop``; NaN where a pixel is not kept.

    ``kept`` has the bits of `Validity` that are kept; ``sigma_limit`` is the largest sigma in
    metres and as a share of the depth.
    """
    near, far = depth_range_m
    largest_m, largest_share = sigma_limit
    fx, cx, tx = projection[0, 0], projection[0, 2], projection[0, 3]
    fy, cy = projection[1, 1], projection[1, 2]
    for row in range(start, stop):
        y_over_z = (row - cy) / fy
        for column in range(disparity_px.shape[1]):
            z = focal_baseline / (disparity_px[row, column] - offset_px)  # eq. 18
            sigma_z = z * z / focal_baseline * sigma_px[row, column]
            known = sigma_z <= largest_m and sigma_z < largest_share * z
            # False for NaN, at infinity and behind the rig
            if validity[row, column] & kept and known and z > 0 and near <= z <= far:
                points_xyz[row, column, 0] = ((column - cx) * z - tx) / fx
                points_xyz[row, column, 1] = y_over_z * z
                points_xyz[row, column, 2] = z
                sigma_z_m[row, column] = sigma_z
            else:
                points_xyz[row, column, :] = np.nan
                sigma_z_m[row, column] = np.nan
