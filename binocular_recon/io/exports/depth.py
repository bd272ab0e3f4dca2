# SPDX-License-Identifier: Apache-2.0
"""Depth images: numbers with a side file, and drawings with a colour bar in metres."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from binocular_recon.camera import FloatArray
from binocular_recon.drawing.colormap import GREY, TURBO, heat_map_with_scale
from binocular_recon.images import FloatImage
from binocular_recon.io.files import write_json
from binocular_recon.io.image_files import write_image_file

_MM_PER_M = 1000
_LARGEST_16 = 65535


@dataclass(frozen=True, eq=False)
class DepthGeometry:
    """What a depth image is of: the rectified left camera.

    Attributes
    ----------
    size : (int, int)
        Width and height, px.
    P : (3, 4) float64
        Projection of the rectified left camera, px.
    baseline_m : float
    frame : str
        What its frame is.

    """

    size: tuple[int, int]
    P: FloatArray
    baseline_m: float
    frame: str


def write_depth_tiff(path: Path, depth_m: FloatImage, geometry: DepthGeometry) -> None:
    """Write depths as 32-bit floating point, metres, NaN = none, and the side file.

    Raises a FileError if a file cannot be written.
    """
    write_image_file(path, depth_m)
    _write_side(path, geometry, {'unit': 'm', 'metres_per_unit': 1.0, 'invalid': 'nan'})


def write_depth_png(path: Path, depth_m: FloatImage, geometry: DepthGeometry) -> None:
    """Write depths as 16-bit whole millimetres, 0 = none, and the side file.

    Depths beyond 65.535 m become 0 too; the side file says how many. Raises a FileError if a file
    cannot be written.
    """
    depth_mm = np.rint(depth_m * np.float64(_MM_PER_M))
    beyond = depth_mm > _LARGEST_16
    valid = np.isfinite(depth_mm) & ~beyond
    write_image_file(path, np.where(valid, depth_mm, 0).astype(np.uint16))
    facts = {
        'unit': 'mm',
        'metres_per_unit': 1 / _MM_PER_M,
        'invalid': 0,
        'largest': _LARGEST_16,
        'beyond_largest': int(np.count_nonzero(beyond)),
    }
    _write_side(path, geometry, facts)


def write_depth_drawing(path: Path, depth_m: FloatImage, *, coloured: bool) -> None:
    """Write depths as a drawing with a bar in metres: near is red, or bright; none is black.

    Raises a FileError if it cannot be written.
    """
    colours = TURBO if coloured else GREY
    write_image_file(path, heat_map_with_scale(depth_m, 'm', colours, near_is_low=True))


def _write_side(path: Path, geometry: DepthGeometry, facts: dict[str, Any]) -> None:
    """Write the side file of a depth image: its name with the suffix .json."""
    (fx, _, cx), (_, fy, cy) = geometry.P[:2, :3].tolist()
    width, height = geometry.size
    content = {
        'content': 'depth along the optical axis (z) of the rectified left camera',
        **facts,
        'width': width,
        'height': height,
        'fx': fx,
        'fy': fy,
        'cx': cx,
        'cy': cy,
        'baseline_m': geometry.baseline_m,
        'frame': geometry.frame,
    }
    write_json(path.with_suffix('.json'), content)
