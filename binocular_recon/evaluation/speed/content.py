# SPDX-License-Identifier: Apache-2.0
"""What stages are timed on: the pair that ships, enlarged; a simulated site; given scenes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from binocular_recon.evaluation.accuracy.scenes import find_scenes, read_scene
from binocular_recon.evaluation.speed.synthetic import synthetic_pair
from binocular_recon.images import ByteImage, to_bgr8
from binocular_recon.io.shared_files import shared_file

# Of the simulated rig of 1920x1200 px, and the share of the width that its nearest ground needs.
_SITE_SCALE, _SITE_RANGE = 2 / 3, 272 / 1280
_SITE_SEED = 3

Pair = tuple[ByteImage, ByteImage]


@dataclass(frozen=True)
class Size:
    """Size of a benchmark.

    Attributes
    ----------
    width, height : int
        Of the images, px.
    disparity_range : int
        Number of disparities searched.

    """

    width: int
    height: int
    disparity_range: int

    @property
    def numbers(self) -> tuple[int, int, int]:
        """Width, height and disparities."""
        return self.width, self.height, self.disparity_range

    @property
    def scores(self) -> int:
        """Pixels times disparities."""
        return self.width * self.height * self.disparity_range

    def __str__(self) -> str:
        """Return the size as given on the command line."""
        return f'{self.width}x{self.height}x{self.disparity_range}'


@dataclass(frozen=True)
class Content:
    """A rectified pair of a size.

    Attributes
    ----------
    name : str
        What it shows.
    size : Size
        Of its images, and the number of disparities to search, from 0.
    pair : function
        Returns both images, (H, W, 3) uint8, BGR.
    real : bool
        False for the synthetic pair, which is easier than what cameras see.

    """

    name: str
    size: Size
    pair: Callable[[], Pair]
    real: bool = True

    def __str__(self) -> str:
        """Return name and size."""
        return f'{self.name} {self.size}'


def synthetic(size: Size) -> Content:
    """Return the synthetic pair of a size."""

    def pair() -> Pair:
        made = synthetic_pair(*size.numbers)
        return made.left, made.right

    return Content('synthetic', size, pair, real=False)


def shipped(size: Size) -> Content:
    """Return the pair that ships with the project, scaled and cut to a size.

    Its disparities are 1.3 to 8.5 % of the width: each of `benchmark.SIZES` holds them. Making it
    raises a FileError if the pair is not installed.
    """

    def pair() -> Pair:
        # here, so that who measures nothing needs no bags
        from binocular_recon.io.bags.reader import Bag
        from binocular_recon.io.bags.stereo_bag import StereoBag
        from binocular_recon.io.bags.stereo_topics import find_stereo_topics

        with Bag(shared_file('bags/motorcycle')) as bag:
            images = next(iter(StereoBag(bag, find_stereo_topics(bag.topics)))).images()
        return _scaled(images[0], size), _scaled(images[1], size)

    return Content('motorcycle', size, pair)


def site(scale: float | None = None) -> Content:
    """Return the rectified images of a simulated site at 4 to 20 m."""
    from binocular_recon.simulation import survey_rig

    raw = survey_rig(scale or _SITE_SCALE)
    rig = raw.stereo_rig()

    def pair() -> Pair:
        from binocular_recon.simulation import build_scene, render_scene
        from binocular_recon.simulation.render import Sensor
        from binocular_recon.stereo import Rectifier

        random = np.random.default_rng(_SITE_SEED)
        scene = build_scene(random)
        left, right = (render_scene(scene, view, Sensor(), random) for view in raw.views())
        return Rectifier(rig)(left, right)

    width, height = rig.left.size
    return Content('site', Size(width, height, _sixteens(_SITE_RANGE * width)), pair)


def scenes(folder: Path) -> list[Content]:
    """Return the scenes of a folder as `evaluate` takes them, each at its own size.

    Raises
    ------
    FileError
        If there are none, or one is incomplete or damaged.
    ImageError
        If sizes of a scene differ.

    """
    return [_scene(path) for path in find_scenes(folder)]


def _scene(path: Path) -> Content:
    scene = read_scene(path)
    images = to_bgr8(scene.left), to_bgr8(scene.right)
    height, width = images[0].shape[:2]
    return Content(
        scene.name, Size(width, height, _sixteens(scene.max_disparity_px)), lambda: images
    )


def default_contents(sizes: Sequence[Size]) -> list[Content]:
    """Return the pair that ships at each size, the site, and one synthetic pair."""
    return [*map(shipped, sizes), site(), synthetic(sizes[len(sizes) // 2])]


def _sixteens(disparities: float) -> int:
    """Return a number of disparities that OpenCV's matchers take."""
    return -(-int(np.ceil(disparities)) // 16) * 16


def _scaled(image: ByteImage, size: Size) -> ByteImage:
    """Return an image that fills a size, its rows cut alike at both edges."""
    height, width = image.shape[:2]
    scale = max(size.width / width, size.height / height)
    whole = cv2.resize(
        image,
        (max(size.width, round(scale * width)), max(size.height, round(scale * height))),
        interpolation=cv2.INTER_CUBIC if scale > 1 else cv2.INTER_AREA,
    )
    top, edge = (whole.shape[0] - size.height) // 2, (whole.shape[1] - size.width) // 2
    return np.ascontiguousarray(whole[top : top + size.height, edge : edge + size.width])
