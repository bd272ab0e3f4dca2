# SPDX-License-Identifier: Apache-2.0
"""The files of each frame: one entry of `FRAME_FORMATS` per file.

To add a format, write a function that takes the file's path and the parts of the frame it needs,
and add an entry. The output folder then writes the file for each frame and removes it with its
frame. A format whose parts are all in an output folder (`stored_frame`) can be made later, too.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from binocular_recon.camera import StereoRig
from binocular_recon.drawing.clouds import draw_cloud
from binocular_recon.drawing.colormap import heat_map_with_scale
from binocular_recon.errors import ConfigError
from binocular_recon.images import ByteImage, FloatImage, to_bgr8
from binocular_recon.io.exports.depth import (
    DepthGeometry,
    write_depth_drawing,
    write_depth_png,
    write_depth_tiff,
)
from binocular_recon.io.exports.e57 import write_e57
from binocular_recon.io.exports.las import write_las
from binocular_recon.io.exports.ply_table import write_ply_table
from binocular_recon.io.exports.point_table import PointTable
from binocular_recon.io.image_files import write_image_file
from binocular_recon.io.pfm import write_pfm
from binocular_recon.io.ply import frame_lines
from binocular_recon.machine import optional_package
from binocular_recon.stereo.filtering.wls_filter import Filtered
from binocular_recon.stereo.pipeline import Reconstruction
from binocular_recon.stereo.rectification import frame_text
from binocular_recon.stereo.thinning import PointSet
from binocular_recon.stereo.triangulation import Cloud


@dataclass(frozen=True, eq=False)
class FrameResult:
    """A frame; its attributes are the parts that a format may need.

    Attributes
    ----------
    rig : StereoRig
        Calibration of the frame.
    rectified : StereoRig
        The rig of the rectified images.
    filtered : Filtered
        Disparities, their standard deviation and validity.
    cloud : Cloud
        Points and their standard deviations, m; NaN = none.
    points : PointSet
        The points to write, with validity and colour: thinned as the options say.
    left_bgr : (H, W, 3) uint8
        The rectified left image.
    made : Reconstruction, optional
        What a chain made it of.

    """

    rig: StereoRig
    rectified: StereoRig
    filtered: Filtered
    cloud: Cloud
    points: PointSet
    left_bgr: ByteImage
    made: Reconstruction | None = None

    @classmethod
    def of(cls, made: Reconstruction, rig: StereoRig, rectified: StereoRig) -> FrameResult:
        """Return the frame that a chain reconstructed."""
        left_bgr = to_bgr8(made.left, made.levels)
        return cls(rig, rectified, made.filtered, made.cloud, made.points, left_bgr, made)

    @property
    def right_bgr(self) -> ByteImage:
        """The rectified right image, (H, W, 3) uint8, as bright as the left one's levels say."""
        assert self.made is not None  # a frame of a pair
        return to_bgr8(self.made.right, self.made.levels)

    @property
    def disparity_px(self) -> FloatImage:
        """Filtered x_left - x_right, (H, W) float32; NaN = none."""
        return self.filtered.disparity_px

    @property
    def sigma_px(self) -> FloatImage:
        """One standard deviation of the disparity, (H, W) float32; NaN = none."""
        return self.filtered.sigma_px

    @property
    def validity(self) -> ByteImage:
        """Bits of `Validity`, (H, W) uint8."""
        return self.filtered.validity

    @property
    def frame(self) -> str:
        """How the frame of the points lies to that of the left camera."""
        return frame_text(self.rig.left)

    @cached_property
    def table(self) -> PointTable:
        """The valid points, as formats of clouds take them."""
        cloud, validity, bgr, count = self.points
        assert bgr is not None  # a frame has colour
        return PointTable.of_cloud(cloud, validity, bgr, tuple(frame_lines(self.frame)), count)

    @property
    def depth_m(self) -> FloatImage:
        """Depth of each pixel that has a point, (H, W) float32, m; NaN = none."""
        return self.cloud.depth_m

    @property
    def geometry(self) -> DepthGeometry:
        """What `depth_m` is of."""
        left = self.rectified.left
        frame = f'left rectified optical frame: {self.frame}'
        return DepthGeometry(left.size, left.P, self.rig.baseline_m, frame)


