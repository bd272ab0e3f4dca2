# SPDX-License-Identifier: Apache-2.0
"""DisparityImages as stereo_image_proc makes them (stereo_processor.cpp, processDisparity)."""

from __future__ import annotations

from typing import Any

import numpy as np

from binocular_recon.camera import StereoRig


def in_sixteenths(disparity_px: np.ndarray) -> np.ndarray:
    """Round to the steps of OpenCV's matchers; NaN stays."""
    return np.asarray(np.rint(disparity_px * 16) / 16)


def fill(message: Any, raw: np.ndarray, rig: StereoRig, limits_px: tuple[int, int]) -> None:
    """Fill a DisparityImage with raw disparities, NaN = none.

    Values and marker are shifted by cx_left - cx_right, the limits are not; the valid window is
    computed before the size is known.
    """
    sixteenths = np.where(np.isnan(raw), (limits_px[0] - 1) * 16, np.rint(np.nan_to_num(raw) * 16))
    values = sixteenths.astype(np.int16) * np.float32(1 / 16) - rig.disparity_offset_px
    image = message.image
    image.encoding, image.is_bigendian = '32FC1', 0
    image.height, image.width = raw.shape
    image.step = 4 * image.width
    image.data = values.astype(np.float32).tobytes()
    message.f, message.t = rig.focal_px, rig.baseline_m
    message.min_disparity, message.max_disparity = map(float, limits_px)
    message.delta_d = 1 / 16
    message.valid_window.width = 4294967239
