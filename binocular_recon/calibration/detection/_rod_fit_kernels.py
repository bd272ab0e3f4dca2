# SPDX-License-Identifier: Apache-2.0
"""Kernels that fit a rod's two sides and its edges to grey levels, to subpixel accuracy."""

from __future__ import annotations

import math

import numpy as np

from binocular_recon._jit import inline_kernel, kernel
from binocular_recon.camera import FloatArray
from binocular_recon.images import FloatImage

# Parameters of a rod in the image, with z = (y - y_middle) / y_scale: the middle is at
# x = C0 + C1 z + C2 z^2, its half width along a row R0 + R1 z. The brightness of a matt rod lit by
# sky and sun is 1 + max(0, S1 v + S2 sqrt(1 - v^2)), v = distance from the middle / half width.
# SIGMA is the blur, px.
C0, C1, C2, R0, R1, S1, S2, SIGMA = range(8)
ROD_PARAMETERS = 8
# The corner between shade and light is rounded, so that a step of the fit cannot jump over it.
ROUND = 0.1
# A rod's width is cut into strips of one brightness, equal in angle around the rod: the least
# number, and the number per pixel of its half width.
MIN_STRIPS, STRIPS_PER_PX = 8, 1.5
# Background on either side of a rod that a row's fit uses, px.
BESIDE_PX = 3.0


@inline_kernel
def _phi(x: float) -> float:
    return 0.5 * math.erfc(-x * 0.7071067811865476)


@inline_kernel
def _density(x: float) -> float:
    return 0.3989422804014327 * math.exp(-0.5 * x * x)


@inline_kernel
def shading(v: float, s1: float, s2: float) -> float:
    """Return the brightness of a rod at v = -1..1 across."""
    sun = s1 * v + s2 * math.sqrt(max(0.0, 1 - v * v))
    return 1 + 0.5 * (sun + math.sqrt(sun * sun + ROUND * ROUND))


@inline_kernel
def _cut_strips(rod: FloatArray, strips: FloatArray) -> None:
    """Write start, brightness and its derivatives by S1, S2 of each strip: (n + 1, 4).

    The last row holds the end of the last strip only.
    """
    count = strips.shape[0] - 1
    for k in range(count + 1):
        strips[k, 0] = math.sin((k / count - 0.5) * math.pi)
        v = math.sin(((k + 0.5) / count - 0.5) * math.pi)
        strips[k, 1] = shading(v, rod[S1], rod[S2])
        sun = rod[S1] * v + rod[S2] * math.sqrt(1 - v * v)
        lit = 0.5 * (1 + sun / math.sqrt(sun * sun + ROUND * ROUND))
        strips[k, 2], strips[k, 3] = lit * v, lit * math.sqrt(1 - v * v)
    strips[count, 1:] = 0.0


@inline_kernel
def _row_model(
    offset: float,
    half: float,
    sigma: float,
    strips: FloatArray,
    basis: FloatArray,
    slopes: FloatArray,
) -> None:
    """Write the model of one row whose first pixel is ``offset`` right of the rod's middle.

    ``basis`` (n, 3): shares of the left background, the rod, the right background. ``slopes``
    (n, 9): derivatives by the middle's x (left, rod, right), by the blur (left, rod, right) and
    of the rod's share by the half width, S1, S2.
    """
    n = basis.shape[0]
    for i in range(n):
        u = offset + i
        rod = by_x = by_half = by_s1 = by_s2 = by_blur = 0.0
        for k in range(strips.shape[0]):
            a = (u - half * strips[k, 0]) / sigma
            if a < -4.5:
                break
            share, density = 1.0, 0.0
            if a < 4.5:
                share, density = _phi(a), _density(a) / sigma
            # the change of brightness from strip k - 1 to strip k
            change = strips[k, 1] - (strips[k - 1, 1] if k > 0 else 0.0)
            rod += change * share
            by_x -= change * density
            by_half -= change * density * strips[k, 0]
            by_blur -= change * density * a
            by_s1 += (strips[k, 2] - (strips[k - 1, 2] if k > 0 else 0.0)) * share
            by_s2 += (strips[k, 3] - (strips[k - 1, 3] if k > 0 else 0.0)) * share
        a, b = (u + half) / sigma, (u - half) / sigma
        basis[i, 0], basis[i, 1], basis[i, 2] = 1 - _phi(a), rod, _phi(b)
        left, right = _density(a) / sigma, _density(b) / sigma
        slopes[i, 0], slopes[i, 1], slopes[i, 2] = left, by_x, -right
        slopes[i, 3], slopes[i, 4], slopes[i, 5] = a * left, by_blur, -b * right
        slopes[i, 6], slopes[i, 7], slopes[i, 8] = by_half, by_s1, by_s2


