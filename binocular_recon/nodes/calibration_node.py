# SPDX-License-Identifier: Apache-2.0
"""Rod calibration by services: capture, undo, reset, calibrate, save."""

from __future__ import annotations

import functools
import threading
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from rclpy.callback_groups import ReentrantCallbackGroup
from sensor_msgs.msg import CameraInfo, Image
from sensor_msgs.srv import SetCameraInfo
from std_msgs.msg import Header
from std_srvs.srv import Trigger

from binocular_recon.calibration.result import CalibrationResult
from binocular_recon.calibration.screening import complaint
from binocular_recon.calibration.session.calibration_files import finish_saving, save_calibration
from binocular_recon.calibration.session.capture_store import CaptureStore
from binocular_recon.calibration.solve import calibrate
from binocular_recon.calibration.target.capture import Capture
from binocular_recon.calibration.target.rods import load_rods
from binocular_recon.calibration.target.target import Target
from binocular_recon.camera import Camera
from binocular_recon.drawing.detections import draw_detections
from binocular_recon.errors import BinocularReconError, CalibrationError, ConfigError, ImageError
from binocular_recon.images import to_bgr8
from binocular_recon.io.calibration_yaml import read_rig
from binocular_recon.io.messages.camera_infos import fill_camera_info
from binocular_recon.io.messages.images import fill_image, read_image
from binocular_recon.nodes.calibration_steps import (
    Alone,
    check_still,
    compile_kernels,
    detect_pair,
    missing_words,
    row_words,
    size_words,
    summary,
)
from binocular_recon.nodes.newest_pair import ImagePair, NewestPair
from binocular_recon.nodes.runtime.base_node import StereoNode
from binocular_recon.nodes.runtime.endpoints import Input, Output
from binocular_recon.nodes.runtime.options import InputOptions
from binocular_recon.nodes.runtime.process import run_node
from binocular_recon.options import Options, option

# How long a capture waits for a second pair, to see whether everything stands still.
_STILL_WITHIN_S = 1.0
_SET_CAMERA_INFO_WITHIN_S = 5.0
# Calls that can be under way at once, besides the reception of pictures.
_THREADS = 4


@dataclass(frozen=True)
class RodOptions(Options):
    """What is captured and where it goes."""

    rods: str = option('', 'File rods.yaml that describes the rods')
    output: str = option('', 'Folder of the calibration; captures are kept in captures/ under it')
    left_camera_name: str = option('left', 'Name of the left camera in its calibration')
    right_camera_name: str = option('right', 'Name of the right camera in its calibration')
    calibration: str = option(
        '',
        'Folder with left.yaml and right.yaml; captures tell by how much it misses the rows of'
        ' their marks. Empty: they do not',
    )


