# SPDX-License-Identifier: Apache-2.0
"""What test_calibration and test_calibration_refusals share."""

from __future__ import annotations

import contextlib
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from sensor_msgs.msg import CameraInfo, Image
from sensor_msgs.srv import SetCameraInfo
from std_srvs.srv import Trigger

from binocular_recon.calibration.session.calibration_files import FILES
from binocular_recon.simulation.capture import CaptureOptions, SimulatedCapture, simulate_capture
from binocular_recon.simulation.rig import survey_rig
from binocular_recon.simulation.rods import paper_board, with_placement
from test.system.graph import Graph, wait_until
from test.system.rig import header, image_message

NODE = '/rig/calibration_node'


SIDES = ('left', 'right')


IMAGES = [f'/rig/{side}/image_raw' for side in SIDES]


BOARDS = 6


# half the size of the survey rig's images, so boards stand at half the distance
RIG = survey_rig(scale=0.5)


BOARD = with_placement(paper_board(), 0.002)


@cache
def simulated(seed: int) -> SimulatedCapture:
    options = CaptureOptions(depth_m=(3.5, 8.0), noise=1.0)
    return simulate_capture(BOARD, RIG, np.random.default_rng([7, seed]), options)


class Operator:
    """Sends images as the cameras do and calls the services."""

    def __init__(self, graph: Graph) -> None:
        self._graph = graph
        self._index = 0
        self._images = {side: graph.publisher(f'/rig/{side}/image_raw', Image) for side in SIDES}

    def show(self, left: np.ndarray, right: np.ndarray) -> None:
        """Send one pair."""
        self._index += 1
        for side, image in (('left', left), ('right', right)):
            self._images[side].publish(image_message(image, header(self._index, side)))

    def call(self, service: str) -> Any:
        return self._graph.call(f'{NODE}/{service}', Trigger, Trigger.Request())

    def capture(self, left: np.ndarray, right: np.ndarray) -> Any:
        """Send a pair and capture it once the node has it."""
        before = self.received()
        for _ in range(10):  # one that was sent while a node joined may be lost
            self.show(left, right)
            with contextlib.suppress(AssertionError):
                wait_until(lambda: self.received() > before, 'the pair at the node', 3.0)
                break
        return self.call('capture')

    def received(self) -> int:
        """Return how many pairs the node has received."""
        status = self._graph.status(NODE)
        values = {pair.key: pair.value for pair in status.values} if status else {}
        return int(values.get('received sets', 0))

    def wait_for_node(self) -> None:
        """Wait until the node receives images and its diagnostics are no longer of another one."""
        self._graph.next_status(NODE)
        self._graph.wait_for_subscriber(*IMAGES)


def contents(folder: Path, names: tuple[str, ...] = FILES) -> dict[str, bytes]:
    return {name: (folder / name).read_bytes() for name in names}


class Cameras:
    """Drivers that offer set_camera_info; the right one accepts a calibration only once."""

    def __init__(self, graph: Graph) -> None:
        self._graph = graph
        self.taken: dict[str, list[CameraInfo]] = {side: [] for side in SIDES}
        self._services = [graph.do(partial(self._offer, side)) for side in SIDES]

    def close(self) -> None:
        for service in self._services:
            self._graph.do(partial(self._graph.node.destroy_service, service))

    def _offer(self, side: str) -> Any:
        def answer(request: Any, response: Any) -> Any:
            self.taken[side].append(request.camera_info)
            response.success = side == 'left' or len(self.taken[side]) == 1
            if not response.success:
                response.status_message = 'the flash is locked'
            return response

        return self._graph.node.create_service(
            SetCameraInfo, f'/rig/{side}/set_camera_info', answer
        )
