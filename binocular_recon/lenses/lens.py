# SPDX-License-Identifier: Apache-2.0
"""What every lens model does."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
FloatMap = npt.NDArray[np.float32]


class Lens(ABC):
    """One lens model.

    With coefficients 0 a lens must be the ideal one of its kind.

    Attributes
    ----------
    name : str
        ``distortion_model`` of a CameraInfo.
    counts : tuple of int
        Numbers of coefficients that it takes.
    COEFFICIENTS : tuple of str
        Coefficients that are calibrated, in the order of D. Without any, a calibration cannot
        choose the lens.
    DEFAULT_COEFFICIENTS : tuple of str
        Those of them that the marks of a few boards determine; a calibration starts with these.
    TANGENTIAL : tuple of str
        Those of them that real lenses keep small: a decentred lens, a sensor that is not square
        to it.
    WIDE_ANGLE : bool
        Whether the ideal lens bends straight lines, as a fisheye does.
    POLYNOMIAL : bool
        Whether OpenCV's functions for lenses that are not wide-angle take its D.

    """

    COEFFICIENTS: ClassVar[tuple[str, ...]] = ()
    DEFAULT_COEFFICIENTS: ClassVar[tuple[str, ...]] = ()
    TANGENTIAL: ClassVar[tuple[str, ...]] = ()
    WIDE_ANGLE: ClassVar[bool] = False
    POLYNOMIAL: ClassVar[bool] = False

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

    @property
    def models(self) -> dict[str, tuple[str, ...]]:
        """Sets of coefficients that a calibration compares, by name, from few to many.

        By default each has one more; one must be ``DEFAULT_COEFFICIENTS``.
        """
        names = self.COEFFICIENTS
        sets = [names[:count] for count in range(len(names) + 1)]
        return {' '.join(chosen) or 'none': chosen for chosen in sets}

    @property
    def default_model(self) -> str:
        """Name of the set that is ``DEFAULT_COEFFICIENTS``, a key of `models`."""
        return ' '.join(self.DEFAULT_COEFFICIENTS) or 'none'

    def stated(self, D: FloatArray) -> tuple[str, FloatArray]:
        """Return ``distortion_model`` and D as camera files state them, of all coefficients."""
        return self.name, D

    def raw_pixels(
        self, K: FloatArray, D: FloatArray, R: FloatArray, P: FloatArray, size: tuple[int, int]
    ) -> tuple[FloatMap, FloatMap]:
        """Return the raw pixel that each pixel of a rectified image shows.

        Parameters
        ----------
        K, D
            Intrinsics and distortion of the raw image.
        R, P : (3, 3) float64
            From the camera's to the rectified frame, and from there to rectified pixels.
        size : (int, int)
            Width and height of the rectified image, px.

        Returns
        -------
        columns, rows : (height, width) float32
            NaN where there is none.

        """
        columns, rows = np.meshgrid(np.arange(size[0]), np.arange(size[1]))
        local = np.stack([columns, rows, np.ones_like(rows)], axis=-1) @ np.linalg.inv(P @ R).T
        ahead = local[..., 2:] > 0
        rays = np.where(ahead, local[..., :2], np.nan) / np.where(ahead, local[..., 2:], 1.0)
        found = self.pixels(rays, K, D).astype(np.float32)
        return found[..., 0], found[..., 1]

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
