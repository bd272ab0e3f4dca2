# SPDX-License-Identifier: Apache-2.0
"""Clouds as PLY, also with coordinates that single precision cannot hold."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from binocular_recon.io.exports.point_table import PointTable
from binocular_recon.io.ply import SCALAR, Vertices, vertex_kind, write_vertices

# Single precision has steps of 1 mm up to here, m.
_SINGLE_M = 8192.0


def write_ply_table(path: Path, table: PointTable) -> None:
    """Write points, in double precision where single precision would lose a millimetre.

    Raises a FileError if the file cannot be written.
    """
    if table.placement is None:
        kind, parts = table.vertices.dtype, table.parts()
    else:
        low, high = table.bounds()
        large = max(np.abs(low).max(), np.abs(high).max()) > _SINGLE_M
        kind = vertex_kind(table.scalar_names, '<f8' if large else '<f4')
        parts = _parts(table, kind)
    write_vertices(path, kind, parts, len(table), table.shares, table.frame_lines)


def _parts(table: PointTable, kind: np.dtype[np.void]) -> Iterator[Vertices]:
    for chunk in table.chunks():
        vertices = np.empty(len(chunk.xyz), kind)
        vertices['x'], vertices['y'], vertices['z'] = chunk.xyz.T
        vertices['red'], vertices['green'], vertices['blue'] = chunk.rgb.T
        for name, values in chunk.scalars.items():
            vertices[f'{SCALAR}{name}'] = values
        yield vertices
