# SPDX-License-Identifier: Apache-2.0
"""The folder that `reconstruct` and `demo` fill."""

from __future__ import annotations

import dataclasses
import math
import re
import statistics
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from binocular_recon.camera import Camera, StereoRig
from binocular_recon.config import ChainConfig
from binocular_recon.drawing.clouds import draw_cloud
from binocular_recon.drawing.colormap import heat_map
from binocular_recon.images import to_bgr8
from binocular_recon.io.files import complete_files, make_folder, write_json
from binocular_recon.io.image_files import write_image_file
from binocular_recon.io.pfm import write_pfm
from binocular_recon.io.ply import write_ply
from binocular_recon.machine import machine_facts
from binocular_recon.stereo.pipeline import Reconstruction

_ENDINGS = ('_disparity.pfm', '_disparity.png', '.ply', '_cloud.png')
_FRAME = re.compile(rf'(\d{{6,}})({"|".join(map(re.escape, _ENDINGS))})')


class ResultFolder:
    """Write each frame when it is finished and, at the end or when interrupted, the summary.

    What an earlier run left in the folder is replaced frame by frame; its other frames go when
    this run has finished.

    Parameters
    ----------
    folder : Path
        Made with its parents where it does not exist.
    source : dict
        Where the frames come from; becomes part of the summary.
    pictures : bool
        Whether each cloud is drawn as well.

    Attributes
    ----------
    frames : list of dict
        What the summary says of each finished frame.
    left_out : list of dict
        Stamp and reason of each pair that could not be reconstructed.

    Raises
    ------
    FileError
        If the folder cannot be made.

    """

    def __init__(self, folder: Path, source: dict[str, Any], *, pictures: bool = False) -> None:
        make_folder(folder)
        self.folder = folder
        self.frames: list[dict[str, Any]] = []
        self.left_out: list[dict[str, Any]] = []
        self._source = source
        self._pictures = pictures
        self._rig: StereoRig | None = None

    def add(
        self, stamp_ns: int, rig: StereoRig, reconstruction: Reconstruction, seconds: float
    ) -> None:
        """Write the files of a frame; raises a FileError if they cannot be written."""
        index = len(self.frames)
        frame = {
            'index': index,
            'stamp_ns': stamp_ns,
            'density': float(np.isfinite(reconstruction.filtered.disparity_px).mean()),
            'depth_m': _range(reconstruction.cloud.depth_m),
            'seconds': round(seconds, 4),
            'points': self._write_files(f'{index:06d}', reconstruction),
        }
        if self._rig is None:
            self._rig = rig
        elif rig is not self._rig:
            frame['calibration'] = _calibration(rig)
        self.frames.append(frame)

    def _write_files(self, stem: str, reconstruction: Reconstruction) -> int:
        """Write all files of a frame or none; returns the number of points."""
        disparity_px, cloud = reconstruction.filtered.disparity_px, reconstruction.cloud
        bgr = to_bgr8(reconstruction.left)
        with complete_files(self.folder) as parts:
            pfm, png, ply, drawing = (parts / f'{stem}{ending}' for ending in _ENDINGS)
            write_pfm(pfm, disparity_px)
            write_image_file(png, heat_map(disparity_px))
            if self._pictures:
                size = bgr.shape[1], bgr.shape[0]
                drawn = draw_cloud(cloud.points_xyz, bgr, size)
                write_image_file(drawing, np.hstack([bgr, drawn]))
            return write_ply(ply, cloud.points_xyz, cloud.sigma_z_m, bgr)

    def leave_out(self, stamp_ns: int, reason: Exception) -> None:
        """Note a pair that could not be reconstructed."""
        self.left_out.append({'stamp_ns': stamp_ns, 'reason': str(reason)})

    def write_summary(
        self, preset: str, config: ChainConfig, *, finished: bool, **facts: Any
    ) -> None:
        """Write ``summary.json``, unless there is an earlier run's and this one has no frame.

        Raises a FileError if it cannot be written.
        """
        path = self.folder / 'summary.json'
        if not self.frames and path.exists():
            return
        versions = {**machine_facts()['versions'], 'rosbags': version('rosbags')}
        summary = {
            'frames': self.frames,
            'left_out': self.left_out,
            'finished': finished,
            **facts,
            'source': self._source,
            'preset': preset,
            'options': dataclasses.asdict(config),
            'calibration': _calibration(self._rig) if self._rig else None,
            'versions': versions,
        }
        write_json(path, summary)
        if finished and self.frames:
            self._drop_earlier_frames()

    def _drop_earlier_frames(self) -> None:
        """Remove the frames of an earlier run that this one has not replaced."""
        for path in self.folder.iterdir():
            found = _FRAME.fullmatch(path.name)
            if found is None:
                continue
            undrawn = found[2] == '_cloud.png' and not self._pictures
            if undrawn or int(found[1]) >= len(self.frames):
                path.unlink()

    def sentence(self) -> str:
        """Return what was reconstructed, for a person."""
        if not self.frames:
            return f'no frames in {self.folder}'
        depths = [frame['depth_m'] for frame in self.frames if frame['depth_m']['min'] is not None]
        low = min((depth['min'] for depth in depths), default=math.nan)
        high = max((depth['max'] for depth in depths), default=math.nan)
        median = statistics.median([depth['median'] for depth in depths] or [math.nan])
        density = statistics.fmean(frame['density'] for frame in self.frames)
        seconds = statistics.median(frame['seconds'] for frame in self.frames)
        frames = f'{len(self.frames)} frames' if len(self.frames) > 1 else '1 frame'
        return (
            f'{frames} in {self.folder}: density {density:.1%}, depth {low:.2f} to {high:.2f} m'
            f' (median {median:.2f} m), {seconds:.2f} s per frame'
        )


def _range(depth_m: Any) -> dict[str, float | None]:
    values = depth_m[np.isfinite(depth_m)]
    if values.size == 0:
        return dict.fromkeys(('min', 'median', 'max'))
    return {
        'min': round(float(values.min()), 4),
        'median': round(float(np.median(values)), 4),
        'max': round(float(values.max()), 4),
    }


def _calibration(rig: StereoRig) -> dict[str, Any]:
    return {
        'image_size': list(rig.left.size),
        'focal_px': rig.focal_px,
        'baseline_m': rig.baseline_m,
        'disparity_offset_px': rig.disparity_offset_px,
        'left': _camera(rig.left),
        'right': _camera(rig.right),
    }


def _camera(camera: Camera) -> dict[str, Any]:
    return {
        'distortion_model': camera.distortion_model,
        **{name: getattr(camera, name).tolist() for name in ('K', 'D', 'R', 'P')},
    }
