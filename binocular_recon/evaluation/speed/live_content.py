# SPDX-License-Identifier: Apache-2.0
"""What the cameras of a live measurement see: a real scene, the same for every contestant."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from binocular_recon.camera import StereoRig
from binocular_recon.evaluation.speed.content import Size, shipped
from binocular_recon.evaluation.speed.stages import Bench
from binocular_recon.images import ByteImage

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
    bench = Bench(shipped(size), [])
    random = np.random.default_rng(seed)
    frames = []
    for recorded in bench.recorded:
        noise = random.normal(0, _NOISE, (FRAMES, *recorded.shape))
        frames.append(np.clip(np.rint(recorded + noise), 0, 255).astype(np.uint8))
    return LiveContent(size, bench.rig, frames[0], frames[1])
