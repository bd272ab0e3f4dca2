# SPDX-License-Identifier: Apache-2.0
"""Slow, obvious twins of the weighted least squares filter."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
import scipy.sparse as sp
from scipy.sparse.linalg import splu

Array = npt.NDArray[np.float64]


def log_luminance(guide: npt.ArrayLike) -> Array:
    """Return ln(Y + 1/255) of an image in grey levels 0..255."""
    return np.log(np.asarray(guide, float) / 255 + 1 / 255)


def links(guide_log: Array, strength: float, alpha: float, epsilon: float) -> tuple[Array, Array]:
    """Return lambda a_x (H, W - 1) and lambda a_y (H - 1, W)."""
    height, width = guide_log.shape
    link_east, link_south = np.zeros((height, width - 1)), np.zeros((height - 1, width))
    for y in range(height):
        for x in range(width):
            if x + 1 < width:
                step = abs(guide_log[y, x + 1] - guide_log[y, x])
                link_east[y, x] = strength / (math.pow(step, alpha) + epsilon)
            if y + 1 < height:
                step = abs(guide_log[y + 1, x] - guide_log[y, x])
                link_south[y, x] = strength / (math.pow(step, alpha) + epsilon)
    return link_east, link_south


def matrix(
    weight: npt.ArrayLike, link_east: npt.ArrayLike, link_south: npt.ArrayLike
) -> sp.csc_matrix:
    """Return C + lambda L_g."""
    c, east, south = (np.asarray(a, float) for a in (weight, link_east, link_south))
    pixels = np.arange(c.size).reshape(c.shape)
    one = np.concatenate([pixels[:, :-1].ravel(), pixels[:-1].ravel()])
    other = np.concatenate([pixels[:, 1:].ravel(), pixels[1:].ravel()])
    link = np.concatenate([east.ravel(), south.ravel()])
    rows = np.concatenate([one, other, one, other])
    columns = np.concatenate([other, one, one, other])
    values = np.concatenate([-link, -link, link, link])
    laplacian = sp.coo_matrix((values, (rows, columns)), shape=(c.size, c.size))
    return (sp.diags(c.ravel()) + laplacian).tocsc()


def solution(
    data: npt.ArrayLike, weight: npt.ArrayLike, link_east: npt.ArrayLike, link_south: npt.ArrayLike
) -> Array:
    """Solve (C + lambda L_g) f = C b directly."""
    c, b = np.asarray(weight, float), np.asarray(data, float)
    rhs = np.where(c > 0, c * b, 0).ravel()
    exact = splu(matrix(weight, link_east, link_south)).solve(rhs)
    return np.asarray(exact, np.float64).reshape(c.shape)


def minimiser(
    data: Array, weight: Array, guide_log: Array, strength: float, alpha: float, epsilon: float
) -> Array:
    """Minimise eq. 11."""
    return solution(data, weight, *links(guide_log, strength, alpha, epsilon))
