# SPDX-License-Identifier: Apache-2.0
"""Rotation vectors, cross products, quarter turns and quaternions, to and from matrices."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]


def rotation(turn: FloatArray) -> FloatArray:
    """Return the rotation matrices (..., 3, 3) of rotation vectors (..., 3), rad (Rodrigues)."""
    angle = np.linalg.norm(turn, axis=-1)[..., None, None]
    generator = cross_matrix(turn)
    # sinc is exact at 0
    first = np.sinc(angle / np.pi)
    second = 0.5 * np.sinc(angle / (2 * np.pi)) ** 2
    result: FloatArray = np.eye(3) + first * generator + second * generator @ generator
    return result


def cross_matrix(vector: FloatArray) -> FloatArray:
    """Return the matrices (..., 3, 3) that form the cross product with vectors (..., 3)."""
    x, y, z = np.moveaxis(vector, -1, 0)
    matrix = np.zeros((*vector.shape, 3))
    matrix[..., 0, 1], matrix[..., 0, 2] = -z, y
    matrix[..., 1, 0], matrix[..., 1, 2] = z, -x
    matrix[..., 2, 0], matrix[..., 2, 1] = -y, x
    return matrix


def quaternion(R: FloatArray) -> FloatArray:
    """Return the unit quaternion x, y, z, w >= 0 of a rotation matrix (3, 3).

    Source: Bar-Itzhack, "New method for extracting the quaternion from a rotation matrix" (2000).
    """
    trace = np.trace(R)
    K = np.empty((4, 4))
    K[:3, :3] = R + R.T - trace * np.eye(3)
    K[3, :3] = K[:3, 3] = R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]
    K[3, 3] = trace
    largest: FloatArray = np.linalg.eigh(K)[1][:, -1]
    return -largest if largest[3] < 0 else largest


def quarter_turn(turns: int) -> FloatArray:
    """Return the rotation (3, 3) from the frame of a camera to that of its turned images.

    ``turns`` are quarter turns of the images, counter-clockwise: 0, 1 or -1.
    """
    return np.eye(3) if turns == 0 else np.array([[0, turns, 0], [-turns, 0, 0], [0, 0, 1.0]])


def turned_pixels(turns: int, size: tuple[int, int]) -> FloatArray:
    """Return homogeneous pixels of an image (width, height) to those of it turned, (3, 3).

    The way back is that of ``-turns`` and the size (height, width).
    """
    width, height = size
    matrix = quarter_turn(turns)
    if turns:
        matrix[:2, 2] = (0, width - 1) if turns > 0 else (height - 1, 0)
    return matrix


def turned_projection(P: FloatArray, turns: int, size: tuple[int, int]) -> FloatArray:
    """Return P (3, 4) of the turned image of a camera, whose frame is turned with it."""
    back = np.eye(4)
    back[:3, :3] = quarter_turn(turns).T
    projection: FloatArray = turned_pixels(turns, size) @ P @ back
    return projection


def rigid_fit(
    here: FloatArray, there: FloatArray, weight: FloatArray | None = None
) -> tuple[FloatArray, FloatArray]:
    """Return R (..., 3, 3) and t (..., 3) of the best ``there = R here + t``, by least squares.

    Points are (..., n, 3), their weights (n,), by default equal.
    Source: Umeyama, "Least-squares estimation of transformation parameters" (1991), scale 1.
    """
    count = here.shape[-2]
    share = np.full(count, 1 / count) if weight is None else weight / weight.sum()
    middle_here, middle_there = share @ here, share @ there
    off = there - middle_there[..., None, :]
    u, _, vt = np.linalg.svd(np.einsum('n,...ni,...nj->...ij', share, off, here))
    u[..., 2] *= np.linalg.det(u @ vt)[..., None]
    R: FloatArray = u @ vt
    return R, middle_there - np.einsum('...ij,...j->...i', R, middle_here)


def similarity_derivatives(places: FloatArray) -> FloatArray:
    """Return how places (n, 3) about a pivot move with a transformation of it, (n, 3, 7).

    With a small turn (rad), a shift and the relative scale.
    """
    unit = np.broadcast_to(np.eye(3), (len(places), 3, 3))
    return np.concatenate([-cross_matrix(places), unit, places[..., None]], axis=-1)
