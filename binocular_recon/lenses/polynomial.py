# SPDX-License-Identifier: Apache-2.0
"""The lens of ``plumb_bob`` and ``rational_polynomial``."""

from __future__ import annotations

import math

import cv2
import numpy as np

from binocular_recon.lenses._inversion import determinant, inverse, least_root, matrices, solve
from binocular_recon.lenses.lens import FloatArray, FloatMap, Lens

# A ray is exact once it is imaged this closely to its point, as a share of 1 + its distance from
# the centre: 2e-10 px at a focal length of 2000 px.
_TOLERANCE = 1e-13
_NEWTON_STEPS = 30
# Places on the way from the centre to a ray at which the image must not be folded.
_WAY = np.linspace(0.125, 1.0, 8)
# Rays whose ways fit a processor's cache.
_BLOCK = 1024
# Points this close to the centre are their own rays.
_CENTRE = 1e-8


class PolynomialLens(Lens):
    """Radial polynomial or rational function, tangential terms, thin prism and tilted sensor.

    Coefficients in OpenCV's order: k1 k2 p1 p2 k3 k4 k5 k6 s1 s2 s3 s4 tau_x tau_y; those that
    are not given are 0. ``plumb_bob`` stops at k3.
    """

    POLYNOMIAL = True

    def distort(self, rays: FloatArray, D: FloatArray) -> FloatArray:
        """Return the distorted points (..., 2) of rays (..., 2)."""
        x, y = rays[..., 0], rays[..., 1]
        k1, k2, p1, p2, k3, k4, k5, k6 = _padded(D, 8)
        r2 = x * x + y * y
        radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
        u = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
        v = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
        points = np.stack([u, v], axis=-1)
        if D.size > 8:
            points = _tilt(points + _prism(r2, D)[0], _sensor(D))
        return points

    def derivatives(
        self, rays: FloatArray, D: FloatArray, scale: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return distorted points and their derivatives, with up to 8 coefficients."""
        x, y = rays[..., 0], rays[..., 1]
        r2 = x * x + y * y
        inverse, radial, points, by_ray = _radial_and_tangential(x, y, r2, D)
        factors = np.stack([inverse * r2, inverse * (r2 * r2), inverse * r2 * (r2 * r2)], -1)
        factors = np.concatenate([factors, -radial[..., None] * factors], -1)
        a, b = scale
        by_coefficient = np.empty((*x.shape, 2, 8))
        for row, (factor, value) in enumerate(((a, x), (b, y))):
            by_coefficient[..., row, [0, 1, 4, 5, 6, 7]] = factor * value[..., None] * factors
        by_coefficient[..., 0, 2] = a * 2 * x * y
        by_coefficient[..., 0, 3] = a * (r2 + 2 * x * x)
        by_coefficient[..., 1, 2] = b * (r2 + 2 * y * y)
        by_coefficient[..., 1, 3] = b * 2 * x * y
        return points, by_ray, by_coefficient

    def undistort(self, points: FloatArray, D: FloatArray) -> FloatArray:
        """Return the rays (..., 2) that are imaged at distorted points (..., 2).

        Newton's method from the points themselves; where that fails, from the ray that is exact
        without tangential terms.
        """
        straight = points if D.size <= 12 else _tilt(points, _sensor(D, back=True))
        target = straight.reshape(-1, 2)
        limit = _fold(D)
        with np.errstate(all='ignore'):  # points without a ray end as NaN
            rays = _newton(target, target, D, limit)
            failed = np.isnan(rays[:, 0]) & np.isfinite(target).all(axis=-1)
            if failed.any():
                start = target[failed] * _radial_start(target[failed], D, limit)[:, None]
                rays[failed] = _newton(target[failed], start, D, limit)
        return rays.reshape(points.shape)

    def raw_pixels(
        self, K: FloatArray, D: FloatArray, R: FloatArray, P: FloatArray, size: tuple[int, int]
    ) -> tuple[FloatMap, FloatMap]:
        """Return the raw pixel that each pixel of a rectified image shows; by OpenCV."""
        columns, rows = cv2.initUndistortRectifyMap(K, D, R, P, size, cv2.CV_32FC1)
        return columns, rows


class PlumbBobLens(PolynomialLens):
    """A polynomial lens as it is calibrated: with rational terms where the marks call for them."""

    COEFFICIENTS = ('k1', 'k2', 'p1', 'p2', 'k3', 'k4', 'k5', 'k6')
    # a third radial term, or a rational model, is not determined by the marks of a few boards
    DEFAULT_COEFFICIENTS = ('k1', 'k2', 'p1', 'p2')
    TANGENTIAL = ('p1', 'p2')

    @property
    def models(self) -> dict[str, tuple[str, ...]]:
        """Sets of coefficients that a calibration compares; p1 and p2 come together."""
        terms = self.COEFFICIENTS
        smaller = {' '.join(terms[:count]) or 'none': terms[:count] for count in (0, 1, 2, 4, 5)}
        return {**smaller, 'rational': terms}

    def stated(self, D: FloatArray) -> tuple[str, FloatArray]:
        """Return ``plumb_bob`` or, with rational terms, ``rational_polynomial``, and its D."""
        return ('rational_polynomial', D) if D[5:].any() else (self.name, D[:5])


def _newton(target: FloatArray, start: FloatArray, D: FloatArray, limit: float) -> FloatArray:
    """Return the rays (N, 2) imaged at the target on a sensor without tilt, NaN = not found."""
    rays = start
    tolerance = _TOLERANCE * (1 + np.abs(target).max(axis=-1, initial=0.0))
    for _ in range(_NEWTON_STEPS):
        value, slopes = _sloped(rays, D)
        off = target - value
        if not (np.abs(off).max(axis=-1) > 0.01 * tolerance).any():
            break
        rays = rays + solve(slopes, off)
    exact = np.abs(target - _sloped(rays, D)[0]).max(axis=-1) <= tolerance
    unfolded = np.empty(len(rays), np.bool_)
    for first in range(0, len(rays), _BLOCK):
        block = slice(first, first + _BLOCK)
        way = _sloped(rays[block, None] * _WAY[:, None], D)[1]
        unfolded[block] = (determinant(way) > 0).all(axis=-1)
    good = exact & unfolded & (np.linalg.norm(rays, axis=-1) < limit)
    return np.where(good[:, None], rays, np.nan)


def _sloped(rays: FloatArray, D: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return distorted points and their derivatives by the ray, on a sensor without tilt."""
    x, y = rays[..., 0], rays[..., 1]
    r2 = x * x + y * y
    _, _, value, slopes = _radial_and_tangential(x, y, r2, D)
    if D.size > 8:
        offset, by_r2 = _prism(r2, D)
        value = value + offset
        slopes = slopes + by_r2[..., :, None] * 2 * rays[..., None, :]
    return value, slopes


def _radial_and_tangential(
    x: FloatArray, y: FloatArray, r2: FloatArray, D: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return 1 / the denominator, the radial factor, the points and their derivatives."""
    k1, k2, p1, p2, k3, k4, k5, k6 = _padded(D, 8)
    r4 = r2 * r2
    inverse = 1 / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
    radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) * inverse
    slope = inverse * (k1 + 2 * k2 * r2 + 3 * k3 * r4 - radial * (k4 + 2 * k5 * r2 + 3 * k6 * r4))
    u = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    v = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    u_x = radial + 2 * x * x * slope + 2 * p1 * y + 6 * p2 * x
    v_y = radial + 2 * y * y * slope + 6 * p1 * y + 2 * p2 * x
    mixed = 2 * x * y * slope + 2 * p1 * x + 2 * p2 * y
    return inverse, radial, np.stack([u, v], axis=-1), matrices(u_x, mixed, mixed, v_y)


def _fold(D: FloatArray) -> float:
    """Return the least radius at which the radial part stops growing or has a pole."""
    k1, k2, _, _, k3, k4, k5, k6 = _padded(D, 8)
    above, below = np.array([1, k1, k2, k3]), np.array([1, k4, k5, k6])
    powers = 2 * np.arange(4)
    # of r above(r^2) / below(r^2), times below^2
    growth = np.convolve(above * (1 + powers), below) - np.convolve(above, powers * below)
    return math.sqrt(min(least_root(growth), least_root(below)))


def _padded(D: FloatArray, count: int) -> FloatArray:
    """Return the first coefficients, those that are not given as 0."""
    padded = np.zeros(count)
    padded[: D.size] = D[:count]
    return padded


def _prism(r2: FloatArray, D: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the offset (..., 2) of a thin prism and its derivative by r squared."""
    s = D[8:12].reshape(2, 2)
    r2 = r2[..., None]
    return r2 * (s[:, 0] + r2 * s[:, 1]), s[:, 0] + 2 * r2 * s[:, 1]


def _sensor(D: FloatArray, *, back: bool = False) -> FloatArray:
    """Return the homography (3, 3) of a sensor tilted about x and y, or its inverse."""
    tau_x, tau_y = _padded(D, 14)[12:]
    cx, sx, cy, sy = math.cos(tau_x), math.sin(tau_x), math.cos(tau_y), math.sin(tau_y)
    about_x, about_y = (
        [[1, 0, 0], [0, cx, sx], [0, -sx, cx]],
        [[cy, 0, -sy], [0, 1, 0], [sy, 0, cy]],
    )
    turn = np.array(about_y) @ about_x
    flat = [[turn[2, 2], 0, -turn[0, 2]], [0, turn[2, 2], -turn[1, 2]], [0, 0, 1]]
    homography = np.asarray(flat @ turn, np.float64)
    return np.asarray(np.linalg.inv(homography), np.float64) if back else homography


def _tilt(points: FloatArray, homography: FloatArray) -> FloatArray:
    mapped = points @ homography[:, :2].T + homography[:, 2]
    tilted: FloatArray = mapped[..., :2] / mapped[..., 2:]
    return tilted


def _radial_start(points: FloatArray, D: FloatArray, limit: float) -> FloatArray:
    """Return the factor on distorted points (N, 2) that undoes the radial part, (N,)."""
    radial = _padded(D, 8)
    radial[2:4] = 0.0

    def along_x(r: FloatArray) -> tuple[FloatArray, FloatArray]:
        _, _, value, slopes = _radial_and_tangential(r, np.zeros_like(r), r * r, radial)
        return value[..., 0], slopes[..., 0, 0]

    def value(r: FloatArray) -> FloatArray:
        return along_x(r)[0]

    def slope(r: FloatArray) -> FloatArray:
        return along_x(r)[1]

    distance = np.linalg.norm(points, axis=-1)
    radius = inverse(distance, value, slope, limit)
    if math.isfinite(limit):  # tangential terms may bring a point into reach
        radius = np.where(np.isnan(radius) & np.isfinite(distance), 0.99 * limit, radius)
    return np.where(distance < _CENTRE, 1.0, radius / np.where(distance < _CENTRE, 1.0, distance))
