# SPDX-License-Identifier: Apache-2.0
"""What the cameras of a live measurement see: a real scene, the same for every contestant."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from binocular_recon.camera import StereoRig
from binocular_recon.evaluation.speed.stages import Bench, Size, recorded_image
from binocular_recon.images import ByteImage
from binocular_recon.io.shared_files import shared_file

# Frames that differ by their noise alone, grey levels of 255: a still scene, as from a camera.
FRAMES, _NOISE = 4, 2.0


@dataclass(frozen=True, eq=False)
class LiveContent:
    """Recorded pairs, and how to reconstruct them.

    Attributes
    ----------
    size : Size
        Of the images, and the number of disparities searched.
    rig : StereoRig
        Cameras with some distortion.
    left, right : (N, H, W, 3) uint8
        Pairs as the cameras record them, BGR.

    """

    size: Size
    rig: StereoRig
    left: ByteImage
    right: ByteImage

    def save(self, path: Path) -> None:
        """Write the pairs and the cameras for `nodes.live.producer`."""
        cameras = {'left': self.rig.left, 'right': self.rig.right}
        matrices = {
            f'{side}_{name}': getattr(camera, name)
            for side, camera in cameras.items()
            for name in 'KDRP'
        }
        np.savez(path, left=self.left, right=self.right, **matrices)


def motorcycle(size: Size, seed: int = 0) -> LiveContent:
    """Return the pair that ships with the project, scaled and cut to a size.

    Its disparities are 1.3 to 8.5 % of the width: each of `benchmark.SIZES` holds them.

    Raises
    ------
    FileError
        If the pair is not installed.

    """
    # here, so that who measures nothing needs no bags
    from binocular_recon.io.bags.reader import Bag
    from binocular_recon.io.bags.stereo_bag import StereoBag
    from binocular_recon.io.bags.stereo_topics import find_stereo_topics

    with Bag(shared_file('bags/motorcycle')) as bag:
        images = next(iter(StereoBag(bag, find_stereo_topics(bag.topics)))).images()
    rig = Bench(size, []).rig
    random = np.random.default_rng(seed)
    frames = []
    for image, camera in zip(images, (rig.left, rig.right), strict=True):
        recorded = recorded_image(_scaled(image, size), camera)
        noise = random.normal(0, _NOISE, (FRAMES, *recorded.shape))
        frames.append(np.clip(np.rint(recorded + noise), 0, 255).astype(np.uint8))
    return LiveContent(size, rig, frames[0], frames[1])


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
