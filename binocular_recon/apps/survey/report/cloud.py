# SPDX-License-Identifier: Apache-2.0
"""The section with the interactive cloud: points of the PLY file, thinned to the room there is."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from binocular_recon.apps.survey.report.images import jpeg
from binocular_recon.apps.survey.report.sources import ReportSources, text
from binocular_recon.camera import FloatArray
from binocular_recon.drawing.cloud_view import BYTES_PER_POINT, ViewedCloud, cloud_view
from binocular_recon.drawing.clouds import draw_cloud, draw_points
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
    """Return the section of a frame; points and image take at most ``room`` bytes.

    Raises
    ------
    ConfigError
        If there is room for a few points only.
    FileError
        If the cloud cannot be read.

    """
    still = jpeg(draw_cloud(frame.points_xyz.astype(np.float32), frame.left_bgr, _STILL_PX))
    most = _most_points(room, still)
    path = sources.folder.folder / f'{number:06d}.ply'
    if not path.exists():
        return section('Point cloud', sources.lacks('cloud', f'{path.name} is missing'))
    tie = sources.folder.folder / TIE_FILE
    placement = read_placement(tie) if tie.exists() else None
    table = PointTable.of_file(path).placed(placement)
    if not len(table):
        return section('Point cloud', f'The cloud of frame {number} has no points.')
    seen = Seen()
    if placement is not None and sources.tie is not None:
        seen = Seen.of(placement, sources.tie['axes'], level=bool(sources.tie.get('level')))
    gap_rad = float(1 / frame.rig.left.P[0, 0])
    viewed = thinned(table, seen, most, gap_rad, frame.disparity_px.size)
    return _section(viewed, table, still, f'frame {number}',
                    'The reconstruction of the first frame shown.')  # fmt: skip


def cloud_of_stations(table: PointTable, seen: Seen, voxel_m: float, room: int) -> str:
    """Return the section of the cloud of several stations; raises as `cloud`."""
    if not len(table):
        return section('Point cloud', 'The cloud has no points.')
    # all that is drawn is within the thinned cloud
    many = thinned(table, seen, _MOST_POINTS, 1.0)
    # in the axes of the first camera, whose view is that of the image
    points = (many.xyz - seen.eye) @ (_CAMERA_DISPLAY.T @ seen.display).T
    shares = len(table) / len(many.xyz)
    gaps = np.full(len(points), voxel_m * np.sqrt(shares), np.float32)
    bgr = np.ascontiguousarray(many.rgb[:, ::-1])
    still = jpeg(draw_points(points.astype(np.float32), bgr, gaps, _STILL_PX))
    most = _most_points(room, still)
    middle_m = float(np.median(np.linalg.norm(many.xyz - seen.eye, axis=1)))
    viewed = thinned(table, seen, most, voxel_m / max(middle_m, voxel_m))
    return _section(viewed, table, still, 'all stations', 'The clouds of all stations.')


class Seen(NamedTuple):
    """From where a cloud is seen: fields as those of `ViewedCloud`."""

    names: tuple[str, str, str] = ('x', 'y', 'z')
    sigma_name: str = 'sigma_z'
    display: FloatArray = _CAMERA_DISPLAY
    eye: FloatArray = np.zeros(3)

    @classmethod
    def of(cls, placement: Placement, axes: Sequence[object], *, level: bool) -> Seen:
        """Return the view of a cloud in the frame of a site, from the camera that is placed."""
        first, second, third = (str(name) for name in axes)
        display = np.eye(3) if level else _turned_display(placement.rotation)
        eye = placement.points(np.zeros((1, 3)))[0]
        return cls((first, second, third), f'sigma {third}', display, eye)


def _most_points(room: int, still: bytes) -> int:
    most = min(_MOST_POINTS, (room - len(still) * 4 // 3) // BYTES_PER_POINT)
    if most < _LEAST_POINTS:
        raise ConfigError(
            f'there is no room for the cloud: {room / 1e6:.1f} MB are left for it; allow a larger'
            ' file (--max-size), or show fewer frames'
        )
    return most


def _section(viewed: ViewedCloud, table: PointTable, still: bytes, what: str, words: str) -> str:
    step = float(viewed.step_m.max())
    caption = (
        f'{len(viewed.xyz)} of {len(table)} points of {what}, coordinates to {1e3 * step:.2g} mm;'
        f' {escape("; ".join(table.frame_lines))}. Standard deviations hold {text(table.shares)}.'
        '<span class="screen"> Drag to turn, Shift and drag to move, wheel to zoom, click for the'
        ' coordinates of a point.</span>'
    )
    return section(
        'Point cloud',
        f'{words} All its points are in the files of the output folder.',
        cloud_view(viewed, still, caption),
    )


def thinned(
    table: PointTable, seen: Seen, most: int, gap_rad: float, all_pixels: int = 0
) -> ViewedCloud:
    """Return at most ``most`` points of a cloud.

    ``gap_rad`` is the angle between neighbours, if all of ``all_pixels`` or of the table's points
    were shown.
    """
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
    shares = max((all_pixels or len(table)) / len(sample), 1.0)
    return ViewedCloud(
        np.concatenate(xyz),
        np.concatenate(rgb),
        np.concatenate(sigma).astype(np.float64),
        (np.concatenate(validity) & Validity.MEASURED) > 0,
        seen.names,
        seen.sigma_name,
        seen.display,
        seen.eye,
        float(gap_rad * np.sqrt(shares)),
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
