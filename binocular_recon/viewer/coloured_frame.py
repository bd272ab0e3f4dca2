# SPDX-License-Identifier: Apache-2.0
"""A frame as it is shown: colours of its pixels, its cloud thinned, and what a ray meets."""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from binocular_recon.camera import FloatArray
from binocular_recon.drawing.colormap import heat_map
from binocular_recon.errors import MeasurementError
from binocular_recon.images import ByteImage, FloatImage, Mask
from binocular_recon.measurement.frame import MeasuredFrame
from binocular_recon.measurement.planes import normal_of
from binocular_recon.measurement.session import MeasuringSession
from binocular_recon.stereo.triangulation import triangulate
from binocular_recon.stereo.validity import Validity

# The shown cloud is thinned to about this number of points.
MOST_POINTS = 500_000
# Beyond these shares of the values, %, a colour is that of the end of the scale.
_RANGE_PERCENT = 1.0, 99.0
# How much of the image's grey shows through a colour that stands for values.
_GREY_SHARE = 0.35
# What lies outside of the crop keeps this share of its brightness.
_DIMMED = 0.25
_STOPS = 9
# A click meets a point within this angle, rad, or within this share of the gap between points.
_NEAR_RAD, _NEAR_GAPS = 0.004, 0.7
# Of the points that a click may mean, those within this share of the distance of the nearest.
_SAME_DEPTH = 0.02
# Colours of measured, filled and extrapolated pixels, BGR, that are told apart by all people.
_VALIDITY = {
    Validity.MEASURED: ((214, 156, 64), 'measured'),
    Validity.FILLED: ((52, 161, 242), 'filled between matches'),
    Validity.EXTRAPOLATED: ((130, 62, 190), 'extrapolated'),
}


class Legend(NamedTuple):
    """What the colours mean.

    Attributes
    ----------
    title : str
    low, high : str
        Values at the ends of the scale; '' if there is none.
    colours : list of str
        As ``#rrggbb``: of the scale from low to high, or one per entry.
    entries : list of str
        What each colour stands for, where there is no scale.

    """

    title: str
    low: str = ''
    high: str = ''
    colours: tuple[str, ...] = ()
    entries: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class ColouredFrame:
    """A frame with one way of colouring.

    Attributes
    ----------
    frame : MeasuredFrame
    colour : str
        A key of `COLOURS`.
    ground : (9,) float64, optional
        Three points of the ground, m; without it heights are those above the left camera.
    crop_m : (float, float)
        Only what is between these depths is shown, m.
    most_points : int
        The cloud is thinned to about this number.

    """

    frame: MeasuredFrame
    colour: str = 'image'
    ground: FloatArray | None = None
    crop_m: tuple[float, float] = (0.0, math.inf)
    most_points: int = MOST_POINTS
    _coloured: tuple[ByteImage, Legend] = field(init=False)

    def __post_init__(self) -> None:
        """Colour the pixels."""
        object.__setattr__(self, '_coloured', COLOURS[self.colour].make(self))

    @property
    def legend(self) -> Legend:
        """What the colours mean."""
        return self._coloured[1]

    @cached_property
    def image(self) -> ByteImage:
        """The left image in the colours, (H, W, 3) BGR; dark outside of the crop."""
        image = self._coloured[0]
        if self.crop_m == (0.0, math.inf):
            return image
        dark: ByteImage = (image * np.where(self.inside, 1.0, _DIMMED)[..., None]).astype(np.uint8)
        return dark

    @cached_property
    def inside(self) -> Mask:
        """Which pixels have a point within the crop, (H, W)."""
        depth_m = self.frame.points_xyz[..., 2]
        near, far = self.crop_m
        kept: Mask = (depth_m >= near) & (depth_m <= far)
        return kept

    @cached_property
    def count(self) -> int:
        """Number of points within the crop."""
        return int(np.count_nonzero(self.inside))

    @property
    def step(self) -> int:
        """Every how many rows and columns are shown in the cloud."""
        return max(1, math.ceil(math.sqrt(self.count / self.most_points)))

    @cached_property
    def cloud(self) -> tuple[npt.NDArray[np.float32], ByteImage]:
        """The points that are shown, (N, 3) float32 m, and their colours, (N, 3) RGB."""
        every = slice(None, None, self.step)
        kept = self.inside[every, every]
        points = self.frame.points_xyz[every, every][kept].astype(np.float32)
        return points, np.ascontiguousarray(self._coloured[0][every, every][kept][:, ::-1])

    @cached_property
    def gap_m(self) -> float:
        """Distance between neighbouring shown points at the median depth, m."""
        depth_m = self.frame.points_xyz[..., 2][self.inside]
        middle = float(np.median(depth_m)) if depth_m.size else 1.0
        return self.step * middle / self.frame.rig.focal_px

    def pixel_on_ray(self, origin: FloatArray, direction: FloatArray) -> FloatArray:
        """Return the pixel (2,) of the point that a ray of sight meets first.

        Parameters
        ----------
        origin, direction : (3,) float64
            Left rectified frame, m.

        Raises
        ------
        MeasurementError
            If it meets none.

        """
        rows, columns = np.nonzero(self.inside)
        points = self.frame.points_xyz[rows, columns]
        along = (points - origin) @ (direction / np.linalg.norm(direction))
        square = np.sum((points - origin) ** 2, axis=1) - along**2
        aside = np.sqrt(np.maximum(square, 0.0))
        gap = _NEAR_GAPS * self.step * points[:, 2] / self.frame.rig.focal_px
        met = np.flatnonzero((along > 0) & (aside < np.maximum(_NEAR_RAD * along, gap)))
        if not met.size:
            raise MeasurementError('the cloud has no point there; click on a point of it')
        first = met[along[met] <= (1 + _SAME_DEPTH) * along[met].min()]
        index = first[np.argmin(aside[first])]
        return np.array([columns[index], rows[index]], np.float64)


