# SPDX-License-Identifier: Apache-2.0
"""DisparityImage messages of this package and of stereo_image_proc.

A message holds d - o, where d = x_left - x_right is the raw disparity and o = cx_left - cx_right
the disparity of a point at infinity, so Z = f T / value. This package also shifts the limits and
the marker of invalid pixels; stereo_image_proc shifts the marker but not the limits.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from binocular_recon.camera import StereoRig
from binocular_recon.errors import CalibrationError, ImageError
from binocular_recon.images import FloatImage, Mask
from binocular_recon.io.messages.images import fill_image, image_samples

# stereo_image_proc computes in sixteenths; a value nearer to its marker than this is the marker.
_MARKER_TOLERANCE_PX = 1 / 32
# Relative difference that is still rounding, between f and T of a message and of the calibration.
_ROUNDING = 1e-3


class DisparityMap(NamedTuple):
    """Content of a DisparityImage.

    Attributes
    ----------
    disparity_px : (H, W) float32
        Raw disparity x_left - x_right; NaN = none.
    limits_px : (float, float)
        Smallest and largest raw disparity searched.

    """

    disparity_px: FloatImage
    limits_px: tuple[float, float]


class _Convention(NamedTuple):
    """How a sender shifts its values: the smallest valid one, and the marker below it."""

    low: float
    marker: float
    tolerance: float
    limits_px: tuple[float, float]

    def valid(self, values: FloatImage) -> Mask:
        """Tell which values are disparities; the largest lies less than 1 px above the limit."""
        low, high = self.limits_px
        inside: Mask = (values >= self.low - self.tolerance) & (
            values < self.low + (high - low) + 1
        )
        return inside & ~self.marked(values)

    def marked(self, values: FloatImage) -> Mask:
        marked: Mask = np.abs(values - np.float32(self.marker)) <= self.tolerance
        return marked


def fill_disparity(
    message: Any,
    disparity_px: FloatImage,
    rig: StereoRig,
    limits_px: tuple[float, float],
    header: Any,
    *,
    step_px: float,
) -> None:
    """Fill a DisparityImage.

    Parameters
    ----------
    message : stereo_msgs/DisparityImage
        Message to fill.
    disparity_px : (H, W) float32
        Raw disparity; NaN = none.
    rig : StereoRig
        Rectified rig.
    limits_px : (float, float)
        Smallest and largest raw disparity searched. Valid values of the message lie strictly
        inside its limits: a value at a limit moves by one float32 step.
    header : std_msgs/Header
        Header of the left image.
    step_px : float
        Sub-pixel step of the disparities.

    """
    offset = rig.disparity_offset_px
    low, high = (np.float32(limit - offset) for limit in limits_px)
    inside = (np.nextafter(low, high), np.nextafter(high, low))
    marker = low - np.float32(1)
    valid = np.isfinite(disparity_px)
    values = np.where(valid, np.clip(disparity_px - np.float32(offset), *inside), marker)
    message.header = header
    fill_image(message.image, values.astype(np.float32), '32FC1', header)
    message.f, message.t = rig.focal_px, rig.baseline_m
    message.min_disparity, message.max_disparity = float(low), float(high)
    message.delta_d = step_px
    _fill_window(message.valid_window, valid)


def read_disparity(message: Any, rig: StereoRig) -> DisparityMap:
    """Decode a DisparityImage of this package or of stereo_image_proc.

    Parameters
    ----------
    message : stereo_msgs/DisparityImage
        Message.
    rig : StereoRig
        Rectified rig that the message was made with.

    Returns
    -------
    DisparityMap
        Raw disparities.

    Raises
    ------
    ImageError
        If the image is damaged or not 32FC1, or the limits are missing or not finite.
    CalibrationError
        If ``f`` or ``t`` contradict the rig.

    """
    if message.image.encoding != '32FC1':
        raise ImageError(f'disparity has encoding {message.image.encoding!r}; it must be 32FC1')
    values = image_samples(message.image, 'disparity')
    baseline_m = message.t if hasattr(message, 't') else message.T
    for name, stated in (
        ('min_disparity', message.min_disparity),
        ('max_disparity', message.max_disparity),
        ('delta_d', message.delta_d),
        ('f', message.f),
        ('t', baseline_m),
    ):
        if not np.isfinite(stated):
            raise ImageError(
                f'disparity has {name} = {stated:g}; the sender must fill it with a finite number'
            )
    low, high = float(message.min_disparity), float(message.max_disparity)
    if not low < high:
        raise ImageError(
            f'disparity has limits {low:g}..{high:g} px; the sender must fill min_disparity and'
            ' max_disparity'
        )
    for name, stated, own in (
        ('f', message.f, rig.focal_px),
        ('t', baseline_m, rig.baseline_m),
    ):
        if not np.isclose(stated, own, rtol=_ROUNDING):
            raise CalibrationError(
                f'disparity was made with {name} = {stated:g}, the camera infos say {own:g};'
                ' use the camera infos of the rectified images (parameter camera_info) in both'
                ' nodes'
            )
    offset = rig.disparity_offset_px
    convention = _convention(values, low, high, offset)
    valid = convention.valid(values)
    # limits and values are rounded differently: move valid values inside the limits
    raw = np.clip(values + np.float32(offset), *convention.limits_px).astype(np.float32)
    raw[~valid] = np.nan
    return DisparityMap(raw, convention.limits_px)


def _convention(values: FloatImage, low: float, high: float, offset: float) -> _Convention:
    """Return the convention that explains more of the values.

    A value is explained if it is valid or the marker. Our convention explains all values of our
    messages. If that of stereo_image_proc explains as many, the message is taken to be its own if
    the limits are whole numbers and our marker does not occur.
    """
    own = _Convention(
        low, float(np.float32(low) - np.float32(1)), 0.0, (low + offset, high + offset)
    )
    other = _Convention(low - offset, low - 1 - offset, _MARKER_TOLERANCE_PX, (low, high))
    if offset == 0:
        return other
    own_marked, other_marked = own.marked(values), other.marked(values)
    own_explains = np.count_nonzero(own_marked | own.valid(values))
    other_explains = np.count_nonzero(other_marked | other.valid(values))
    if own_explains != other_explains:
        return own if own_explains > other_explains else other
    if own_marked.any() or not (low.is_integer() and high.is_integer()):
        return own
    return other if other_marked.any() or not float(offset).is_integer() else own


def _fill_window(window: Any, valid: Mask) -> None:
    """Set the smallest window that holds all valid pixels; empty if there are none."""
    rows, columns = np.flatnonzero(valid.any(axis=1)), np.flatnonzero(valid.any(axis=0))
    if rows.size:
        window.x_offset, window.y_offset = int(columns[0]), int(rows[0])
        window.width = int(columns[-1] - columns[0] + 1)
        window.height = int(rows[-1] - rows[0] + 1)
