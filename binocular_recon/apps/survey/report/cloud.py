# SPDX-License-Identifier: Apache-2.0
"""The section with the interactive cloud: points of the PLY file, thinned to the room there is."""

from __future__ import annotations

from html import escape

import numpy as np
import numpy.typing as npt

from binocular_recon.apps.survey.report.images import jpeg
from binocular_recon.apps.survey.report.sources import ReportSources, text
from binocular_recon.camera import FloatArray
from binocular_recon.drawing.cloud_view import BYTES_PER_POINT, ViewedCloud, cloud_view
from binocular_recon.drawing.clouds import draw_cloud
from binocular_recon.drawing.page import section
from binocular_recon.errors import ConfigError
from binocular_recon.io.exports.placement import Placement, read_placement
from binocular_recon.io.exports.point_table import PointTable
from binocular_recon.measurement.frame import MeasuredFrame
from binocular_recon.measurement.site.tie import TIE_FILE
from binocular_recon.stereo.validity import Validity

# More points make the page slow, and hardly better to look at.
_MOST_POINTS = 300_000
_LEAST_POINTS = 1000
_STILL_PX = 1500, 844
# Axes of the rectified left camera turned so that the third is up.
_CAMERA_DISPLAY = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])


def cloud(sources: ReportSources, number: int, frame: MeasuredFrame, room: int) -> str:
    """Return the section; the points take at most ``room`` bytes.

    Raises
    ------
    ConfigError
        If there is room for a few points only.
    FileError
        If the cloud cannot be read.

    """
    still = jpeg(draw_cloud(frame.points_xyz.astype(np.float32), frame.left_bgr, _STILL_PX))
    most = min(_MOST_POINTS, (room - len(still) * 4 // 3) // BYTES_PER_POINT)
    if most < _LEAST_POINTS:
        raise ConfigError(
            f'there is no room for the cloud: {room / 1e6:.1f} MB are left for it; allow a larger'
            ' file (--max-size), or show fewer frames'
        )
    path = sources.folder.folder / f'{number:06d}.ply'
    if not path.exists():
        return section('Point cloud', sources.lacks('cloud', f'{path.name} is missing'))
    tie = sources.folder.folder / TIE_FILE
    placement = read_placement(tie) if tie.exists() else None
    table = PointTable.of_file(path).placed(placement)
    if not len(table):
        return section('Point cloud', f'The cloud of frame {number} has no points.')
    viewed = _viewed(sources, table, placement, frame, most)
    step = float(viewed.step_m.max())
    shown = f'{len(viewed.xyz)} of {len(table)} points'
    caption = (
        f'{shown} of frame {number}, coordinates to {1e3 * step:.2g} mm;'
        f' {escape("; ".join(table.frame_lines))}. Standard deviations hold {text(table.shares)}.'
        '<span class="screen"> Drag to turn, Shift and drag to move, wheel to zoom, click for the'
        ' coordinates of a point.</span>'
    )
    return section(
        'Point cloud',
        'The reconstruction of the first frame shown. All its points are in the files of the'
        ' output folder.',
        cloud_view(viewed, still, caption),
    )


def _viewed(
    sources: ReportSources,
    table: PointTable,
    placement: Placement | None,
    frame: MeasuredFrame,
    most: int,
) -> ViewedCloud:
    sample = _sample(len(table), most)
    xyz, rgb, sigma, validity = [], [], [], []
    begin, first = 0, table.scalar_names[0]
    sigma_name = 'sigma_z' if 'sigma_z' in table.scalar_names else first
    for chunk in table.chunks():
        count = len(chunk.xyz)
        inside = sample[(sample >= begin) & (sample < begin + count)] - begin
        begin += count
        xyz.append(chunk.xyz[inside])
        rgb.append(chunk.rgb[inside])
        sigma.append(chunk.scalars[sigma_name][inside])
        validity.append(chunk.scalars['validity'][inside])
    eye, display = np.zeros(3), _CAMERA_DISPLAY
    names = ('x', 'y', 'z')
    if placement is not None and sources.tie is not None:
        eye = placement.points(np.zeros((1, 3)))[0]
        display = np.eye(3) if sources.tie.get('level') else _turned_display(placement.rotation)
        first, second, third = (str(name) for name in sources.tie['axes'])
        names = (first, second, third)
    pixel_rad = 1 / frame.rig.left.P[0, 0]
    thinned = frame.disparity_px.size / max(len(sample), 1)
    return ViewedCloud(
        np.concatenate(xyz),
        np.concatenate(rgb),
        np.concatenate(sigma).astype(np.float64),
        (np.concatenate(validity) & Validity.MEASURED) > 0,
        names,
        f'sigma {names[2]}' if placement is not None else sigma_name,
        display,
        eye,
        float(pixel_rad * np.sqrt(max(thinned, 1.0))),
    )


def _turned_display(rotation: FloatArray) -> FloatArray:
    """Return the turn of a site's axes that are not level to the camera's, third one up."""
    display: FloatArray = _CAMERA_DISPLAY @ rotation.T
    return display


def _sample(count: int, most: int) -> npt.NDArray[np.int64]:
    """Return which points are shown, in order: one of each of ``most`` equal runs, by lot."""
    if count <= most:
        return np.arange(count, dtype=np.int64)
    begins = np.arange(most + 1, dtype=np.int64) * count // most
    rng = np.random.default_rng(0)
    return rng.integers(begins[:-1], begins[1:])