class FrameFormat(NamedTuple):
    """One file of each frame.

    Attributes
    ----------
    ending : str
        What follows the number of the frame in the file's name.
    needs : tuple of str
        Attributes of `FrameResult` that ``write`` takes after the path, in this order.
    write : callable
        Writes the file; raises a FileError if it cannot be written.
    on_request : bool
        Whether the file is written only if its format is asked for by name.
    side_ending : str
        Ending of a second file that belongs to it; empty if there is none.
    packages : dict of str to str
        Optional packages that ``write`` needs, and for what.

    """

    ending: str
    needs: tuple[str, ...]
    write: Callable[..., object]
    on_request: bool = False
    side_ending: str = ''
    packages: Mapping[str, str] = MappingProxyType({})

    @property
    def endings(self) -> list[str]:
        """Endings of all files of the format."""
        return [ending for ending in (self.ending, self.side_ending) if ending]

    def write_frame(self, folder: Path, index: int, frame: Any) -> None:
        """Write the file of frame number ``index`` to ``folder``."""
        parts = (getattr(frame, name) for name in self.needs)
        self.write(folder / f'{index:06d}{self.ending}', *parts)


def _write_heat_map(path: Path, disparity_px: FloatImage) -> None:
    write_image_file(path, heat_map_with_scale(disparity_px, 'px'))


def _write_drawing(path: Path, cloud: Cloud, bgr: ByteImage) -> None:
    """Write the left image and, beside it, the cloud from an oblique view."""
    drawing = draw_cloud(cloud.points_xyz, bgr, (bgr.shape[1], bgr.shape[0]))
    write_image_file(path, np.hstack([bgr, drawing]))


_LAS, _LAZ = {'laspy': 'LAS and LAZ files'}, {'lazrs': 'LAZ files'}

# The files of each frame, by a name for each; a new format is a new entry.
FRAME_FORMATS = {
    'disparity': FrameFormat('_disparity.pfm', ('disparity_px',), write_pfm),
    'sigma': FrameFormat('_sigma.pfm', ('sigma_px',), write_pfm),
    'left': FrameFormat('_left.png', ('left_bgr',), write_image_file),
    'right': FrameFormat('_right.png', ('right_bgr',), write_image_file, on_request=True),
    'heat_map': FrameFormat('_disparity.png', ('disparity_px',), _write_heat_map),
    'validity': FrameFormat('_validity.png', ('validity',), write_image_file),
    'ply': FrameFormat('.ply', ('table',), write_ply_table),
    'drawing': FrameFormat('_cloud.png', ('cloud', 'left_bgr'), _write_drawing, on_request=True),
    'las': FrameFormat('.las', ('table',), write_las, True, packages=_LAS),
    'laz': FrameFormat('.laz', ('table',), write_las, True, packages=_LAS | _LAZ),
    'e57': FrameFormat('.e57', ('table',), write_e57, True, packages={'pye57': 'E57 files'}),
    'tiff': FrameFormat(
        '_depth.tiff', ('depth_m', 'geometry'), write_depth_tiff, True, '_depth.json'
    ),
    'png': FrameFormat(
        '_depth_mm.png', ('depth_m', 'geometry'), write_depth_png, True, '_depth_mm.json'
    ),
    'grey': FrameFormat(
        '_depth_grey.png', ('depth_m',), partial(write_depth_drawing, coloured=False), True
    ),
    'colour': FrameFormat(
        '_depth_colour.png', ('depth_m',), partial(write_depth_drawing, coloured=True), True
    ),
}


def formats_named(names: Collection[str]) -> dict[str, FrameFormat]:
    """Return formats by their names, once all that they need is there.

    Raises
    ------
    ConfigError
        If a format is unknown.
    DependencyError
        If a package is not installed that one needs.

    """
    for name in names:
        if name not in FRAME_FORMATS:
            raise ConfigError(
                f'frame formats must be among {", ".join(FRAME_FORMATS)}, got {name!r}'
            )
        for package, purpose in FRAME_FORMATS[name].packages.items():
            optional_package(package, purpose)
    return {name: spec for name, spec in FRAME_FORMATS.items() if name in names}
