# SPDX-License-Identifier: Apache-2.0
"""Point clouds as PLY files: binary little endian, valid points only."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from binocular_recon.io.files import complete_file
from binocular_recon.stereo.point_covariance import sigma_shares
from binocular_recon.stereo.triangulation import Cloud

# before the standard deviations
_POINT = [
    ('x', '<f4'),
    ('y', '<f4'),
    ('z', '<f4'),
    ('red', 'u1'),
    ('green', 'u1'),
    ('blue', 'u1'),
]
# CloudCompare takes only such names for scalar fields by itself
_SCALAR = 'scalar_'
_PLY_TYPE = {'f': 'float', 'u': 'uchar'}


def write_ply(
    path: Path,
    cloud: Cloud,
    validity: npt.NDArray[np.uint8],
    bgr: npt.NDArray[np.uint8],
    *,
    frame: str = '',
) -> int:
    """Write the valid points of a cloud.

    Parameters
    ----------
    path : Path
        File to write; its folder must exist.
    cloud : Cloud
        Points in the left rectified optical frame, and their standard deviations, m.
    validity : (H, W) uint8
        Bits of `Validity`.
    bgr : (H, W, 3) uint8
        Colour of the points.
    frame : str
        How the frame of the points lies to that of the camera, for a comment.

    Returns
    -------
    count : int
        Number of points written.

    Raises
    ------
    FileError
        If the file cannot be written.

    """
    valid = np.isfinite(cloud.points_xyz).all(axis=-1)
    points = cloud.points_xyz[valid]
    scalars: dict[str, npt.NDArray[Any]] = {**cloud.sigmas_m, 'validity': validity}
    kind = np.dtype([*_POINT, *((f'{_SCALAR}{name}', '<f4') for name in scalars)])
    vertices = np.empty(len(points), kind)
    vertices['x'], vertices['y'], vertices['z'] = points.T
    vertices['blue'], vertices['green'], vertices['red'] = bgr[valid].T
    for name, values in scalars.items():
        vertices[f'{_SCALAR}{name}'] = values[valid]
    with complete_file(path) as file:
        file.write(_header(vertices, sigma_shares(cloud.calibrated), frame))
        file.write(vertices.data)
    return len(vertices)


def _header(vertices: npt.NDArray[np.void], shares: str, frame: str) -> bytes:
    names = vertices.dtype.names or ()
    properties = [f'property {_PLY_TYPE[vertices.dtype[name].kind]} {name}' for name in names]
    sigmas = [name for name in names if name.startswith(f'{_SCALAR}sigma')]
    lines = [
        'ply',
        'format binary_little_endian 1.0',
        'comment left rectified optical frame: x right, y down, z forward, metres',
        *([f'comment this frame is {frame}'] if frame else []),
        f'comment {", ".join(sigmas)}: one standard deviation, metres',
        f'comment standard deviations hold the share of {shares}',
        'comment scalar_validity: 1 measured, 2 filled between measured pixels',
        f'element vertex {len(vertices)}',
        *properties,
        'end_header\n',
    ]
    return '\n'.join(lines).encode()