class CalibrationNode(StereoNode):
    """Capture boards of rods, calibrate from them and save the result."""

    NAME = 'calibration_node'
    INPUTS = (
        Input('left/image_raw', Image, transported=True),
        Input('right/image_raw', Image, transported=True),
    )
    OUTPUTS = (Output('detections', Image),)
    SERVICES: ClassVar = {
        'capture': 'find the rods in the newest pair and store it',
        'undo': 'drop the last board; its pictures go to captures/dropped/',
        'reset': 'drop all boards; their pictures go to captures/dropped/',
        'calibrate': 'calibrate from all boards',
        'save': 'write the calibration and pass it to the cameras',
    }
    LIVE = ()
    FIXED = (RodOptions, InputOptions)

    def __init__(self) -> None:
        super().__init__()
        options = self.options.of(RodOptions)
        for name in ('rods', 'output'):
            if not getattr(options, name):
                raise ConfigError(f'parameter {name} is empty; set it at the start of the node')
        self._board = load_rods(Path(options.rods).expanduser())
        self._target = Target.from_rods(self._board)
        self._output = Path(options.output).expanduser()
        self._store = CaptureStore(
            self._output / 'captures', self._board, stopped=lambda: not self.context.ok()
        )
        finish_saving(self._output)
        folder = options.calibration
        self._in_use = read_rig(Path(folder).expanduser()) if folder else None
        self._result: CalibrationResult | None = None
        self._pairs = NewestPair()
        self._storing, self._solving = threading.Lock(), threading.Lock()
        self._preview = self.start_worker(self._show)
        self._setters: dict[str, Any] = {
            side: self.create_client(SetCameraInfo, f'{side}/set_camera_info')
            for side in ('left', 'right')
        }
        self.prepare(functools.partial(compile_kernels, self._board))
        # each call in a thread of its own: none waits for another, nor pictures for any
        group = ReentrantCallbackGroup()
        for name in self.SERVICES:
            job = getattr(self, f'_{name}')
            self.create_service(
                Trigger, f'~/{name}', functools.partial(self._serve, job), callback_group=group
            )
        self.health.state('boards', str(len(self._store.names)))
        # boards of an earlier day, before they are needed
        self.start_worker(self._read_boards).submit(None)
        self.start()

    def needed(self) -> bool:
        """Receive pairs all the time: a capture takes the newest."""
        return True

    def process(self, left: Image, right: Image) -> None:
        """Keep a pair as the newest one."""
        try:
            pair = _read_pair(left, right)
        except BinocularReconError as error:
            self._pairs.spoil(str(error))
            raise
        self._pairs.put(pair)
        if self.wanted('detections'):
            self._preview.submit((pair, left.header))

    def _serve(
        self, job: Callable[[], str], _request: Trigger.Request, response: Trigger.Response
    ) -> Trigger.Response:
        try:
            response.message = job()
            response.success = True
        except BinocularReconError as error:
            response.message = str(error)
        except Exception:  # noqa: BLE001 - a fault in one service must not end the node
            self.health.error(traceback.format_exc())
            response.message = f'internal error: {traceback.format_exc(limit=-1)}'
        return response

    def _read_boards(self, _job: None) -> None:
        self._store.usable()

    def _capture(self) -> str:
        with Alone(self._storing):
            stored = self._store.usable()
            pair = self._pairs.fresh(self._silence)
            found = detect_pair(pair, self._board)
            capture = Capture('new', found[0].marks_px, found[1].marks_px)
            missing = missing_words(found)
            others = stored.captures if stored else ()
            size = stored.image_size if stored else pair.size
            reason = size_words(pair.size, size) or complaint(
                capture, self._target, pair.size, others
            )
            if reason:
                raise CalibrationError(f'not captured: {reason}{missing}')
            later = self._pairs.after(pair, _STILL_WITHIN_S)
            unsure = check_still(pair, capture, later, self._board)
            name = self._store.add(pair.left, pair.right)
            capture = Capture(name, capture.left_px, capture.right_px)
            self._store.keep(capture, pair.size)
            self._pairs.captured(pair)
            count = len(self._store.names)
            self.health.state('boards', str(count))
            both = found[0].found & found[1].found
            return (
                f'board {name} captured ({count} so far): {both.sum()} of {both.size} marks in'
                f' both images{missing}{row_words(self._in_use, capture)}{unsure}'
            )

    def _undo(self) -> str:
        with Alone(self._storing):
            names = self._store.names
            if not names:
                raise CalibrationError('there is no board to drop')
            self._store.drop(names[-1:])
            self._pairs.captured(None)
            self.health.state('boards', str(len(names) - 1))
            return f'board {names[-1]} dropped, {len(names) - 1} left'

    def _reset(self) -> str:
        with Alone(self._storing):
            count, folder = len(self._store.names), self._store.drop_all()
            self._pairs.captured(None)
            self.health.state('boards', '0')
            where = f'; their pictures are in {folder}' if folder else ''
            return f'{count} boards dropped{where}'

    def _calibrate(self) -> str:
        with Alone(self._solving):
            begun_s = time.monotonic()
            with Alone(self._storing):
                found = self._store.captures()
            result = calibrate(
                found.captures, self._board, found.image_size, rejected=found.rejected
            )
            self._result = result
            self.health.state('calibration', f'{len(result.names)} boards, not saved yet')
            return f'{summary(result)}; {time.monotonic() - begun_s:.0f} s; save it'

    def _save(self) -> str:
        with Alone(self._solving):
            if self._result is None:
                raise CalibrationError('there is nothing to save; calibrate first')
            used, stored = self._result.names, self._store.names
            gone = set(used) - set(stored)
            if gone:
                raise CalibrationError(
                    f'the calibration has boards that were dropped since ({len(gone)} of'
                    f' {len(used)}); calibrate again'
                )
            options = self.options.of(RodOptions)
            names = options.left_camera_name, options.right_camera_name
            save_calibration(self._result, self._output, names, self._store.folder)
            self.health.state('calibration', f'saved in {self._output}')
            rig = self._result.rig
            told = [
                self._tell_camera(side, camera)
                for side, camera in (('left', rig.left), ('right', rig.right))
            ]
            boards = f'{len(used)} of {len(stored)} boards'
            return f'saved in {self._output}: {boards}; {"; ".join(told)}'

    def _silence(self) -> str:
        """Say why no pair comes; empty while they do."""
        silent = self.health.silent()
        topics = [topic for topic in silent if topic in self._inputs]
        if topics:
            return f'no messages on {", ".join(topics)}'
        return self.explain_missing_sets() if silent else ''

    def _show(self, job: tuple[ImagePair, Header]) -> None:
        """Publish a pair with what is found in it, in the preview's thread."""
        pair, header = job
        try:
            pictures = to_bgr8(pair.left), to_bgr8(pair.right)
            message = Image()
            fill_image(
                message, draw_detections(pictures, detect_pair(pair, self._board)), 'bgr8', header
            )
            if self.context.ok():
                self.publish('detections', message)
        except BinocularReconError as error:
            self.health.error(str(error))

    def _tell_camera(self, side: str, camera: Camera) -> str:
        """Pass a calibration to a camera's driver; say what came of it."""
        service = f'{side}/set_camera_info'
        client = self._setters[side]
        if not client.service_is_ready():
            return f'no {service}'
        request = SetCameraInfo.Request(camera_info=CameraInfo())
        fill_camera_info(request.camera_info, camera, Header())
        answered = threading.Event()
        future = client.call_async(request)
        future.add_done_callback(lambda _future: answered.set())
        if not answered.wait(_SET_CAMERA_INFO_WITHIN_S):
            client.remove_pending_request(future)
            return f'{service} did not answer within {_SET_CAMERA_INFO_WITHIN_S:g} s'
        answer: Any = future.result()
        words = f': {answer.status_message}' if answer.status_message else ''
        return f'{service} {"took it" if answer.success else "refused"}{words}'


def _read_pair(left: Image, right: Image) -> ImagePair:
    pictures = [
        read_image(message, f'{side} image').image
        for message, side in ((left, 'left'), (right, 'right'))
    ]
    sizes = [f'{picture.shape[1]}x{picture.shape[0]}' for picture in pictures]
    if sizes[0] != sizes[1]:
        raise ImageError(f'left image is {sizes[0]}, right {sizes[1]} px; set both alike')
    return ImagePair(pictures[0], pictures[1])


def main() -> int:
    """Run the node."""
    return run_node(CalibrationNode, threads=_THREADS)
