# SPDX-License-Identifier: Apache-2.0
"""Frames of rectified images: their names, transforms, and what is said."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest

from binocular_recon.camera import Camera
from binocular_recon.rotations import rotation

pytestmark = pytest.mark.ros

K = np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]])
# 0.65 degrees move a point 15 m away by 170 mm
ANGLE = np.deg2rad(0.65)


def camera(turn: tuple[float, float, float]) -> Camera:
    R, P = rotation(np.array(turn)), np.hstack([K, np.zeros((3, 1))])
    return Camera(640, 480, K, np.zeros(5), R, P)


def frames(monkeypatch: pytest.MonkeyPatch, suffix: str, message_type: Any) -> tuple[Any, Mock]:
    """Return the frames of a node of which nothing is real, and the node."""
    from binocular_recon.nodes.runtime import rectified_frames

    monkeypatch.setattr(rectified_frames, 'TFMessage', message_type)
    node = Mock()
    return rectified_frames.RectifiedFrames(node, suffix), node


def stamp() -> Any:
    from builtin_interfaces.msg import Time

    return Time(sec=7)


def test_transforms_are_published_once_and_again_when_they_change(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    from rclpy.qos import DurabilityPolicy

    own, node = frames(monkeypatch, '_rectified', SimpleNamespace)
    assert own.name('left') == 'left_rectified' and own.name('') == ''
    (_, topic, qos), _ = node.create_publisher.call_args
    assert (topic, qos.durability) == ('/tf_static', DurabilityPolicy.TRANSIENT_LOCAL)
    publish = node.create_publisher.return_value.publish
    cameras = {'left': camera((0, ANGLE, 0)), 'right': camera((0, 0, 0))}
    for _ in range(3):
        own.update(cameras, stamp())
    assert publish.call_count == 1
    left, right = publish.call_args.args[0].transforms
    names = [(one.header.frame_id, one.child_frame_id) for one in (left, right)]
    assert names == [('left', 'left_rectified'), ('right', 'right_rectified')]
    assert left.header.stamp.sec == 7
    # the inverse of R
    assert left.transform.rotation.y == pytest.approx(-np.sin(ANGLE / 2))
    assert right.transform.rotation.w == 1.0
    own.update({**cameras, 'left': camera((0, 2 * ANGLE, 0))}, stamp())
    own.update({'': camera((0, ANGLE, 0))}, stamp())
    assert publish.call_count == 2  # a frame without a name has no transform


def test_without_the_message_type_the_command_to_run_is_said_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    own, node = frames(monkeypatch, '_rectified', None)
    for _ in range(3):
        own.update({'left': camera((0, ANGLE, 0))}, stamp())
    node.create_publisher.assert_not_called()
    (((text,), _),) = node.get_logger().warning.call_args_list
    assert 'from left to left_rectified is not published, because tf2_msgs is not' in text
    assert '--qx 0.000000000 --qy -0.005672290 --qz 0.000000000 --qw 0.999983912' in text
    assert text.endswith('--frame-id left --child-frame-id left_rectified')


def test_without_a_suffix_what_is_turned_is_said_with_its_size(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    own, node = frames(monkeypatch, '', SimpleNamespace)
    for _ in range(3):
        own.update({'left': camera((0, ANGLE, 0)), 'right': camera((0, 0, 0))}, stamp())
    node.create_publisher.assert_not_called()
    assert own.name('left') == 'left'
    (((text,), _),) = node.get_logger().info.call_args_list
    assert "keep the frame 'left', but the rectified frame is turned by 0.650 deg" in text
    assert '(170 mm at 15 m)' in text and 'set frame_suffix to give them frames' in text
