# SPDX-License-Identifier: Apache-2.0
"""Kernels that fit a rod's two sides and its borders to grey levels, below a pixel."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from binocular_recon._jit import kernel

FloatImage = npt.NDArray[np.float32]
FloatArray = npt.NDArray[np.float64]

# Parameters of a rod in the picture, with z = (y - y_middle) / y_scale: the middle is at
# x = C0 + C1 z + C2 z^2, its half width along a row R0 + R1 z, its shading over v = u / half width
# 1 + S1 v + S2 (v^2 - 1/3), the blur SIGMA.
C0, C1, C2, R0, R1, S1, S2 = range(7)
ROD_PARAMETERS = 7
# Background on either side of a rod that a row's fit uses, px.
BESIDE_PX = 3.0


@kernel
def _phi(x: float) -> float:
    return 0.5 * math.erfc(-x * 0.7071067811865476)


@kernel
def _density(x: float) -> float:
    return 0.3989422804014327 * math.exp(-0.5 * x * x)


@kernel
def _row_model(
    x0: int, z: float, rod: FloatArray, sigma: float, basis: FloatArray, slopes: FloatArray
) -> None:
    """Write the model of one row from column x0 on.

    ``basis`` (n, 3): shares of the left background, the rod, the right background.
    ``slopes`` (n, 3, 3): their derivatives by the middle's x, the half width and S1, S2 (last
    two share a column pair: 0 middle, 1 half width, 2 unused).
    """
    middle = rod[C0] + z * (rod[C1] + z * rod[C2])
    half = rod[R0] + z * rod[R1]
    for i in range(basis.shape[0]):
        u = x0 + i - middle
        a, b = (u + half) / sigma, (u - half) / sigma
        left, right = 1 - _phi(a), _phi(b)
        fa, fb = _density(a) / sigma, _density(b) / sigma
        v = min(1.0, max(-1.0, u / half))
        shade = 1 + rod[S1] * v + rod[S2] * (v * v - 1.0 / 3)
        cover = 1 - left - right
        basis[i, 0], basis[i, 1], basis[i, 2] = left, cover * shade, right
        # by the middle
        slopes[i, 0, 0], slopes[i, 0, 1], slopes[i, 0, 2] = fa, (fb - fa) * shade, -fb
        # by the half width
        slopes[i, 1, 0], slopes[i, 1, 1], slopes[i, 1, 2] = -fa, (fa + fb) * shade, -fb
        # by S1, S2
        slopes[i, 2, 0], slopes[i, 2, 1], slopes[i, 2, 2] = cover * v, cover * (v * v - 1.0 / 3), 0


@kernel
def _solve3(m: FloatArray, rhs: FloatArray) -> bool:
    """Solve m x = rhs for symmetric positive m (3, 3), rhs (3, k), in place; False if singular."""
    for i in range(3):
        if m[i, i] < 1e-9:
            return False
        for j in range(i + 1, 3):
            f = m[j, i] / m[i, i]
            for k in range(i, 3):
                m[j, k] -= f * m[i, k]
            for k in range(rhs.shape[1]):
                rhs[j, k] -= f * rhs[i, k]
    for i in range(2, -1, -1):
        for k in range(rhs.shape[1]):
            for j in range(i + 1, 3):
                rhs[i, k] -= m[i, j] * rhs[j, k]
            rhs[i, k] /= m[i, i]
    return True


@kernel
def accumulate_rows(
    image: FloatImage,
    rows: FloatArray,
    rod: FloatArray,
    sigma: float,
    normal: FloatArray,
    gradient: FloatArray,
) -> None:
    """Fit background and level of each row; add up the normal equations of the rod's parameters.

    Parameters
    ----------
    image : (H, W) float32
        Grey levels.
    rows : (n, 5) float64
        y, z, weight; written: level of the rod, root mean square residual (NaN = not seen).
    rod : (7,) float64
        Parameters of the rod.
    sigma : float
        Blur, px.
    normal, gradient : (7, 7), (7,) float64
        Added to.

    """
    p = ROD_PARAMETERS
    for r in range(rows.shape[0]):
        y, z, weight = int(rows[r, 0]), rows[r, 1], rows[r, 2]
        rows[r, 3] = rows[r, 4] = np.nan
        middle = rod[C0] + z * (rod[C1] + z * rod[C2])
        half = rod[R0] + z * rod[R1]
        x0 = int(math.ceil(middle - half - BESIDE_PX))
        x1 = int(math.floor(middle + half + BESIDE_PX))
        x0, x1 = max(0, x0), min(image.shape[1] - 1, x1)
        # both sides of the rod must be in the picture
        if x0 > middle - half - 1 or x1 < middle + half + 1 or half < 0.5:
            continue
        n = x1 - x0 + 1
        basis, slopes = np.empty((n, 3)), np.empty((n, 3, 3))
        _row_model(x0, z, rod, sigma, basis, slopes)
        m, rhs = np.zeros((3, 3)), np.zeros((3, 1))
        for i in range(n):
            for j in range(3):
                rhs[j, 0] += basis[i, j] * image[y, x0 + i]
                for k in range(3):
                    m[j, k] += basis[i, j] * basis[i, k]
        if not _solve3(m.copy(), rhs):
            continue
        left, level, right = rhs[0, 0], rhs[1, 0], rhs[2, 0]
        jacobian, residual = np.empty((n, p)), np.empty(n)
        square = 0.0
        for i in range(n):
            value = left * basis[i, 0] + level * basis[i, 1] + right * basis[i, 2]
            residual[i] = image[y, x0 + i] - value
            square += residual[i] ** 2
            by_x = left * slopes[i, 0, 0] + level * slopes[i, 0, 1] + right * slopes[i, 0, 2]
            by_r = left * slopes[i, 1, 0] + level * slopes[i, 1, 1] + right * slopes[i, 1, 2]
            jacobian[i, C0], jacobian[i, C1], jacobian[i, C2] = by_x, by_x * z, by_x * z * z
            jacobian[i, R0], jacobian[i, R1] = by_r, by_r * z
            jacobian[i, S1], jacobian[i, S2] = level * slopes[i, 2, 0], level * slopes[i, 2, 1]
        rows[r, 3], rows[r, 4] = level, math.sqrt(square / n)
        if weight <= 0:
            continue
        # what the row's own three levels can explain does not count (variable projection)
        cross = np.zeros((3, p))
        for i in range(n):
            for j in range(3):
                for k in range(p):
                    cross[j, k] += basis[i, j] * jacobian[i, k]
        solved = cross.copy()
        _solve3(m, solved)
        for j in range(p):
            for k in range(p):
                total = 0.0
                for i in range(n):
                    total += jacobian[i, j] * jacobian[i, k]
                for i in range(3):
                    total -= cross[i, j] * solved[i, k]
                normal[j, k] += weight * total
            total = 0.0
            for i in range(n):
                total += jacobian[i, j] * residual[i]
            gradient[j] += weight * total


# Parameters of a border: its place along the rod, levels below and above, curve, blur.
T0, BELOW, ABOVE, CURVE, BLUR = range(5)
BORDER_PARAMETERS = 5


@kernel
def accumulate_border(
    image: FloatImage,
    frame: FloatArray,
    shade: FloatArray,
    border: FloatArray,
    normal: FloatArray,
    gradient: FloatArray,
) -> tuple[float, int]:
    """Add up the normal equations of one border; return the squared residuals and their number.

    Parameters
    ----------
    image : (H, W) float32
        Grey levels.
    frame : (8,) float64
        x, y of the border as guessed, unit direction up the rod (x, y), half width across the
        rod, share of it used, how far to look below and above, px.
    shade : (2,) float64
        S1, S2 of the rod.
    border : (5,) float64
        Place along the direction from the guess, px; grey levels below and above; the ring's
        sag towards the rod's sides as a share of the half width; blur, px.
    normal, gradient : (5, 5), (5,) float64
        Added to.

    """
    xm, ym, dx, dy = frame[0], frame[1], frame[2], frame[3]
    half, share, below, above = frame[4], frame[5], frame[6], frame[7]
    width = max(share * half, 0.5)
    reach = max(below, above) + width
    square, count = 0.0, 0
    jacobian = np.empty(BORDER_PARAMETERS)
    for y in range(max(0, int(ym - reach)), min(image.shape[0], int(ym + reach) + 2)):
        for x in range(max(0, int(xm - reach)), min(image.shape[1], int(xm + reach) + 2)):
            t = (x - xm) * dx + (y - ym) * dy
            u = -(x - xm) * dy + (y - ym) * dx
            if t < -below or t > above or abs(u) > width:
                continue
            v = u / half
            sag = half * (math.sqrt(max(0.0, 1 - v * v)) - 1)
            a = (t - border[T0] - border[CURVE] * sag) / border[BLUR]
            share_above = _phi(a)
            light = 1 + shade[0] * v + shade[1] * (v * v - 1.0 / 3)
            step = border[ABOVE] - border[BELOW]
            value = light * (border[BELOW] + step * share_above)
            slope = -light * step * _density(a) / border[BLUR]
            jacobian[T0], jacobian[CURVE], jacobian[BLUR] = slope, slope * sag, slope * a
            jacobian[BELOW], jacobian[ABOVE] = light * (1 - share_above), light * share_above
            residual = image[y, x] - value
            square += residual * residual
            count += 1
            for j in range(BORDER_PARAMETERS):
                gradient[j] += jacobian[j] * residual
                for k in range(BORDER_PARAMETERS):
                    normal[j, k] += jacobian[j] * jacobian[k]
    return square, count
