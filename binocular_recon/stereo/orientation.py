# SPDX-License-Identifier: Apache-2.0
"""Turn what belongs to a pair so that its baseline lies along the rows, and back."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from binocular_recon.camera import Camera, RigCovariance, StereoRig
from binocular_recon.images import ByteImage, Image, to_bgr8
from binocular_recon.inputs.levels import Levels
from binocular_recon.rotations import quarter_turn, turned_projection

Kind = TypeVar('Kind', bound=np.generic)
Result = TypeVar('Result')


def turn(image: npt.NDArray[Kind], turns: int) -> npt.NDArray[Kind]:
    """Return an image turned by quarter turns, counter-clockwise; itself if ``turns`` is 0."""
    return image if turns == 0 else np.ascontiguousarray(np.rot90(image, turns))


@lru_cache(maxsize=4)  # one rig serves a stream, and what is computed for it is cached by rig
def lying_rig(rig: StereoRig) -> StereoRig:
    """Return the rig of rectified images turned by its ``turns``: the baseline lies along rows."""
    turns = rig.turns
    if turns == 0:
        return rig

    def lying(camera: Camera) -> Camera:
        P = turned_projection(camera.P, turns, camera.size)
        height, width = camera.size
        return dataclasses.replace(camera, width=width, height=height, K=P[:, :3], P=P)

    known = lying_covariance(rig.covariance) if rig.covariance else None
    return StereoRig(lying(rig.left), lying(rig.right), covariance=known)


def lying_covariance(known: RigCovariance) -> RigCovariance:
    """Return a covariance whose raw cameras stay, and are rectified to turned images."""
    turns = StereoRig(known.left, known.right).turns
    if turns == 0:
        return known

    def lying(camera: Camera) -> Camera:
        P = turned_projection(camera.P, turns, known.left.size)
        return dataclasses.replace(camera, R=quarter_turn(turns) @ camera.R, P=P)

    return dataclasses.replace(known, left=lying(known.left), right=lying(known.right))


def turned_colours(
    pair: tuple[Image, Image], levels: Sequence[Levels], turns: int
) -> Callable[[], tuple[ByteImage, ByteImage]]:
    """Return a function that returns both images of a pair as (H, W, 3) BGR, turned.

    Most matchers do without: it is not made before it is asked for.
    """
    return lambda: (
        turn(to_bgr8(pair[0], levels[0]), turns),
        turn(to_bgr8(pair[1], levels[1]), turns),
    )


def turn_back(result: Result, turns: int) -> Result:
    """Return a dataclass whose images (H, W) belong to turned images, for the original ones."""
    if turns == 0:
        return result
    values: dict[str, Any] = {
        spec.name: turn(value, -turns)
        for spec in dataclasses.fields(result)  # type: ignore[arg-type]
        if isinstance(value := getattr(result, spec.name), np.ndarray)
    }
    return dataclasses.replace(result, **values)  # type: ignore[type-var]