@dataclass(frozen=True)
class Shown:
    """What is shown: a frame, a key of `COLOURS`, and the cloud between two depths."""

    frame: int = 0
    colour: str = 'image'
    near_m: float = 0.0
    far_m: float = math.inf


def coloured(session: MeasuringSession, shown: Shown, most_points: int) -> ColouredFrame:
    """Return what is shown; raises a FileError or CalibrationError if it cannot be read."""
    ground = None
    with suppress(MeasurementError):
        if shown.colour == 'height':
            ground = session.ground(shown.frame).support.values
    crop_m = shown.near_m, shown.far_m
    return ColouredFrame(session.frame(shown.frame), shown.colour, ground, crop_m, most_points)


def _image(shown: ColouredFrame) -> tuple[ByteImage, Legend]:
    return shown.frame.left_bgr, Legend('left image')


def _height(shown: ColouredFrame) -> tuple[ByteImage, Legend]:
    points = shown.frame.points_xyz
    if shown.ground is None:
        return _scale(shown, -points[..., 1], 'height above the left camera (no ground found)')
    heights = (points - shown.ground[:3]) @ normal_of(shown.ground)
    return _scale(shown, heights, 'height above the ground')


def _sigma(shown: ColouredFrame) -> tuple[ByteImage, Legend]:
    frame = shown.frame
    cloud = triangulate(
        frame.disparity_px, frame.sigma_px, frame.validity, frame.rig, frame.limits
    )
    return _scale(shown, cloud.sigma_z_m, 'standard deviation of the depth')


def _validity(shown: ColouredFrame) -> tuple[ByteImage, Legend]:
    bits = shown.frame.validity
    image, entries = np.zeros((*bits.shape, 3), np.uint8), []
    for bit, (bgr, text) in _VALIDITY.items():
        image[bits & bit > 0] = bgr
        entries.append(f'{text} {np.mean(bits & bit > 0):.0%}')
    colours = tuple(_hex(bgr) for bgr, _ in _VALIDITY.values())
    image = _over_grey(image, shown.frame.left_bgr)
    return image, Legend('what was measured', colours=colours, entries=tuple(entries))


class _Colour(NamedTuple):
    """A way of colouring: its name for people, and how it is made."""

    text: str
    make: Callable[[ColouredFrame], tuple[ByteImage, Legend]]


# Every way of colouring, by the name that the page sends.
COLOURS = {
    'image': _Colour('Image', _image),
    'height': _Colour('Height', _height),
    'sigma': _Colour('Sigma', _sigma),
    'validity': _Colour('Measured', _validity),
}


def _scale(
    shown: ColouredFrame, values: FloatArray | FloatImage, title: str
) -> tuple[ByteImage, Legend]:
    """Colour values, m, from blue to red; black where there are none."""
    known = values[np.isfinite(values)]
    low, high = np.percentile(known, _RANGE_PERCENT).tolist() if known.size else (0.0, 1.0)
    image = heat_map(np.asarray(values, np.float32), (low, high))
    bar = heat_map(np.linspace(0, 1, _STOPS, dtype=np.float32)[None], (0.0, 1.0))[0]
    decimals = 2 if high - low > 1 else 3
    return _over_grey(image, shown.frame.left_bgr), Legend(
        title,
        f'{low:.{decimals}f} m',
        f'{high:.{decimals}f} m',
        tuple(_hex(bgr) for bgr in bar.tolist()),
    )


def _over_grey(colours: ByteImage, left_bgr: ByteImage) -> ByteImage:
    """Let the left image show through where there are colours."""
    grey = cv2.cvtColor(cv2.cvtColor(left_bgr, cv2.COLOR_BGR2GRAY), cv2.COLOR_GRAY2BGR)
    mixed = cv2.addWeighted(colours, 1 - _GREY_SHARE, grey, _GREY_SHARE, 0)
    return np.asarray(mixed, np.uint8)


def _hex(bgr: tuple[int, int, int] | list[int]) -> str:
    blue, green, red = bgr
    return f'#{red:02x}{green:02x}{blue:02x}'
