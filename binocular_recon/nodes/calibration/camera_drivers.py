# SPDX-License-Identifier: Apache-2.0
"""Pass a calibration to the drivers of the cameras, which may or may not offer to take it."""

from __future__ import annotations

import threading
from typing import Any

from rclpy.node import Node
from sensor_msgs.msg import CameraInfo
from sensor_msgs.srv import SetCameraInfo
from std_msgs.msg import Header

from binocular_recon.camera import Camera, StereoRig
from binocular_recon.io.messages.camera_infos import fill_camera_info

_ANSWER_WITHIN_S = 5.0


class CameraDrivers:
    """Clients of the services ``left/set_camera_info`` and ``right/set_camera_info``.

    Parameters
    ----------
    node : Node
        Node that makes the calls; its executor must run in other threads than `send`.

    """

    def __init__(self, node: Node) -> None:
        self._clients: dict[str, Any] = {
            side: node.create_client(SetCameraInfo, f'{side}/set_camera_info')
            for side in ('left', 'right')
        }

    def send(self, rig: StereoRig) -> str:
        """Send each camera its calibration; return what became of it, for a person."""
        return '; '.join([self._send('left', rig.left), self._send('right', rig.right)])

    def _send(self, side: str, camera: Camera) -> str:
        service, client = f'{side}/set_camera_info', self._clients[side]
        if not client.service_is_ready():
            return f'no service {service}'
        request = SetCameraInfo.Request(camera_info=CameraInfo())
        fill_camera_info(request.camera_info, camera, Header())
        answered = threading.Event()
        future = client.call_async(request)
        future.add_done_callback(lambda _future: answered.set())
        if not answered.wait(_ANSWER_WITHIN_S):
            client.remove_pending_request(future)
            return f'{service} did not answer within {_ANSWER_WITHIN_S:g} s'
        answer: Any = future.result()
        reason = f': {answer.status_message}' if answer.status_message else ''
        return f'{service} {"accepted" if answer.success else "rejected"} it{reason}'
