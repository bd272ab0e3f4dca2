# SPDX-License-Identifier: Apache-2.0
"""Derivatives of the pixels of points: what adjustments and covariances of points need."""

from __future__ import annotations

import numpy as np

from binocular_recon.lenses.lens import FloatArray, Lens


def project_derivatives(
    points: FloatArray, lens: Lens, K: FloatArray, D: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the pixels of points and their derivatives.

    Parameters
    ----------
    points : (..., 3) float64
        In the frame of the camera, m; a direction may stand for a point.
    lens : Lens
    K : (3, 3) float64
        Intrinsics, px.
    D : (n,) float64
        Coefficients of the lens, as many as it has or fewer.

    Returns
    -------
    pixels : (..., 2) float64
    by_point : (..., 2, 3) float64
    by_intrinsics : (..., 2, 4 + n) float64
        By fx, fy, cx, cy and the coefficients.

    """
    inverse_z = 1 / points[..., 2]
    x, y = points[..., 0] * inverse_z, points[..., 1] * inverse_z
    focal = np.array([K[0, 0], K[1, 1]])
    distorted, by_ray, by_coefficient = lens.derivatives(np.stack([x, y], axis=-1), D, focal)
    by_xy = focal[:, None] * by_ray
    by_z = -focal * (by_ray[..., 0] * x[..., None] + by_ray[..., 1] * y[..., None])
    by_point = np.concatenate([by_xy, by_z[..., None]], axis=-1) * inverse_z[..., None, None]
    by_intrinsics = np.zeros((*x.shape, 2, 4 + D.size))
    by_intrinsics[..., 0, 0], by_intrinsics[..., 1, 1] = distorted[..., 0], distorted[..., 1]
    by_intrinsics[..., 0, 2] = by_intrinsics[..., 1, 3] = 1
    by_intrinsics[..., 4:] = by_coefficient[..., : D.size]
    return focal * distorted + K[:2, 2], by_point, by_intrinsics
