# SPDX-License-Identifier: Apache-2.0
"""How results change with the exposure of one camera and with cropping."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from binocular_recon.evaluation.accuracy.methods import Method
from binocular_recon.evaluation.accuracy.metrics import accuracy
from binocular_recon.evaluation.accuracy.scenes import TruthScene
from binocular_recon.images import FloatImage

EXPOSURE_GAIN, EXPOSURE_OFFSET = 0.6, 20.0
CROP_DEPTHS_PX = (0, 4, 8, 16, 32, 64, 128)
# Share of the image that is cropped on each side.
_CROP_SHARE = 0.15


@dataclass(frozen=True)
class ExposureChange:
    """Bad-2.0 of one method before and after the right image was made darker.

    Attributes
    ----------
    scene, method : str
        Names.
    bad_percent, changed_bad_percent : float
        Bad-2.0, all pixels with ground truth.

    """

    scene: str
    method: str
    bad_percent: float
    changed_bad_percent: float


@dataclass(frozen=True)
class CropChange:
    """Change of disparity by cropping the images, at one distance from the border.

    Attributes
    ----------
    scene, method : str
        Names.
    depth_px : int
        Least distance of the pixels from the crop's border (on the left plus the largest
        disparity: nearer pixels have lost what they match).
    largest_px, p99_px : float
        Largest and 99th percentile of the absolute change; NaN if there is no such pixel.
    appeared_percent : float
        Share of pixels filled in one of the two results only.

    """

    scene: str
    method: str
    depth_px: int
    largest_px: float
    p99_px: float
    appeared_percent: float


def darkened(
    scene: TruthScene, gain: float = EXPOSURE_GAIN, offset: float = EXPOSURE_OFFSET
) -> TruthScene:
    """Return the scene with the right image's grey levels times ``gain`` plus ``offset``.

    ``offset`` is in grey levels of 255; the result is rounded to the image's type.
    """
    white = np.iinfo(scene.right.dtype).max
    right = np.rint(scene.right * gain + offset * white / 255)
    return dataclasses.replace(scene, right=np.clip(right, 0, white).astype(scene.right.dtype))


def exposure_change(
    scene: TruthScene, method: Method, disparity_px: FloatImage | None = None
) -> ExposureChange:
    """Measure how much worse a method gets when one camera is exposed differently.

    Parameters
    ----------
    scene : TruthScene
        The scene as it is.
    method : Method
        What is measured.
    disparity_px : (H, W) float32, optional
        The method's result on the scene, if it is known already.

    """
    if disparity_px is None:
        disparity_px = method.estimate(scene).disparity_px
    changed = method.estimate(darkened(scene)).disparity_px
    before, after = (accuracy(d, scene.truth_px).bad_percent[1] for d in (disparity_px, changed))
    return ExposureChange(scene.name, method.name, before, after)


def crop_changes(
    scene: TruthScene, method: Method, disparity_px: FloatImage | None = None
) -> list[CropChange]:
    """Compare a method's result on a crop with the same part of its result on the whole.

    Parameters
    ----------
    scene : TruthScene
        The whole.
    method : Method
        What is measured.
    disparity_px : (H, W) float32, optional
        The method's result on the whole, if it is known already.

    """
    if disparity_px is None:
        disparity_px = method.estimate(scene).disparity_px
    height, width = scene.truth_px.shape
    top, left = int(height * _CROP_SHARE), int(width * _CROP_SHARE)
    cut = (slice(top, height - top), slice(left, width - left))
    search = scene.max_disparity_px
    whole = disparity_px[cut]
    part = method.prepare(scene.left[cut], scene.right[cut], search)().disparity_px
    rows, columns = part.shape
    changes = []
    for depth in CROP_DEPTHS_PX:
        inner = (slice(depth, rows - depth), slice(search + depth, columns - depth))
        if 2 * depth >= rows or search + 2 * depth >= columns:
            continue
        change = np.abs(part[inner] - whole[inner])
        both = change[np.isfinite(change)]
        appeared = np.isfinite(part[inner]) != np.isfinite(whole[inner])
        changes.append(
            CropChange(
                scene.name,
                method.name,
                depth,
                float(both.max()) if both.size else float('nan'),
                float(np.quantile(both, 0.99)) if both.size else float('nan'),
                100.0 * float(appeared.mean()),
            )
        )
    return changes
