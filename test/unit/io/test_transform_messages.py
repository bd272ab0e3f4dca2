# SPDX-License-Identifier: Apache-2.0
"""The transform of a rectified frame, through the bytes of a recording."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from binocular_recon.io.bags.reader import TopicQos
from binocular_recon.io.bags.writer import BagWriter, new_message
from binocular_recon.io.messages.transforms import fill_rotation
from binocular_recon.rotations import rotation


def turned(vector: np.ndarray, x: float, y: float, z: float, w: float) -> np.ndarray:
    """Return a vector turned by a quaternion, q v q*, written out."""
    axis = np.array([x, y, z])
    doubled = 2 * np.cross(axis, vector)
    return vector + w * doubled + np.cross(axis, doubled)


@pytest.mark.parametrize('turn', [(0, 0, 0), (0.004, 0.01, -0.004), (2.0, -1.5, 0.7)])
def test_a_point_of_the_rectified_frame_is_that_of_the_camera(
    tmp_path: Path, turn: tuple[float, float, float]
) -> None:
    """As tf2 reads it: the transform takes points of the child frame to the parent frame."""
    R = rotation(np.array(turn, float))
    message = new_message('tf2_msgs/msg/TFMessage')
    transform = new_message('geometry_msgs/msg/TransformStamped')
    header = new_message('std_msgs/msg/Header')
    header.frame_id = 'left_optical'
    fill_rotation(transform, R, header, 'left_optical_rectified')
    message.transforms = [transform]
    with BagWriter(tmp_path / 'bag') as writer:
        writer.write('/tf_static', message, 5, TopicQos(transient_local=True))
    with AnyReader([tmp_path / 'bag']) as bag:
        ((connection, _, data),) = bag.messages()
        recorded: Any = bag.deserialize(data, connection.msgtype)
    (read,) = recorded.transforms
    assert (read.header.frame_id, read.child_frame_id) == (
        'left_optical',
        'left_optical_rectified',
    )
    shift, q = read.transform.translation, read.transform.rotation
    assert (shift.x, shift.y, shift.z) == (0, 0, 0)
    in_camera = np.array([1.0, -2.0, 15.0])
    in_rectified = R @ in_camera
    np.testing.assert_allclose(turned(in_rectified, q.x, q.y, q.z, q.w), in_camera, atol=1e-9)
