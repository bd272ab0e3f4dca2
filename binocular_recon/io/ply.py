# SPDX-License-Identifier: Apache-2.0
"""Point clouds as PLY files: binary little endian, valid points only."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from binocular_recon.errors import FileError, shortened
from binocular_recon.io.files import complete_file
from binocular_recon.io.text_files import open_file
from binocular_recon.stereo.point_covariance import sigma_shares
from binocular_recon.stereo.triangulation import Cloud

Vertices = npt.NDArray[np.void]

_COLOUR = [('red', 'u1'), ('green', 'u1'), ('blue', 'u1')]
# CloudCompare takes only such names for scalar fields by itself
SCALAR = 'scalar_'
_PLY_TYPE = {'<f4': 'float', '<f8': 'double', '|u1': 'uchar'}
_KINDS = {name: kind for kind, name in _PLY_TYPE.items()}
CAMERA_FRAME = 'left rectified optical frame: x right, y down, z forward, metres'
_COUNT = f'{SCALAR}count'
# Scalars that every cloud has.
_LEAST = ('sigma_z', 'validity')
_FIRST = ['ply', 'format binary_little_endian 1.0']
# A header has less than 1 kB.
_HEADER_LIMIT = 1 << 16


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
    vertices = vertices_of(cloud, validity, bgr)
    lines = frame_lines(frame)
    write_vertices(
        path, vertices.dtype, [vertices], len(vertices), sigma_shares(cloud.calibrated), lines
    )
    return len(vertices)


def frame_lines(frame: str) -> list[str]:
    """Return what the frame of a cloud is, and how it lies to that of the camera."""
    return [CAMERA_FRAME, *([f'this frame is {frame}'] if frame else [])]


def vertices_of(
    cloud: Cloud,
    validity: npt.NDArray[np.uint8],
    bgr: npt.NDArray[np.uint8],
    count: npt.NDArray[np.uint16] | None = None,
) -> Vertices:
    """Return the valid points of a cloud as the vertices of a file.

    Arguments are those of `write_ply`, and the number of frames that points rest on, (H, W).
    """
    valid = np.isfinite(cloud.points_xyz).all(axis=-1)
    points = cloud.points_xyz[valid]
    scalars: dict[str, npt.NDArray[Any]] = {**cloud.sigmas_m, 'validity': validity}
    if count is not None:
        scalars['count'] = count
    vertices = np.empty(len(points), vertex_kind(scalars))
    vertices['x'], vertices['y'], vertices['z'] = points.T
    vertices['blue'], vertices['green'], vertices['red'] = bgr[valid].T
    for name, values in scalars.items():
        vertices[f'{SCALAR}{name}'] = values[valid]
    return vertices


def vertex_kind(scalars: Iterable[str], coordinate: str = '<f4') -> np.dtype[np.void]:
    """Return the layout of vertices with these scalar fields."""
    place = [(name, coordinate) for name in 'xyz']
    return np.dtype([*place, *_COLOUR, *((f'{SCALAR}{name}', '<f4') for name in scalars)])


def write_vertices(
    path: Path,
    kind: np.dtype[np.void],
    parts: Iterable[Vertices],
    count: int,
    shares: str,
    frame: Sequence[str],
) -> None:
    """Write vertices, given in parts of one layout.

    Parameters
    ----------
    path : Path
        File to write; its folder must exist.
    kind : structured dtype
        Their layout, as `vertex_kind` returns it.
    parts : iterable of (n,) structured
    count : int
        Number of all vertices.
    shares : str
        What their standard deviations hold.
    frame : sequence of str
        What their frame is, for comments.

    Raises
    ------
    FileError
        If the file cannot be written.

    """
    with complete_file(path) as file:
        file.write(_header(kind, count, shares, frame))
        for vertices in parts:
            file.write(vertices.data)


def _header(kind: np.dtype[np.void], count: int, shares: str, frame: Sequence[str]) -> bytes:
    names = kind.names or ()
    properties = [f'property {_PLY_TYPE[kind[name].str]} {name}' for name in names]
    sigmas = [name for name in names if name.startswith(f'{SCALAR}sigma')]
    lines = [
        *_FIRST,
        *(f'comment {text}' for text in frame),
        f'comment {", ".join(sigmas)}: one standard deviation, metres',
        f'comment standard deviations hold the share of {shares}',
        'comment scalar_validity: 1 measured, 2 filled between measured pixels',
        *([f'comment {_COUNT}: number of averaged images or stations'] if _COUNT in names else []),
        f'element vertex {count}',
        *properties,
        'end_header\n',
    ]
    return '\n'.join(lines).encode()


@dataclass(frozen=True)
class StoredVertices:
    """Vertices that stay in their file until a part of them is asked for.

    Attributes
    ----------
    path : Path
    dtype : structured
        Their layout.
    count : int
    offset : int
        Where they begin in the file, bytes.

    """

    path: Path
    dtype: np.dtype[np.void]
    count: int
    offset: int

    def __len__(self) -> int:
        """Return the number of vertices."""
        return self.count

    def __getitem__(self, part: slice) -> Vertices:
        """Return a part of them; raises a FileError if it cannot be read."""
        begin, end, _ = part.indices(self.count)
        offset = self.offset + begin * self.dtype.itemsize
        try:
            with open_file(self.path) as file:
                file.seek(offset)
                data = file.read((end - begin) * self.dtype.itemsize)
            return np.frombuffer(data, self.dtype, end - begin)
        except (OSError, ValueError) as error:  # it has changed meanwhile
            raise FileError(f'{self.path} cannot be read: {shortened(error)}') from error


def read_ply(path: Path) -> tuple[StoredVertices, list[str]]:
    """Return the vertices of a file that `write_ply` wrote, and its comments.

    Raises
    ------
    FileError
        If the file cannot be read or has another layout.

    """
    try:
        with open_file(path) as file:
            head, end, _ = file.read(_HEADER_LIMIT).partition(b'end_header\n')
        lines = head.decode('ascii', errors='replace').splitlines()
        comments = [line.removeprefix('comment ') for line in lines if line.startswith('comment ')]
        fields = [line.split() for line in lines if line.startswith(('element', 'property'))]
        if lines[:2] != _FIRST or not end or fields[0][:2] != ['element', 'vertex']:
            raise ValueError('no binary little-endian PLY of vertices')
        count = int(fields[0][2])
        kind = np.dtype([(name, _KINDS[form]) for _, form, name in fields[1:]])
        if not set(vertex_kind(_LEAST).names or ()) <= set(kind.names or ()):
            raise ValueError('coordinates, colour, sigma_z or validity are missing')
        if path.stat().st_size != len(head + end) + count * kind.itemsize:
            raise ValueError('its size is not that of its points')
    except OSError as error:
        raise FileError(f'{path} cannot be read: {error.strerror}; reconstruct again') from error
    except (ValueError, LookupError) as error:
        raise FileError(
            f'{path} is not a cloud of this program ({shortened(error)}); reconstruct again'
        ) from error
    return StoredVertices(path, kind, count, len(head + end)), comments
