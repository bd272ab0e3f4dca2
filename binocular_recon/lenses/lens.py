# SPDX-License-Identifier: Apache-2.0
"""What every lens model does."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]


class Lens(ABC):
    """One lens model.

    Attributes
    ----------
    name : str
        ``distortion_model`` of a CameraInfo.
    counts : tuple of int
        Numbers of coefficients that it takes.

    """

    def __init__(self, name: str, counts: tuple[int, ...]) -> None:
        self.name, self.counts = name, counts

    @abstractmethod
    def distort(self, rays: FloatArray, D: FloatArray) -> FloatArray:
        """Return the distorted points (..., 2) of rays (..., 2)."""

    @abstractmethod
    def derivatives(
        self, rays: FloatArray, D: FloatArray, scale: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return distorted points and their derivatives.

        Parameters
        ----------
        rays : (..., 2) float64
        D : (n,) float64
            All coefficients that are calibrated.
        scale : (2,) float64
            Factor on the derivatives by D, such as the focal lengths.

        Returns
        -------
        distorted : (..., 2) float64
        by_ray : (..., 2, 2) float64
        by_coefficient : (..., 2, n) float64

        """

    @abstractmethod
    def undistort(self, points: FloatArray, D: FloatArray) -> FloatArray:
        """Return the rays (..., 2) that are imaged at distorted points (..., 2).

        Exact to rounding. NaN where the model does not invert: at points that no ray reaches, or
        only one behind a fold of the image. NaN stays NaN.
        """

    def in_front(self, points: FloatArray, D: FloatArray) -> npt.NDArray[np.bool_]:
        """Return which distorted points (..., 2) should have a ray: all, unless a lens sees more.

        Those that have none by `undistort` nevertheless lie behind a fold of the image.
        """
        del D
        return np.ones(points.shape[:-1], np.bool_)

    def pixels(self, rays: FloatArray, K: FloatArray, D: FloatArray) -> FloatArray:
        """Return the pixels (..., 2) at which a camera images rays (..., 2)."""
        focal, centre = np.diag(K)[:2], K[:2, 2]
        points = self.distort(rays, D)
        pixels: FloatArray = focal * points + centre
        if K[0, 1]:
            pixels[..., 0] += K[0, 1] * points[..., 1]
        return pixels

    def rays(self, pixels: FloatArray, K: FloatArray, D: FloatArray) -> FloatArray:
        """Return the rays (..., 2) that a camera images at pixels (..., 2); see `undistort`."""
        points = (pixels - K[:2, 2]) / np.diag(K)[:2]
        if K[0, 1]:
            points[..., 0] -= K[0, 1] / K[0, 0] * points[..., 1]
        return self.undistort(points, D)
