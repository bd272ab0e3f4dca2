# SPDX-License-Identifier: Apache-2.0
"""Fill TransformStamped messages: where a rectified frame lies."""

from __future__ import annotations

from typing import Any

from binocular_recon.camera import FloatArray
from binocular_recon.rotations import quaternion


def fill_rotation(message: Any, R: FloatArray, header: Any, child_frame: str) -> None:
    """Fill the transform from a camera's frame to its rectified frame, which has the same origin.

    Parameters
    ----------
    message : geometry_msgs/TransformStamped
        Message to fill.
    R : (3, 3) float64
        ``x_rectified = R x_camera``, as in a CameraInfo.
    header : std_msgs/Header
        With the frame of the camera, the parent.
    child_frame : str
        Name of the rectified frame.

    Notes
    -----
    A transform of tf2 takes points of the child frame to the parent frame, so its rotation is the
    inverse of R.

    """
    message.header = header
    message.child_frame_id = child_frame
    rotation = message.transform.rotation
    rotation.x, rotation.y, rotation.z, rotation.w = map(float, quaternion(R.T))
