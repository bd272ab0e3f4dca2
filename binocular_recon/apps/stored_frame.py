# SPDX-License-Identifier: Apache-2.0
"""The frames of an output folder, with the parts that formats of `FRAME_FORMATS` need."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from binocular_recon.apps.frame_formats import FRAME_FORMATS
from binocular_recon.apps.summary_entries import STATIONS, SUMMARY, read_summary, rectified_rig
from binocular_recon.camera import StereoRig
from binocular_recon.errors import CalibrationError, ConfigError, FileError, shortened
from binocular_recon.images import FloatImage
from binocular_recon.io.exports.depth import DepthGeometry
from binocular_recon.io.exports.placement import Placement
from binocular_recon.io.exports.point_table import PointTable

_REMEDY = 'give the folder that `reconstruct --output` wrote'


@dataclass(frozen=True, eq=False)
class StoredFrame:
    """A frame in an output folder; attributes as those of `FrameResult` of the same name.

    Attributes
    ----------
    folder : Path
    index : int
    geometry : DepthGeometry
        What its depth image is of.
    thinned : bool
        Whether its cloud has fewer points than the image has pixels with one.
    placement : Placement, optional
        Puts `table` into the frame of a site.

    """

    folder: Path
    index: int
    geometry: DepthGeometry
    thinned: bool
    placement: Placement | None = None

    def _path(self, name: str) -> Path:
        return self.folder / f'{self.index:06d}{FRAME_FORMATS[name].ending}'

    @cached_property
    def table(self) -> PointTable:
        """The points; raises a FileError if their file cannot be read."""
        return PointTable.of_file(self._path('ply')).placed(self.placement)

    @cached_property
    def depth_m(self) -> FloatImage:
        """Depth of each pixel that has a point, (H, W) float32, m; NaN = none.

        Raises a ConfigError if the cloud was thinned.
        """
        if self.thinned:
            raise ConfigError(
                f'the clouds in {self.folder} were thinned (decimation, voxel_size), so they have'
                ' no point for most pixels; write depth images with reconstruct --format'
            )
        width, height = self.geometry.size
        depth_m = np.full((height, width), np.nan, np.float32)
        for chunk in dataclasses.replace(self.table, placement=None).chunks():
            u, v, w = self.geometry.P[:, :3] @ chunk.xyz.T
            columns, rows = np.rint(u / w).astype(np.intp), np.rint(v / w).astype(np.intp)
            if not ((columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)).all():
                raise FileError(
                    f'{self._path("ply")} and summary.json do not fit together: points lie outside'
                    ' of the image; reconstruct again'
                )
            depth_m[rows, columns] = chunk.xyz[:, 2]
        return depth_m


def stored_frames(folder: Path, placement: Placement | None = None) -> Iterator[StoredFrame]:
    """Yield the frames of an output folder.

    Parameters
    ----------
    folder : Path
        What `reconstruct` wrote.
    placement : Placement, optional
        Puts the points into the frame of a site.

    Raises
    ------
    FileError
        If the folder has no summary, or it is damaged.

    """
    path = folder / SUMMARY
    if not path.exists() and not (folder / STATIONS).exists():
        raise FileError(f'{folder} holds no results: there is no {SUMMARY}; {_REMEDY}')
    summary = read_summary(folder, _REMEDY)
    rigs: list[tuple[Any, StereoRig]] = []
    try:
        options = summary['options']['cloud']
        thinned = options['decimation'] > 1 or options['voxel_size'] > 0
        for frame in summary['frames']:
            entry = frame.get('calibration', summary.get('calibration'))
            if not rigs or rigs[-1][0] != entry:
                rigs.append((entry, rectified_rig(summary, entry)))
            left, baseline_m = rigs[-1][1].left, rigs[-1][1].baseline_m
            geometry = DepthGeometry(left.size, left.P, baseline_m, summary['frame'])
            yield StoredFrame(folder, frame['index'], geometry, thinned, placement)
    except (LookupError, TypeError, CalibrationError) as error:
        reason = str(error) if isinstance(error, CalibrationError) else shortened(repr(error))
        raise FileError(f'{path} is damaged or of another version: {reason}; {_REMEDY}') from error
