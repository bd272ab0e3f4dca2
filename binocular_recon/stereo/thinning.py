# SPDX-License-Identifier: Apache-2.0
"""Thinning: from the points of all pixels to fewer, before they are sent or written."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from binocular_recon.cloud_config import CloudConfig
from binocular_recon.images import ByteImage
from binocular_recon.stereo.triangulation import Cloud
from binocular_recon.stereo.validity import Validity

# Squares of smaller standard deviations would not divide, m.
_LEAST_SIGMA_M = 1e-6


class PointSet(NamedTuple):
    """What a file or a message of points holds.

    Attributes
    ----------
    cloud : Cloud
        Points and their standard deviations; with voxels (1, N, ...), one per voxel, all valid.
    validity : (H, W) uint8
        Bits of `Validity`.
    bgr : (H, W, 3) uint8, optional
        Colour of the points.

    """

    cloud: Cloud
    validity: ByteImage
    bgr: ByteImage | None = None


def thin(points: PointSet, config: CloudConfig) -> PointSet:
    """Return every n-th row and column of an organised cloud, and of these one point per voxel.

    Parameters
    ----------
    points : PointSet
        Organised.
    config : CloudConfig
        Its ``decimation`` and ``voxel_size`` apply.

    Returns
    -------
    PointSet
        Organised, unless there are voxels. Their grid begins at the origin of the frame, so
        it is the same for every frame.

    Notes
    -----
    The point of a voxel is the mean of the measured points in it, or of the filled ones if none
    was measured, weighted by 1 / sigma_z^2; so is its colour. A mean lies in the voxel and has no
    bias towards the camera, as the point of the smallest sigma would. Its sigma is the mean of
    theirs with the same weights. That is the largest that the sigma of the mean can be, which it
    reaches if all errors are the same. Errors of neighbours nearly are: they share windows, the
    filter's smoothing and the calibration, so 1 / sqrt(n) of them would promise too much. The
    validity holds the bits of all points that count.

    """
    step = config.decimation
    if step > 1:
        cloud, validity, bgr = points
        cloud = Cloud(cloud.points_xyz[::step, ::step], cloud.sigma_m[::step, ::step])
        points = PointSet(
            cloud, validity[::step, ::step], None if bgr is None else bgr[::step, ::step]
        )
    return _voxel_means(points, config.voxel_size) if config.voxel_size > 0 else points


def _voxel_means(points: PointSet, size_m: float) -> PointSet:
    """Return one point per voxel."""
    cloud, validity, bgr = points
    valid = np.isfinite(cloud.points_xyz).all(axis=-1)
    kept = np.flatnonzero(valid)
    cells = np.floor(cloud.points_xyz[valid] / np.float64(size_m)).astype(np.int64)
    order = _order(cells)
    kept = kept[order]
    starts = _starts(cells[order])
    if not starts.size:
        return PointSet(
            Cloud(cloud.points_xyz[:1, :0], cloud.sigma_m[:1, :0]),
            validity[:1, :0],
            None if bgr is None else bgr[:1, :0],
        )
    bits = validity.ravel()[kept]
    measured = (bits & Validity.MEASURED) > 0
    any_measured = np.logical_or.reduceat(measured, starts)
    counts = measured | ~np.repeat(any_measured, np.diff(starts, append=len(bits)))
    sigma_z = cloud.sigma_z_m.ravel()[kept].astype(np.float64)
    weight = np.where(counts, 1 / np.maximum(sigma_z, _LEAST_SIGMA_M) ** 2, 0.0)
    total = np.add.reduceat(weight, starts)

    def mean(values: npt.NDArray[np.generic]) -> npt.NDArray[np.float64]:
        columns = values.reshape(-1, values.shape[-1])[kept].T
        sums = [np.add.reduceat(column * weight, starts) for column in columns]
        return np.stack([one / total for one in sums], axis=-1)[None]

    return PointSet(
        Cloud(mean(cloud.points_xyz).astype(np.float32), mean(cloud.sigma_m).astype(np.float32)),
        np.bitwise_or.reduceat(np.where(counts, bits, np.uint8(0)), starts)[None],
        None if bgr is None else np.rint(mean(bgr)).astype(np.uint8),
    )


def _order(cells: npt.NDArray[np.int64]) -> npt.NDArray[np.intp]:
    """Return the order in which equal voxels, (N, 3), follow each other."""
    if not len(cells):
        return np.empty(0, np.intp)
    low = cells.min(axis=0)
    spans = [int(span) + 1 for span in cells.max(axis=0) - low]
    if math.prod(spans) > np.iinfo(np.int64).max:  # slower
        return np.lexsort(cells.T)
    x, y, z = (cells - low).T
    return np.argsort((z * spans[1] + y) * spans[0] + x, kind='stable')


def _starts(cells: npt.NDArray[np.int64]) -> npt.NDArray[np.intp]:
    """Return where each voxel begins in sorted cells, (N, 3)."""
    if not len(cells):
        return np.empty(0, np.intp)
    changes = np.any(cells[1:] != cells[:-1], axis=1)
    return np.flatnonzero(np.concatenate([[True], changes]))
