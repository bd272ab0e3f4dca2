# SPDX-License-Identifier: Apache-2.0
"""Lengths between points, with their standard deviation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from binocular_recon.camera import FloatArray
from binocular_recon.errors import ImageError


@dataclass(frozen=True)
class Length:
    """A measured length.

    Attributes
    ----------
    length_m : float
    sigma_m : float
        One standard deviation.

    """

    length_m: float
    sigma_m: float

    def __str__(self) -> str:
        """Return the length as a report states it."""
        return f'{self.length_m:.3f} +- {self.sigma_m:.3f} m'


def length_between(points_xyz: FloatArray, covariance: FloatArray) -> Length:
    """Return the distance of two points.

    Parameters
    ----------
    points_xyz : (2, 3) float64
        Points, m.
    covariance : (2, 3, 2, 3) float64
        Their covariance with each other, m^2: `joint_covariance`. Errors that both points share
        cancel, so the standard deviation of a length is not the sum of those of its ends.

    Returns
    -------
    Length

    Raises
    ------
    ImageError
        If a point is missing (NaN), or the points coincide: a length of 0 has no direction.

    Notes
    -----
    To first order: too small for lengths that are not several times their standard deviation.

    """
    if not np.isfinite(points_xyz).all():
        raise ImageError('a pixel of the length has no point; pick one that was measured')
    difference = points_xyz[1] - points_xyz[0]
    length = float(np.linalg.norm(difference))
    if not length > 0:
        raise ImageError('the two points of a length are the same; pick two different points')
    direction = difference / length
    towards = np.stack([-direction, direction])
    variance = np.einsum('ij,ijkl,kl->', towards, covariance, towards)
    return Length(length, float(np.sqrt(max(variance, 0.0))))
