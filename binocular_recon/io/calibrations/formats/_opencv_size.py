# SPDX-License-Identifier: Apache-2.0
"""The image size that OpenCV's ``stereoRectify`` was called with, from its result.

OpenCV's sample ``stereo_calib`` writes no image size. The principal points of P1 and P2 depend on
it: the distorted corners of the images are centred.
"""

from __future__ import annotations

import cv2
import numpy as np

from binocular_recon.camera import FloatArray
from binocular_recon.errors import CalibrationError
from binocular_recon.io.calibrations.raw_rig import RawCamera, relative_pose

# Principal points of the right size agree to OpenCV's single precision, those of sizes that differ
# by one pixel must differ by more, px.
_SAME_PX, _OTHER_PX = 2e-3, 6e-3
_STEPS, _MOST_PX = 30, 40000
# alpha does not move the principal point
_ALPHA = -1


def size_of_rectification(first: RawCamera, second: RawCamera) -> tuple[int, int] | None:
    """Return the size in pixels; None if P1 and P2 do not tell.

    They do not without distortion, or if another program or version made them.
    """
    if first.P is None or second.P is None or 'equidistant' in (first.lens, second.lens):
        return None
    try:
        pose = relative_pose(first, second, '')
    except CalibrationError:
        return None
    stated = np.concatenate([first.P[:2, 2], second.P[:2, 2]])
    alike = bool(np.allclose(stated[:2], stated[2:], atol=1e-6))
    flags = cv2.CALIB_ZERO_DISPARITY if alike else 0

    def centres(size: FloatArray) -> FloatArray:
        _, _, P1, P2, *_ = cv2.stereoRectify(
            first.K, first.D, second.K, second.D, (int(size[0]), int(size[1])), pose[:3, :3],
            pose[:3, 3:].copy(), flags=flags, alpha=_ALPHA,
        )  # fmt: skip
        return np.concatenate([P1[:2, 2], P2[:2, 2]])

    size = np.round(first.K[:2, 2] + second.K[:2, 2])
    try:
        for _ in range(_STEPS):
            off = stated - centres(size)
            slope = np.stack([centres(size + step) for step in np.eye(2)], axis=1)
            slope -= centres(size)[:, None]
            if np.abs(off).max() < _SAME_PX:
                clear = np.abs(slope).max(axis=0).min() > _OTHER_PX
                return (int(size[0]), int(size[1])) if clear else None
            step = np.linalg.lstsq(slope, off, rcond=None)[0]
            size = np.round(size + np.clip(step, -0.3 * size, 0.3 * size))
            if not np.isfinite(size).all() or size.min() < 8 or size.max() > _MOST_PX:
                return None
    except (cv2.error, np.linalg.LinAlgError, ValueError):
        return None
    return None
