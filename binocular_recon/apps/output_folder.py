# SPDX-License-Identifier: Apache-2.0
"""The output folder of `reconstruct` and `demo`."""

from __future__ import annotations

import dataclasses
import math
import re
import statistics
from collections.abc import Collection
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from binocular_recon.apps.frame_formats import FRAME_FORMATS, FrameResult
from binocular_recon.camera import Camera, StereoRig
from binocular_recon.config import ChainConfig
from binocular_recon.errors import ConfigError
from binocular_recon.images import FloatImage
from binocular_recon.io.files import complete_files, make_folder, write_json
from binocular_recon.machine import machine_facts
from binocular_recon.number_text import reach
from binocular_recon.stereo.pipeline import Reconstruction
from binocular_recon.stereo.point_covariance import sigma_shares
from binocular_recon.stereo.rectification import frame_text


class ResultFolder:
    """Write the files of each frame as it is finished, and a summary at the end.

    Each frame replaces that of the same number of an earlier run; the other frames of the earlier
    run are removed when this run is complete.

    Parameters
    ----------
    folder : Path
        Made with its parents if it does not exist.
    source : dict
        Where the frames come from, for the summary.
    formats : collection of str
        Keys of `FRAME_FORMATS` to write besides those that are always written.

    Attributes
    ----------
    frames : list of dict
        Entry of each finished frame in the summary.
    left_out : list of dict
        Stamp and reason of each pair that could not be reconstructed.
    refused : list of str
        Why written frames are not reliable.
    cause : str
        Why few pixels could be matched, if that is known.

    Raises
    ------
    ConfigError
        If a format is unknown.
    FileError
        If the folder cannot be made.

    """

    def __init__(
        self, folder: Path, source: dict[str, Any], *, formats: Collection[str] = ()
    ) -> None:
        unknown = [name for name in formats if name not in FRAME_FORMATS]
        if unknown:
            raise ConfigError(
                f'frame formats must be among {", ".join(FRAME_FORMATS)}, got {unknown[0]!r}'
            )
        make_folder(folder)
        self.folder = folder
        self.frames: list[dict[str, Any]] = []
        self.left_out: list[dict[str, Any]] = []
        self.refused: list[str] = []
        self.cause = ''
        self._source = source
        self._formats = [
            spec for name, spec in FRAME_FORMATS.items() if not spec.on_request or name in formats
        ]
        self._rig: StereoRig | None = None
        self._searched_m = (0.0, math.inf)

    @property
    def matched(self) -> float:
        """Mean share of the pixels that were measured; 0 without a frame."""
        return statistics.fmean([frame['matched'] for frame in self.frames] or [0.0])

    def add(
        self, stamp_ns: int, rig: StereoRig, reconstruction: Reconstruction, seconds: float
    ) -> None:
        """Write all files of a frame or none; raises a FileError if they cannot be written."""
        index = len(self.frames)
        result = FrameResult(reconstruction, rig)
        points = np.isfinite(reconstruction.points.cloud.points_xyz).all(axis=-1)
        frame = {
            'index': index,
            'stamp_ns': stamp_ns,
            'density': float(np.isfinite(result.disparity_px).mean()),
            'matched': reconstruction.filtered.measured_share,
            'disparity_px': {
                'min': reconstruction.range.search.min_disparity,
                'max': reconstruction.range.search.last,
            },
            'depth_m': _depth_range(reconstruction.cloud.depth_m),
            'seconds': round(seconds, 4),
            'points': int(np.count_nonzero(points)),
        }
        findings = reconstruction.findings
        self.cause = self.cause or findings.cause
        if findings.rows.points:
            frame['row_offset_px'] = round(findings.rows.median_px, 3)
        if findings.warnings or findings.cause:
            frame['findings'] = [*findings.warnings, *filter(None, [findings.cause])]
        if reconstruction.range.warning:
            frame['warning'] = reconstruction.range.warning
        if self._rig is None:
            self._rig = rig
            self._searched_m = reconstruction.range.search.depths_m(rig)
        elif rig is not self._rig:
            frame['calibration'] = _calibration(rig)
        with complete_files(self.folder, lambda: self.frames.append(frame)) as parts:
            for spec in self._formats:
                spec.write_frame(parts, index, result)

    def refuse(self, reason: str) -> None:
        """Note why a written frame is not reliable."""
        self.refused.append(reason)

    def leave_out(self, stamp_ns: int, reason: Exception) -> None:
        """Note a pair that could not be reconstructed."""
        self.left_out.append({'stamp_ns': stamp_ns, 'reason': str(reason)})

    def write_summary(
        self, preset: str, config: ChainConfig, *, finished: bool, **facts: Any
    ) -> None:
        """Write ``summary.json``; raises a FileError if it cannot be written.

        A run without a finished frame leaves the summary of an earlier run as it is.
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
        if self._rig is not None:
            summary['matched'] = self.matched
            summary['baseline_m'] = self._rig.baseline_m
            summary['focal_px'] = self._rig.focal_px
            summary['frame'] = f'left rectified optical frame: {frame_text(self._rig.left)}'
            summary['sigma'] = sigma_shares(self._rig.covariance is not None)
            summary['depth_searched_m'] = [
                depth if math.isfinite(depth) else None for depth in self._searched_m
            ]
        write_json(path, summary)
        if finished and self.frames:
            self._drop_earlier_frames()

    def _drop_earlier_frames(self) -> None:
        """Remove the files of an earlier run that this run has not replaced."""
        endings = '|'.join(re.escape(spec.ending) for spec in FRAME_FORMATS.values())
        frame_file = re.compile(rf'(\d{{6,}})({endings})')
        written = {spec.ending for spec in self._formats}
        for path in self.folder.iterdir():
            found = frame_file.fullmatch(path.name)
            if found and (int(found[1]) >= len(self.frames) or found[2] not in written):
                path.unlink()

    def sentence(self) -> str:
        """Return one sentence about all frames."""
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
            f'{frames} in {self.folder}: {self.matched:.1%} of the pixels measured, {density:.1%}'
            f' with a disparity; points from {low:.2f} to {high:.2f} m (median {median:.2f} m),'
            f' {seconds:.2f} s per frame{self._scale()}'
        )

    def _scale(self) -> str:
        """Return what all depths depend on, for the sentence."""
        if self._rig is None:
            return ''
        near, far = self._searched_m
        return (
            f'; baseline {self._rig.baseline_m:.4g} m, focal length {self._rig.focal_px:.0f} px,'
            f' searched from {near:.3g} m to {reach(far)}'
        )


def _depth_range(depth_m: FloatImage) -> dict[str, float | None]:
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
