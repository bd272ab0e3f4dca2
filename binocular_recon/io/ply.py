# SPDX-License-Identifier: Apache-2.0
"""Point clouds as PLY files: binary little endian, valid points only."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

from binocular_recon.io.files import complete_file

VERTEX = np.dtype(
    [
        ('x', '<f4'),
        ('y', '<f4'),
        ('z', '<f4'),
        ('red', 'u1'),
        ('green', 'u1'),
        ('blue', 'u1'),
        # CloudCompare takes only such names for scalar fields by itself
        ('scalar_sigma_z', '<f4'),
        ('scalar_validity', '<f4'),
    ]
)
_PLY_TYPE = {'f': 'float', 'u': 'uchar'}


def write_ply(
    path: Path,
    points_xyz: npt.NDArray[np.float32],
    sigma_z_m: npt.NDArray[np.float32],
    validity: npt.NDArray[np.uint8],
    bgr: npt.NDArray[np.uint8],
) -> int:
    """Write the valid points of a cloud.

    Parameters
    ----------
    path : Path
        File to write; its folder must exist.
    points_xyz : (H, W, 3) float32
        Points in the left rectified optical frame, m; NaN = none.
    sigma_z_m : (H, W) float32
        One standard deviation of the depth, m.
    validity : (H, W) uint8
        Bits of `Validity`.
    bgr : (H, W, 3) uint8
        Colour of the points.

    Returns
    -------
    count : int
        Number of points written.

    Raises
    ------
    FileError
        If the file cannot be written.

    """
    valid = np.isfinite(points_xyz).all(axis=-1)
    points = points_xyz[valid]
    vertices = np.empty(len(points), VERTEX)
    vertices['x'], vertices['y'], vertices['z'] = points.T
    vertices['blue'], vertices['green'], vertices['red'] = bgr[valid].T
    vertices['scalar_sigma_z'] = sigma_z_m[valid]
    vertices['scalar_validity'] = validity[valid]
    with complete_file(path) as file:
        file.write(_header(len(vertices)))
        file.write(vertices.data)
    return len(vertices)


def _header(count: int) -> bytes:
    properties = [f'property {_PLY_TYPE[VERTEX[name].kind]} {name}' for name in VERTEX.names or ()]
    lines = [
        'ply',
        'format binary_little_endian 1.0',
        'comment left rectified optical frame: x right, y down, z forward, metres',
        'comment scalar_sigma_z: one standard deviation of z, metres',
        'comment scalar_validity: 1 measured, 2 filled between measured pixels',
        f'element vertex {count}',
        *properties,
        'end_header\n',
    ]
    return '\n'.join(lines).encode()
