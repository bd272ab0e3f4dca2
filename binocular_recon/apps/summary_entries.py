# SPDX-License-Identifier: Apache-2.0
"""What ``summary.json`` says of frames and of the rig, written and read."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from binocular_recon.apps.frame_formats import FrameResult
from binocular_recon.camera import Camera, RigCovariance, StereoRig
from binocular_recon.errors import CalibrationError, FileError, shortened
from binocular_recon.images import FloatImage
from binocular_recon.io.text_files import number, numbers, read_json
from binocular_recon.stereo.diagnosis import Findings
from binocular_recon.stereo.point_covariance import sigma_shares
from binocular_recon.stereo.rectification import LARGEST_SIDE_PX, Rectifier
from binocular_recon.stereo.search_range import SearchRange

# What the summary says of the rig: of the first frame.
RIG_ENTRY = ('calibration', 'baseline_m', 'focal_px', 'frame', 'sigma', 'depth_searched_m')

SUMMARY = 'summary.json'
# What `merge` writes beside the cloud of several stations.
STATIONS = 'stations.json'
_SIDES, _MATRICES = ('left', 'right'), ('K', 'D', 'R', 'P')
_RIGHT_SIZE = 'right_image_size'
# A recording of 100 000 frames has 60 MB.
LARGEST = 100_000_000
# What readers take for granted, if it is there.
_KINDS = {
    'left_out': list,
    'source': dict,
    'options': dict,
    'calibration': dict,
    'frame': str,
    'progress': dict,
}


def frame_entry(frame: FrameResult, searched: SearchRange, seconds: float) -> dict[str, Any]:
    """Return what a frame by itself says; only its ``seconds`` differ from run to run."""
    points = np.isfinite(frame.points.cloud.points_xyz).all(axis=-1)
    return {
        'density': float(np.isfinite(frame.disparity_px).mean()),
        'matched': frame.filtered.measured_share,
        'disparity_px': {'min': searched.min_disparity, 'max': searched.last},
        'depth_m': _depth_range(frame.cloud.depth_m),
        'seconds': round(seconds, 4),
        'points': int(np.count_nonzero(points)),
    }


def findings_entry(findings: Findings) -> dict[str, Any]:
    """Return what is added to the entry of a frame if something is wrong with its pair."""
    entry: dict[str, Any] = {}
    if math.isfinite(findings.rows.median_px):  # enough points were found
        entry['row_offset_px'] = round(findings.rows.median_px, 3)
    if findings.warnings or findings.cause:
        entry['findings'] = [*findings.warnings, *filter(None, [findings.cause])]
    return entry


def first_rig_entry(frame: FrameResult, searched: SearchRange) -> dict[str, Any]:
    """Return the `RIG_ENTRY` of the first frame; null for a depth that is infinite."""
    rig, rectified = frame.rig, frame.rectified
    depths_m = searched.depths_m(rectified)
    values = (
        calibration_entry(rig),
        rectified.baseline_m,
        rectified.focal_px,
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
        **_right_size(rig.left, rig.right),
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
        **_right_size(known.left, known.right),
        'left': _camera(known.left),
        'right': _camera(known.right),
    }


def _right_size(left: Camera, right: Camera) -> dict[str, Any]:
    """Return the size of the right images if it is not that of the left ones."""
    return {} if left.size == right.size else {_RIGHT_SIZE: list(right.size)}


def _camera(camera: Camera) -> dict[str, Any]:
    return {
        'distortion_model': camera.distortion_model,
        **{name: getattr(camera, name).tolist() for name in _MATRICES},
    }


def read_summary(folder: Path, remedy: str) -> dict[str, Any]:
    """Return the content of the ``summary.json`` of an output folder.

    Parameters
    ----------
    folder : Path
        What `reconstruct` wrote.
    remedy : str
        What to give instead, for errors.

    Returns
    -------
    dict
        ``frames`` is a list of dicts, each with its number as ``index``.

    Raises
    ------
    FileError
        If the file cannot be read or is not such a summary; the message begins with the path.

    """
    path = folder / SUMMARY
    if (folder / STATIONS).exists() and not path.exists():
        raise FileError(
            f'{folder} holds the cloud of several stations, without images and disparities; give'
            f' the output folder of one station ({STATIONS} lists them)'
        )
    content = read_json(path, remedy, LARGEST)
    frames = content.get('frames') if isinstance(content, dict) else None
    if not isinstance(content, dict) or not isinstance(frames, list):
        raise FileError(f'{path} is not the summary of frames; {remedy}')
    options = content.get('options')
    cloud = {'options.cloud': options.get('cloud')} if isinstance(options, dict) else {}
    for name, kind in {**_KINDS, 'options.cloud': dict}.items():
        value = {**content, **cloud}.get(name)
        if value is not None and not isinstance(value, kind):
            raise FileError(
                f'{path} is damaged: {name} must be a {kind.__name__}, got {shortened(value)};'
                f' {remedy}'
            )
    for index, frame in enumerate(frames):
        if not isinstance(frame, dict) or frame.get('index') != index:
            raise FileError(f'{path} is damaged: frame {index} has another index; {remedy}')
    return content


def rig_of_entry(entry: object) -> StereoRig:
    """Return the calibration of a `calibration_entry`; raises a CalibrationError if it is none."""
    if not isinstance(entry, dict):
        raise CalibrationError('the calibration is missing')
    size = _size_of(entry, 'image_size')
    left, right = _cameras_of(entry, size)
    known = entry.get('covariance')
    if known is None:
        return StereoRig(left, right)
    if not isinstance(known, dict):
        raise CalibrationError(f'the covariance must be an object, got {shortened(known)}')
    names = known.get('parameters')
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise CalibrationError('the parameters of the covariance must be a list of names')
    matrix = numbers('covariance', known.get('matrix'), CalibrationError)
    covariance = RigCovariance(*_cameras_of(known, size), tuple(names), matrix)
    return StereoRig(left, right, covariance=covariance)


def _size_of(entry: dict[str, Any], name: str) -> tuple[int, int]:
    size = numbers(name, entry.get(name), CalibrationError)
    if size.shape != (2,) or not ((size % 1 == 0) & (size > 0) & (size <= LARGEST_SIDE_PX)).all():
        raise CalibrationError(
            f'{name} must be width and height, at most {LARGEST_SIDE_PX} px, got {size.tolist()}'
        )
    return int(size[0]), int(size[1])


def _cameras_of(entry: dict[str, Any], left_size: tuple[int, int]) -> tuple[Camera, Camera]:
    """Return both cameras of an entry; the right one has a size of its own where it says so."""
    right_size = _size_of(entry, _RIGHT_SIZE) if _RIGHT_SIZE in entry else left_size
    sizes = zip(_SIDES, (left_size, right_size), strict=True)
    left, right = (_camera_of(entry.get(side), side, *size) for side, size in sizes)
    return left, right


def rectified_rig(summary: dict[str, Any], entry: object) -> StereoRig:
    """Return the rig of the images in an output folder.

    Parameters
    ----------
    summary : dict
        What `read_summary` returned.
    entry : dict
        The `calibration_entry` of a frame.

    Raises
    ------
    CalibrationError
        If the entry is not a calibration.

    """
    rig, source = rig_of_entry(entry), summary.get('source') or {}
    if source.get('rectified'):
        return rig
    return Rectifier(rig, number('alpha', source.get('alpha', -1.0), CalibrationError)).rig


def _camera_of(entry: object, side: str, width: int, height: int) -> Camera:
    if not isinstance(entry, dict):
        raise CalibrationError(f'the {side} camera is missing')
    model = entry.get('distortion_model', 'plumb_bob')
    if not isinstance(model, str):
        raise CalibrationError(f'distortion_model must be a name, got {shortened(model)}')
    K, D, R, P = (
        numbers(f'{name} of the {side} camera', entry.get(name), CalibrationError)
        for name in _MATRICES
    )
    return Camera(width, height, K, D, R, P, model)
