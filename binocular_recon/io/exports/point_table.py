# SPDX-License-Identifier: Apache-2.0
"""The points that a file of another program gets, in parts."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from binocular_recon.camera import FloatArray
from binocular_recon.io.exports.placement import Placement
from binocular_recon.io.ply import (
    CAMERA_FRAME,
    SCALAR,
    StoredVertices,
    Vertices,
    read_ply,
    vertices_of,
)
from binocular_recon.stereo.point_covariance import sigma_shares
from binocular_recon.stereo.triangulation import Cloud

# Points of a part: some 20 MB with all their fields.
CHUNK = 200_000
SIGMAS = ('sigma_x', 'sigma_y', 'sigma_z')
# Scalars that are whole numbers, and their kinds.
WHOLE: dict[str, np.dtype[Any]] = {'validity': np.dtype(np.uint8), 'count': np.dtype(np.uint16)}


class PointChunk(NamedTuple):
    """A part of the points.

    Attributes
    ----------
    xyz : (n, 3) float64
        Metres.
    rgb : (n, 3) uint8
    scalars : dict of str to (n,) float32 or a kind of `WHOLE`
        ``sigma_x``, ``sigma_y``, ``sigma_z`` or the last only, m, ``validity`` and, of merged
        frames or stations, ``count``: how many of them were averaged.

    """

    xyz: FloatArray
    rgb: npt.NDArray[np.uint8]
    scalars: dict[str, npt.NDArray[Any]]


@dataclass(frozen=True, eq=False)
class PointTable:
    """The points of a cloud and where they lie.

    Attributes
    ----------
    vertices : (N,) structured
        In the camera's frame, laid out as in a PLY file, or still in it.
    shares : str
        What the standard deviations hold.
    frame : tuple of str
        What the frame of the camera is.
    placement : Placement, optional
        Puts the points into the frame of a site.
    system : str
        Coordinate reference system of the vertices as they are; empty for a local one.

    """

    vertices: Vertices | StoredVertices
    shares: str
    frame: tuple[str, ...] = (CAMERA_FRAME,)
    placement: Placement | None = None
    system: str = ''

    @classmethod
    def of_cloud(
        cls,
        cloud: Cloud,
        validity: npt.NDArray[np.uint8],
        bgr: npt.NDArray[np.uint8],
        frame: tuple[str, ...] = (CAMERA_FRAME,),
        count: npt.NDArray[np.uint16] | None = None,
    ) -> PointTable:
        """Return the valid points of a cloud; arguments as for `vertices_of`."""
        vertices = vertices_of(cloud, validity, bgr, count)
        return cls(vertices, sigma_shares(cloud.calibrated), frame)

    @classmethod
    def of_file(cls, path: Path) -> PointTable:
        """Return the points of a PLY file of ours; raises a FileError if it cannot be read."""
        vertices, comments = read_ply(path)
        begin = 'standard deviations hold the share of '
        shares = [text.removeprefix(begin) for text in comments if text.startswith(begin)]
        frame = [text for text in comments if 'frame' in text]
        return cls(vertices, shares[0] if shares else 'matching', tuple(frame))

    def __len__(self) -> int:
        """Return the number of points."""
        return len(self.vertices)

    def placed(self, placement: Placement | None) -> PointTable:
        """Return these points in the frame of a site."""
        shares = self.shares
        if placement and placement.covariance is not None:
            shares += ', and of the georeference'
        return dataclasses.replace(self, placement=placement, shares=shares)

    @property
    def crs(self) -> str:
        """Coordinate reference system of the points; empty for a local one."""
        return self.placement.crs if self.placement else self.system

    @property
    def frame_lines(self) -> tuple[str, ...]:
        """What the frame of the points is."""
        if self.placement is None:
            return self.frame
        return (f'frame of the site, metres{f", {self.crs}" if self.crs else ""}',)

    @property
    def scalar_names(self) -> list[str]:
        """Names of the scalars of every part."""
        names = self.vertices.dtype.names or ()
        found = [name.removeprefix(SCALAR) for name in names if name.startswith(SCALAR)]
        if self.placement is None:
            return found
        return [*SIGMAS, *(name for name in found if name not in SIGMAS)]

    def parts(self, size: int = CHUNK) -> Iterator[Vertices]:
        """Yield the vertices, in the camera's frame, in parts of at most ``size``."""
        for begin in range(0, len(self.vertices), size):
            yield self.vertices[begin : begin + size]

    def chunks(self, size: int = CHUNK) -> Iterator[PointChunk]:
        """Yield the points in parts of at most ``size``."""
        for part in self.parts(size):
            xyz = _coordinates(part)
            names = part.dtype.names or ()
            scalars = {
                name.removeprefix(SCALAR): part[name] for name in names if name.startswith(SCALAR)
            }
            if self.placement:
                sigmas = {name: scalars[name] for name in SIGMAS if name in scalars}
                scalars |= self.placement.sigmas(xyz, sigmas)
                xyz = self.placement.points(xyz)
            for name, kind in WHOLE.items():
                if name in scalars:
                    scalars[name] = scalars[name].astype(kind)
            rgb = np.stack([part[name] for name in ('red', 'green', 'blue')], axis=-1)
            yield PointChunk(xyz, rgb, {name: scalars[name] for name in self.scalar_names})

    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Return the least and the largest coordinates, (3,) float64 each; 0 without a point."""
        low, high = np.full(3, np.inf), np.full(3, -np.inf)
        for part in self.parts():
            xyz = _coordinates(part)
            xyz = self.placement.points(xyz) if self.placement else xyz
            low = np.minimum(low, xyz.min(axis=0))
            high = np.maximum(high, xyz.max(axis=0))
        return (low, high) if len(self.vertices) else (np.zeros(3), np.zeros(3))


def _coordinates(vertices: Vertices) -> FloatArray:
    return np.stack([vertices[name] for name in 'xyz'], axis=-1).astype(np.float64)