@inline_kernel
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
    normal: FloatArray,
    gradient: FloatArray,
) -> None:
    """Fit background and level of each row; sum the normal equations of the rod's parameters.

    Parameters
    ----------
    image : (H, W) float32
        Grey levels.
    rows : (n, 7) float64
        y, z, weight; written: level of the rod, root mean square residual (NaN = not seen), level
        of the background left and right.
    rod : (8,) float64
        Parameters of the rod.
    normal, gradient : (8, 8), (8,) float64
        Added to.

    """
    p = ROD_PARAMETERS
    strips = np.empty((max(MIN_STRIPS, int(STRIPS_PER_PX * rod[R0])) + 1, 4))
    _cut_strips(rod, strips)
    for r in range(rows.shape[0]):
        y, z, weight = int(rows[r, 0]), rows[r, 1], rows[r, 2]
        rows[r, 3] = rows[r, 4] = np.nan
        middle = rod[C0] + z * (rod[C1] + z * rod[C2])
        half = rod[R0] + z * rod[R1]
        x0 = max(0, math.ceil(middle - half - BESIDE_PX))
        x1 = min(image.shape[1] - 1, math.floor(middle + half + BESIDE_PX))
        # both sides of the rod must be in the image
        if x0 > middle - half - 1 or x1 < middle + half + 1 or half < 0.5:
            continue
        n = x1 - x0 + 1
        basis, slopes = np.empty((n, 3)), np.empty((n, 9))
        _row_model(x0 - middle, half, rod[SIGMA], strips, basis, slopes)
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
            by_x = left * slopes[i, 0] + level * slopes[i, 1] + right * slopes[i, 2]
            # a wider rod moves its left side left and its right side right
            by_r = -left * slopes[i, 0] + level * slopes[i, 6] + right * slopes[i, 2]
            jacobian[i, C0], jacobian[i, C1], jacobian[i, C2] = by_x, by_x * z, by_x * z * z
            jacobian[i, R0], jacobian[i, R1] = by_r, by_r * z
            jacobian[i, S1], jacobian[i, S2] = level * slopes[i, 7], level * slopes[i, 8]
            jacobian[i, SIGMA] = left * slopes[i, 3] + level * slopes[i, 4] + right * slopes[i, 5]
        rows[r, 3], rows[r, 4] = level, math.sqrt(square / n)
        rows[r, 5], rows[r, 6] = left, right
        if weight <= 0:
            continue
        # variable projection: remove what the row's own three levels explain
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


# Parameters of an edge: its position along the rod, levels below and above, curve, blur, levels of
# the background that blurs in from the left and the right.
T0, BELOW, ABOVE, CURVE, BLUR, LEFT, RIGHT = range(7)
EDGE_PARAMETERS = 7


@kernel
def accumulate_edge(
    image: FloatImage,
    window: FloatArray,
    shade: FloatArray,
    edge: FloatArray,
    normal: FloatArray,
    gradient: FloatArray,
) -> tuple[float, int]:
    """Sum the normal equations of one edge; return the squared residuals and their number.

    Parameters
    ----------
    image : (H, W) float32
        Grey levels.
    window : (8,) float64
        First guess of x, y of the edge; unit direction up the rod (x, y); half width across the
        rod; share of it used; reach below and above, px.
    shade : (2,) float64
        S1, S2 of the rod.
    edge : (7,) float64
        Position along the direction from the guess, px; grey levels below and above; sag of the
        ring towards the rod's sides, as a share of the half width; blur, px; grey levels on the
        left and on the right.
    normal, gradient : (7, 7), (7,) float64
        Added to.

    """
    xm, ym, dx, dy = window[0], window[1], window[2], window[3]
    half, share, below, above = window[4], window[5], window[6], window[7]
    width = max(share * half, 0.5)
    reach = max(below, above) + width
    square, count = 0.0, 0
    jacobian = np.empty(EDGE_PARAMETERS)
    for y in range(max(0, int(ym - reach)), min(image.shape[0], int(ym + reach) + 2)):
        for x in range(max(0, int(xm - reach)), min(image.shape[1], int(xm + reach) + 2)):
            t = (x - xm) * dx + (y - ym) * dy
            u = -(x - xm) * dy + (y - ym) * dx
            if t < -below or t > above or abs(u) > width:
                continue
            v = u / half
            sag = half * (math.sqrt(max(0.0, 1 - v * v)) - 1)
            a = (t - edge[T0] - edge[CURVE] * sag) / edge[BLUR]
            share_above = _phi(a)
            left = 1 - _phi((u + half) / edge[BLUR])
            right = _phi((u - half) / edge[BLUR])
            light = (1 - left - right) * shading(v, shade[0], shade[1])
            step = edge[ABOVE] - edge[BELOW]
            value = light * (edge[BELOW] + step * share_above)
            value += left * edge[LEFT] + right * edge[RIGHT]
            slope = -light * step * _density(a) / edge[BLUR]
            jacobian[T0], jacobian[CURVE], jacobian[BLUR] = slope, slope * sag, slope * a
            jacobian[BELOW], jacobian[ABOVE] = light * (1 - share_above), light * share_above
            jacobian[LEFT], jacobian[RIGHT] = left, right
            residual = image[y, x] - value
            square += residual * residual
            count += 1
            for j in range(EDGE_PARAMETERS):
                gradient[j] += jacobian[j] * residual
                for k in range(EDGE_PARAMETERS):
                    normal[j, k] += jacobian[j] * jacobian[k]
    return square, count
