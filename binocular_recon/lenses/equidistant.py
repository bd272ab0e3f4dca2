# SPDX-License-Identifier: Apache-2.0
"""The fisheye lens ``equidistant``."""

from __future__ import annotations

import math
from typing import ClassVar

import cv2
import numpy as np
import numpy.typing as npt
from numpy.polynomial.polynomial import polyval

from binocular_recon.lenses._inversion import inverse, least_root, matrices
from binocular_recon.lenses.lens import FloatArray, FloatMap, Lens

# Rays this close to the optical axis are imaged where they are.
_AXIS = 1e-8


class EquidistantLens(Lens):
    """Fisheye lens: the angle from the optical axis becomes the distance from the centre.

    ``theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8)``; rays at 90 degrees and more
    from the axis do not exist in the plane at depth 1. Source: Kannala and Brandt, "A generic
    camera model and calibration method" (2006), as in ``cv2.fisheye``.
    """

    COEFFICIENTS = ('k1', 'k2', 'k3', 'k4')
    DEFAULT_COEFFICIENTS = ('k1', 'k2')
    WIDE_ANGLE = True
    # the largest angle that is undistorted, rad: tan(1.5707) is 10,000
    LARGEST_ANGLE: ClassVar = 1.5707

    def distort(self, rays: FloatArray, D: FloatArray) -> FloatArray:
        """Return the distorted points (..., 2) of rays (..., 2)."""
        points: FloatArray = rays * self._ratio(rays, D)[0][..., None]
        return points

    def derivatives(
        self, rays: FloatArray, D: FloatArray, scale: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return distorted points and their derivatives."""
        x, y = rays[..., 0], rays[..., 1]
        ratio, r, theta = self._ratio(rays, D)
        r2 = x * x + y * y
        near = r < _AXIS
        growth = polyval(theta, _angle_slopes(D))
        slope = (growth / (1 + r2) - ratio) / np.where(near, 1.0, r2)
        slope = np.where(near, 2 * (D[0] - 1 / 3), slope)
        mixed = x * y * slope
        by_ray = matrices(ratio + x * x * slope, mixed, mixed, ratio + y * y * slope)
        powers = theta[..., None] ** np.array([3, 5, 7, 9]) / np.where(near, 1.0, r)[..., None]
        by_coefficient = (scale * rays)[..., None] * powers[..., None, :]
        return rays * ratio[..., None], by_ray, by_coefficient

    def undistort(self, points: FloatArray, D: FloatArray) -> FloatArray:
        """Return the rays (..., 2) that are imaged at distorted points (..., 2)."""
        distance = np.linalg.norm(points, axis=-1)
        growth = _angle_slopes(D)
        limit = min(self.LARGEST_ANGLE, math.sqrt(least_root(growth[::2])))
        angles = _angle_coefficients(D)

        def value(theta: FloatArray) -> FloatArray:
            return np.asarray(polyval(theta, angles), np.float64)

        def slope(theta: FloatArray) -> FloatArray:
            return np.asarray(polyval(theta, growth), np.float64)

        theta = inverse(distance, value, slope, limit)
        near = distance < _AXIS
        stretch = np.where(near, 1.0, np.tan(theta) / np.where(near, 1.0, distance))
        rays: FloatArray = points * stretch[..., None]
        return rays

    def in_front(self, points: FloatArray, D: FloatArray) -> npt.NDArray[np.bool_]:
        """Return which distorted points (..., 2) are less than 90 degrees from the axis."""
        unfolded = math.sqrt(least_root(_angle_slopes(D)[::2])) > self.LARGEST_ANGLE
        # how far the last ray is from the centre; a folded image does not tell
        coefficients = _angle_coefficients(D if unfolded else np.zeros(4))
        inside: npt.NDArray[np.bool_] = np.linalg.norm(points, axis=-1) <= polyval(
            self.LARGEST_ANGLE, coefficients
        )
        return inside

    def raw_pixels(
        self, K: FloatArray, D: FloatArray, R: FloatArray, P: FloatArray, size: tuple[int, int]
    ) -> tuple[FloatMap, FloatMap]:
        """Return the raw pixel that each pixel of a rectified image shows; by OpenCV."""
        columns, rows = cv2.fisheye.initUndistortRectifyMap(K, D, R, P, size, cv2.CV_32FC1)
        return columns, rows

    @staticmethod
    def _ratio(rays: FloatArray, D: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the distorted by the true distance from the axis, that distance, its angle."""
        r = np.linalg.norm(rays, axis=-1)
        theta = np.arctan(r)
        near = r < _AXIS
        distorted = polyval(theta, _angle_coefficients(D))
        return np.where(near, 1.0, distorted / np.where(near, 1.0, r)), r, theta


def _angle_coefficients(D: FloatArray) -> FloatArray:
    k1, k2, k3, k4 = D
    return np.array([0, 1, 0, k1, 0, k2, 0, k3, 0, k4])


def _angle_slopes(D: FloatArray) -> FloatArray:
    k1, k2, k3, k4 = D
    return np.array([1, 0, 3 * k1, 0, 5 * k2, 0, 7 * k3, 0, 9 * k4])
