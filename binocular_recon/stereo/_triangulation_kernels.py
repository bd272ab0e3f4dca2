# SPDX-License-Identifier: Apache-2.0
"""Kernel of triangulation: from disparities to points and their sigma (eq. 16-18)."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from binocular_recon._jit import inline_kernel, kernel
from binocular_recon.camera import FloatArray
from binocular_recon.images import ByteImage, FloatImage


@inline_kernel
def interpolate(
    grid: npt.NDArray[np.float32], first: float, second: float, third: float, values: FloatArray
) -> None:
    """Write what a grid (A, B, C, 3) holds at places from 0 to 1 along its three axes, (3,)."""
    a, b, c = grid.shape[0] - 1, grid.shape[1] - 1, grid.shape[2] - 1
    u = min(max(first, 0.0), 1.0) * a
    v = min(max(second, 0.0), 1.0) * b
    w = min(max(third, 0.0), 1.0) * c
    i, j, k = min(int(u), a - 1), min(int(v), b - 1), min(int(w), c - 1)
    u, v, w = u - i, v - j, w - k
    for n in range(3):
        near = (1 - v) * ((1 - w) * grid[i, j, k, n] + w * grid[i, j, k + 1, n]) + v * (
            (1 - w) * grid[i, j + 1, k, n] + w * grid[i, j + 1, k + 1, n]
        )
        far = (1 - v) * ((1 - w) * grid[i + 1, j, k, n] + w * grid[i + 1, j, k + 1, n]) + v * (
            (1 - w) * grid[i + 1, j + 1, k, n] + w * grid[i + 1, j + 1, k + 1, n]
        )
        values[n] = (1 - u) * near + u * far


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
    calibration: npt.NDArray[np.float32],
    points_xyz: FloatImage,
    sigma_m: FloatImage,
    start: int,
    stop: int,
) -> None:
    """Write the points of rows ``start`` to ``stop``; NaN where a pixel is not kept.

    ``kept`` has the bits of `Validity` that are kept; ``sigma_limit`` is the largest sigma in
    metres and as a share of the depth. ``calibration`` is the `variance_grid` of the rig,
    or empty. ``sigma_m`` takes the standard deviations of x, y and z, (H, W, 3), or of z only,
    (H, W, 1).
    """
    height, width = disparity_px.shape
    near, far = depth_range_m
    largest_m, largest_share = sigma_limit
    fx, cx, tx = projection[0, 0], projection[0, 2], projection[0, 3]
    fy, cy, ty = projection[1, 1], projection[1, 2], projection[1, 3]
    calibrated = calibration.size > 0
    shared = np.zeros(3)
    for row in range(start, stop):
        y_over_z = (row - cy) / fy
        for column in range(width):
            disparity = disparity_px[row, column]
            z = focal_baseline / (disparity - offset_px)  # eq. 18
            matching = z * z / focal_baseline * sigma_px[row, column]
            sigma_z = matching
            possible = validity[row, column] & kept and z > 0 and near <= z <= far
            if possible and calibrated:
                interpolate(
                    calibration,
                    column / max(width - 1, 1),
                    (column - disparity) / max(width - 1, 1),
                    row / max(height - 1, 1),
                    shared,
                )
                sigma_z = math.sqrt(matching * matching + shared[2] * z**4)
            known = sigma_z <= largest_m and sigma_z < largest_share * z  # False for NaN
            if not (possible and known):
                points_xyz[row, column, :] = np.nan
                sigma_m[row, column, :] = np.nan
                continue
            x = ((column - cx) * z - tx) / fx
            y = y_over_z * z - ty / fy
            points_xyz[row, column, 0] = x
            points_xyz[row, column, 1] = y
            points_xyz[row, column, 2] = z
            sigma_m[row, column, -1] = sigma_z
            if calibrated:
                along_x, along_y = matching * x / z, matching * y / z
                sigma_m[row, column, 0] = math.sqrt(along_x * along_x + shared[0] * z**4)
                sigma_m[row, column, 1] = math.sqrt(along_y * along_y + shared[1] * z**4)
