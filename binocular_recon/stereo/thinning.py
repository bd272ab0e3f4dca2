# SPDX-License-Identifier: Apache-2.0
"""Thinning: from the points of all pixels to fewer, before they are sent or written."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from binocular_recon.cloud_config import CloudConfig
from binocular_recon.images import ByteImage, Mask
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
    averaged : (H, W) uint16, optional
        Number of frames that each point rests on.

    """

    cloud: Cloud
    validity: ByteImage
    bgr: ByteImage | None = None
    averaged: npt.NDArray[np.uint16] | None = None


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
    validity holds the bits of all points that count, the number of frames is the least of theirs.

    """
    step = config.decimation
    if step > 1:
        cloud, validity, bgr, averaged = points
        points = PointSet(
            Cloud(cloud.points_xyz[::step, ::step], cloud.sigma_m[::step, ::step]),
            validity[::step, ::step],
            None if bgr is None else bgr[::step, ::step],
            None if averaged is None else averaged[::step, ::step],
        )
    return _voxel_means(points, config.voxel_size) if config.voxel_size > 0 else points


def _voxel_means(points: PointSet, size_m: float) -> PointSet:
    """Return one point per voxel."""
    cloud, validity, bgr, averaged = points
    valid = np.isfinite(cloud.points_xyz).all(axis=-1)
    kept = np.flatnonzero(valid)
    cells = np.floor(cloud.points_xyz[valid] / np.float64(size_m)).astype(np.int64)
    order, starts = grouped(cells)
    kept = kept[order]
    if not starts.size:
        return PointSet(
            Cloud(cloud.points_xyz[:1, :0], cloud.sigma_m[:1, :0]),
            validity[:1, :0],
            None if bgr is None else bgr[:1, :0],
            None if averaged is None else averaged[:1, :0],
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
        None if averaged is None else _least(averaged.ravel()[kept], counts, starts)[None],
    )


def _least(
    values: npt.NDArray[np.uint16], counts: Mask, starts: npt.NDArray[np.intp]
) -> npt.NDArray[np.uint16]:
    """Return the least of the values in each voxel that count."""
    most = np.iinfo(values.dtype).max
    return np.minimum.reduceat(np.where(counts, values, values.dtype.type(most)), starts)


def grouped(
    keys: npt.NDArray[np.int64],
) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
    """Return the order in which equal keys, (N, k), follow each other, and where each begins.

    Keys are sorted by the last column first; equal ones keep their order.
    """
    if not len(keys):
        return np.empty(0, np.intp), np.empty(0, np.intp)
    low = keys.min(axis=0)
    spans = [int(span) + 1 for span in keys.max(axis=0) - low]
    if math.prod(spans) > np.iinfo(np.int64).max:
        order = np.lexsort(keys.T)  # slower
    else:
        packed = np.zeros(len(keys), np.int64)
        for column, span in reversed([*zip((keys - low).T, spans, strict=True)]):
            packed = packed * span + column
        order = np.argsort(packed, kind='stable')
    return order, np.flatnonzero(~repeated(keys[order]))


def repeated(keys: npt.NDArray[np.int64]) -> Mask:
    """Tell which of sorted keys, (N, k), are the same as the one before."""
    same: Mask = np.zeros(len(keys), bool)
    same[1:] = np.all(keys[1:] == keys[:-1], axis=1)
    return same
