# SPDX-License-Identifier: Apache-2.0
"""Convert CameraInfo messages to cameras, and back."""

from __future__ import annotations

from typing import Any

import numpy as np

from binocular_recon.camera import Camera, StereoRig
from binocular_recon.errors import CalibrationError
from binocular_recon.inputs.camera_reading import camera_of_image
from binocular_recon.io.messages.images import assign_array


def camera_from_message(
    info: Any,
    name: str = 'camera',
    *,
    size: tuple[int, int] | None = None,
    rectified: bool = False,
) -> Camera:
    """Return the camera of a CameraInfo, with ROS 2's ``k`` or ROS 1's ``K``.

    Binning and region of interest are applied: the camera is that of the image as sent. They are
    not if the image has the size of the whole sensor nevertheless.

    Parameters
    ----------
    info : sensor_msgs/CameraInfo
    name : str
        Name of the camera in errors.
    size : (int, int), optional
        Width and height of the image, px, where they are known.
    rectified : bool
        Whether the image is rectified: then only P counts.

    Raises
    ------
    CalibrationError
        If the camera is not calibrated or contradicts itself; the message begins with ``name``.

    """
    K, D, R, P = (
        np.array(getattr(info, key) if hasattr(info, key) else getattr(info, key.upper()), float)
        for key in 'kdrp'
    )
    roi = info.roi
    binning = np.array([max(1, info.binning_x), max(1, info.binning_y)])
    offset = np.array([roi.x_offset, roi.y_offset])
    stated = np.array([roi.width or info.width, roi.height or info.height]) // binning
    notices = []
    if size is not None and size == (info.width, info.height) and size != tuple(stated):
        notices.append(
            f'binning and region of interest are not applied: the image has all'
            f' {size[0]}x{size[1]} px, not {stated[0]}x{stated[1]}'
        )
        binning, offset = np.ones(2, int), np.zeros(2)
    elif size is None or stated.any():
        size = int(stated[0]), int(stated[1])
    if K.size == 9 and P.size == 12:
        K, P = K.reshape(3, 3), P.reshape(3, 4)
        for matrix in (K, P):
            matrix[:2, 2] -= offset
            matrix[:2] /= binning[:, None]
    try:
        return camera_of_image(
            size, K, D, R, P, info.distortion_model, rectified=rectified, notices=tuple(notices)
        )
    except CalibrationError as error:
        raise CalibrationError(f'{name}: {error}') from error


def rig_from_messages(
    left: Any,
    right: Any,
    *,
    size: tuple[int, int] | None = None,
    right_size: tuple[int, int] | None = None,
    rectified: bool = False,
) -> StereoRig:
    """Return the rig of two CameraInfos; a CalibrationError names the camera at fault.

    ``size`` and ``rectified`` are those of `camera_from_message`; ``right_size`` is that of the
    right images, where they differ from the left ones.
    """
    cameras = (
        camera_from_message(info, f'{side} camera', size=image_size, rectified=rectified)
        for side, info, image_size in (('left', left, size), ('right', right, right_size or size))
    )
    return StereoRig(*cameras)


def states_size(info: Any) -> bool:
    """Tell whether a CameraInfo states the size of its image, without binning and region."""
    plain = max(info.binning_x, info.binning_y) <= 1 and not info.roi.width
    return bool(plain and info.width and info.height)


def calibration_content(info: Any) -> tuple[Any, ...]:
    """Return the content of a CameraInfo without its header, for comparisons."""
    roi = info.roi
    return (
        *(np.asarray(getattr(info, member)).tobytes() for member in 'kdrp'),
        *(info.width, info.height, info.distortion_model, info.binning_x, info.binning_y),
        *(roi.x_offset, roi.y_offset, roi.width, roi.height),
    )


def fill_camera_info(message: Any, camera: Camera, header: Any) -> None:
    """Fill a CameraInfo message; binning and region of interest stay zero."""
    message.header = header
    message.width, message.height = camera.size
    message.distortion_model = camera.distortion_model
    for member, values in (('d', camera.D), ('k', camera.K), ('r', camera.R), ('p', camera.P)):
        assign_array(message, member, np.asarray(values, np.float64).reshape(-1))
