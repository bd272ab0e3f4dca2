# SPDX-License-Identifier: Apache-2.0
"""Rod calibration by services: capture, undo, reset, calibrate, save."""

from __future__ import annotations

import functools
import traceback
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import ClassVar

from rclpy.callback_groups import ReentrantCallbackGroup
from sensor_msgs.msg import Image
from std_msgs.msg import Header
from std_srvs.srv import Trigger

from binocular_recon.apps.kernels import compile_detection
from binocular_recon.calibration.target.rods import load_rods
from binocular_recon.drawing.detections import draw_detections
from binocular_recon.errors import BinocularReconError, ConfigError
from binocular_recon.images import to_bgr8
from binocular_recon.io.calibration_yaml import read_rig
from binocular_recon.io.messages.images import fill_image, read_image
from binocular_recon.nodes.calibration.camera_drivers import CameraDrivers
from binocular_recon.nodes.calibration.newest_pair import ImagePair
from binocular_recon.nodes.calibration.services import CalibrationServices
from binocular_recon.nodes.calibration.steps import detect_pair
from binocular_recon.nodes.runtime.endpoints import Input, Output
from binocular_recon.nodes.runtime.frame_node import FrameNode
from binocular_recon.nodes.runtime.options import InputOptions, RodOptions
from binocular_recon.nodes.runtime.process import run_node

# Service calls that can run at the same time, besides the reception of images.
_THREADS = 4


class CalibrationNode(FrameNode):
    """Capture boards of rods, calibrate from them and save the result."""

    NAME = 'calibration_node'
    INPUTS = (
        Input('left/image_raw', Image, transported=True),
        Input('right/image_raw', Image, transported=True),
    )
    OUTPUTS = (Output('detections', Image),)
    SERVICES: ClassVar = {
        'capture': 'detect the rods in the newest image pair and store it as a board',
        'undo': 'drop the last board; its images move to captures/dropped/',
        'reset': 'drop all boards; their images move to captures/dropped/',
        'calibrate': 'calibrate from all boards',
        'check': 'compare a known length of the rods in the newest pair with the calibration',
        'save': 'write the calibration and send it to the cameras',
    }
    FIXED = (RodOptions, InputOptions)

    def __init__(self) -> None:
        super().__init__()
        options = self.options.of(RodOptions)
        for name in ('rods', 'output'):
            if not getattr(options, name):
                raise ConfigError(f'parameter {name} is empty; set it when the node starts')
        self._board = load_rods(Path(options.rods).expanduser())
        self._calibration = self._make_services(options)
        self._preview = self.start_worker(self._publish_detections)
        self.prepare()
        # calls run in threads of their own: none blocks another or the reception of images
        group = ReentrantCallbackGroup()
        for name in self.SERVICES:
            serve = functools.partial(self._serve, getattr(self._calibration, name))
            self.create_service(Trigger, f'~/{name}', serve, callback_group=group)
        self.start_worker(lambda _job: self._calibration.read_boards()).submit(None)
        self.start()

    @staticmethod
    def compile_kernels(presets: Sequence[str] = ()) -> None:
        """Detect some rods; no preset matters."""
        del presets
        compile_detection()

    def needed(self) -> bool:
        """Receive images all the time: a capture takes the newest pair."""
        return True

    def process(self, left: Image, right: Image) -> None:
        """Keep a pair as the newest one."""
        try:
            pair = _read_pair(left, right)
        except BinocularReconError as error:
            self._calibration.pairs.invalidate(str(error))
            raise
        self._calibration.pairs.put(pair)
        if self.wanted('detections'):
            self._preview.submit((pair, left.header))

    def _make_services(self, options: RodOptions) -> CalibrationServices:
        folder = options.calibration
        rig_in_use = read_rig(Path(folder).expanduser()) if folder else None
        if rig_in_use is not None:
            self.report_rig(rig_in_use)
            self.warn_of_rig(rig_in_use)
        return CalibrationServices(
            self._board,
            Path(options.output).expanduser(),
            (options.left_camera_name, options.right_camera_name),
            lens=options.lens,
            rig_in_use=rig_in_use,
            explain_silence=self._explain_silence,
            on_state=self.health.state,
            send_to_cameras=CameraDrivers(self).send,
            stopped=lambda: not self.context.ok(),
        )

    def _serve(
        self, service: Callable[[], str], _request: Trigger.Request, response: Trigger.Response
    ) -> Trigger.Response:
        try:
            response.message = service()
            response.success = True
        except BinocularReconError as error:
            response.message = str(error)
        except Exception:  # noqa: BLE001 - a fault in one service must not end the node
            self.health.error(traceback.format_exc())
            response.message = f'internal error: {traceback.format_exc(limit=-1)}'
        return response

    def _explain_silence(self) -> str:
        """Say why no image pairs arrive, '' while they do."""
        silent = self.health.silent()
        topics = [topic for topic in silent if topic in self._inputs]
        if topics:
            return self.health.loss() or f'no messages on {", ".join(topics)}'
        return self.explain_missing_frames() if silent else ''

    def _publish_detections(self, job: tuple[ImagePair, Header]) -> None:
        """Publish a pair with the rods found in it; runs in the preview's worker thread."""
        pair, header = job
        try:
            images = to_bgr8(pair.left), to_bgr8(pair.right)
            message = Image()
            drawing = draw_detections(images, detect_pair(pair, self._board))
            fill_image(message, drawing, 'bgr8', header)
            if self.context.ok():
                self.publish('detections', message)
        except BinocularReconError as error:
            self.health.error(str(error))


def _read_pair(left: Image, right: Image) -> ImagePair:
    return ImagePair(read_image(left, 'left image').image, read_image(right, 'right image').image)


def main() -> int:
    """Run the node."""
    return run_node(CalibrationNode, threads=_THREADS)
