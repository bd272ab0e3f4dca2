# SPDX-License-Identifier: Apache-2.0
"""Clouds and depth images for other programs: CloudCompare, QGIS, Metashape, image viewers.

`point_table` is what every format of clouds writes, in parts, so that memory does not grow with
the cloud; `placement` moves it from the camera's frame to that of a site. `las` writes LAS and
LAZ, `e57` E57, `ply_table` PLY; `reference_system` knows coordinate reference systems. `depth`
writes depth images with their side files. Packages that only these need are imported when a file
is written.
"""

from typing import TYPE_CHECKING

from binocular_recon._lazy import lazy_exports

if TYPE_CHECKING:
    from binocular_recon.io.exports.depth import (
        DepthGeometry,
        write_depth_drawing,
        write_depth_png,
        write_depth_tiff,
    )
    from binocular_recon.io.exports.e57 import write_e57
    from binocular_recon.io.exports.las import write_las
    from binocular_recon.io.exports.placement import Placement
    from binocular_recon.io.exports.ply_table import write_ply_table
    from binocular_recon.io.exports.point_table import PointChunk, PointTable

__all__ = [
    'DepthGeometry',
    'Placement',
    'PointChunk',
    'PointTable',
    'write_depth_drawing',
    'write_depth_png',
    'write_depth_tiff',
    'write_e57',
    'write_las',
    'write_ply_table',
]

__getattr__ = lazy_exports(__name__, __file__)
