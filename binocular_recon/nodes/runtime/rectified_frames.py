# SPDX-License-Identifier: Apache-2.0
"""Publish on /tf_static how rectified frames lie to those of their cameras."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from geometry_msgs.msg import TransformStamped
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import Header

from binocular_recon.camera import Camera
from binocular_recon.io.messages.transforms import fill_rotation
from binocular_recon.stereo.rectification import frame_text, is_turned

try:
    from tf2_msgs.msg import TFMessage
except ImportError:  # there are no wheels of it
    TFMessage = None


class RectifiedFrames:
    """Names of the rectified frames of a rig, and their transforms.

    Parameters
    ----------
    node : Node
        Node that publishes them.
    suffix : str
        What the name of a rectified frame adds to that of the camera's; if empty, the rectified
        images keep the frame of the camera, and no transform is published.

    """

    def __init__(self, node: Node, suffix: str) -> None:
        self._node, self._suffix = node, suffix
        self._published: dict[str, Any] = {}
        self._publisher = None
        if suffix and TFMessage is not None:
            # as tf2_ros publishes them: who comes later gets the last message
            qos = QoSProfile(
                depth=1,
                reliability=ReliabilityPolicy.RELIABLE,
                durability=DurabilityPolicy.TRANSIENT_LOCAL,
            )
            self._publisher = node.create_publisher(TFMessage, '/tf_static', qos)

    def name(self, frame: str) -> str:
        """Return the name of the rectified frame of a camera's frame; an empty one stays empty."""
        return f'{frame}{self._suffix}' if frame else ''

    def update(self, cameras: Mapping[str, Camera], stamp: Any) -> None:
        """Publish the transforms of calibrated cameras, by frame, if they are new."""
        rotations = {frame: camera.R for frame, camera in cameras.items() if frame}
        if not rotations:
            return
        if rotations.keys() == self._published.keys() and all(
            np.array_equal(R, self._published[frame]) for frame, R in rotations.items()
        ):
            return
        self._published = rotations
        if not self._suffix:
            self._say_what_is_turned(cameras)
            return
        transforms = []
        for frame, R in rotations.items():
            transforms.append(TransformStamped())
            header = Header(stamp=stamp, frame_id=frame)
            fill_rotation(transforms[-1], R, header, self.name(frame))
        if self._publisher is None:
            self._say_what_is_missing(transforms)
        else:
            self._publisher.publish(TFMessage(transforms=transforms))

    def _say_what_is_turned(self, cameras: Mapping[str, Camera]) -> None:
        for frame, camera in cameras.items():
            if is_turned(camera):
                self._node.get_logger().info(
                    f'rectified images, disparities and clouds keep the frame {frame!r}, but the'
                    f' rectified frame is {frame_text(camera)}; set frame_suffix to give them'
                    ' frames of their own, with the transform on /tf_static'
                )

    def _say_what_is_missing(self, transforms: list[Any]) -> None:
        for one in transforms:
            turn = one.transform.rotation
            self._node.get_logger().warning(
                f'the transform from {one.header.frame_id} to {one.child_frame_id} is not'
                ' published, because tf2_msgs is not installed; install it, or run: ros2 run'
                f' tf2_ros static_transform_publisher --qx {turn.x:.9f} --qy {turn.y:.9f}'
                f' --qz {turn.z:.9f} --qw {turn.w:.9f} --frame-id {one.header.frame_id}'
                f' --child-frame-id {one.child_frame_id}'
            )
