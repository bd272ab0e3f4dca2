# SPDX-License-Identifier: Apache-2.0
"""What ``summary.json`` says of frames and of the rig."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from binocular_recon.apps.frame_formats import FrameResult
from binocular_recon.camera import Camera, RigCovariance, StereoRig
from binocular_recon.images import FloatImage
from binocular_recon.stereo.pipeline import Reconstruction
from binocular_recon.stereo.point_covariance import sigma_shares
from binocular_recon.stereo.search_range import SearchRange

# What the summary says of the rig: of the first frame.
RIG_ENTRY = ('calibration', 'baseline_m', 'focal_px', 'frame', 'sigma', 'depth_searched_m')


def frame_entry(
    index: int, stamp_ns: int | None, frame: FrameResult, seconds: float
) -> dict[str, Any]:
    """Return the entry of a frame; only its ``seconds`` differ from run to run."""
    points = np.isfinite(frame.points.cloud.points_xyz).all(axis=-1)
    return {
        'index': index,
        'stamp_ns': stamp_ns,
        'density': float(np.isfinite(frame.disparity_px).mean()),
        'matched': frame.filtered.measured_share,
        'depth_m': _depth_range(frame.cloud.depth_m),
        'seconds': round(seconds, 4),
        'points': int(np.count_nonzero(points)),
    }


def chain_entry(reconstruction: Reconstruction) -> dict[str, Any]:
    """Return what the entry of a frame says of the search range and of what is wrong."""
    searched = reconstruction.range.search
    entry: dict[str, Any] = {'disparity_px': {'min': searched.min_disparity, 'max': searched.last}}
    findings = reconstruction.findings
    if math.isfinite(findings.rows.median_px):  # enough points were found
        entry['row_offset_px'] = round(findings.rows.median_px, 3)
    if findings.warnings or findings.cause:
        entry['findings'] = [*findings.warnings, *filter(None, [findings.cause])]
    if reconstruction.range.warning:
        entry['warning'] = reconstruction.range.warning
    return entry


def first_rig_entry(frame: FrameResult, searched: SearchRange) -> dict[str, Any]:
    """Return the `RIG_ENTRY` of the first frame; null for a depth that is infinite."""
    rig = frame.rig
    depths_m = searched.depths_m(rig)
    values = (
        calibration_entry(rig),
        rig.baseline_m,
        rig.focal_px,
        frame.geometry.frame,
        sigma_shares(rig.covariance is not None),
        [depth if math.isfinite(depth) else None for depth in depths_m],
    )
    return dict(zip(RIG_ENTRY, values, strict=True))


def _depth_range(depth_m: FloatImage) -> dict[str, float | None]:
    values = depth_m[np.isfinite(depth_m)]
    if values.size == 0:
        return dict.fromkeys(('min', 'median', 'max'))
    return {
        'min': round(float(values.min()), 4),
        'median': round(float(np.median(values)), 4),
        'max': round(float(values.max()), 4),
    }


def calibration_entry(rig: StereoRig) -> dict[str, Any]:
    """Return a calibration as JSON."""
    return {
        'image_size': list(rig.left.size),
        'focal_px': rig.focal_px,
        'baseline_m': rig.baseline_m,
        'disparity_offset_px': rig.disparity_offset_px,
        'left': _camera(rig.left),
        'right': _camera(rig.right),
        'covariance': _covariance(rig.covariance),
    }


def _covariance(known: RigCovariance | None) -> dict[str, Any] | None:
    """Return what measuring needs of a calibration's covariance; None if it is not known."""
    if known is None:
        return None
    return {
        'parameters': list(known.parameters),
        'matrix': known.matrix.tolist(),
        'left': _camera(known.left),
        'right': _camera(known.right),
    }


def _camera(camera: Camera) -> dict[str, Any]:
    return {
        'distortion_model': camera.distortion_model,
        **{name: getattr(camera, name).tolist() for name in ('K', 'D', 'R', 'P')},
    }
