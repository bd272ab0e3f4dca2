# SPDX-License-Identifier: Apache-2.0
"""What test_bag_to_cloud and test_demo share."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

VERTEX = np.dtype([('xyz', '<f4', 3), ('rgb', 'u1', 3), ('sigma_z', '<f4'), ('validity', '<f4')])


def read_ply(path: Path) -> Any:
    """Return the vertices of a PLY file; shares nothing with what writes it."""
    header, _, body = path.read_bytes().partition(b'end_header\n')
    vertices = np.frombuffer(body, VERTEX)
    assert f'element vertex {len(vertices)}\n'.encode() in header
    return vertices


def pixels_of(vertices: Any, output: Path) -> tuple[Any, Any]:
    """Return row and column of each vertex, by projecting it."""
    P = np.array(json.loads((output / 'summary.json').read_text())['calibration']['left']['P'])
    u, v, w = P[:, :3] @ vertices['xyz'].astype(float).T
    return np.rint(v / w).astype(int), np.rint(u / w).astype(int)
