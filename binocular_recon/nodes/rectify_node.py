# SPDX-License-Identifier: Apache-2.0
"""Rectify the raw images of a stereo rig."""

from __future__ import annotations

from pathlib import Path

from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import Header

from binocular_recon.camera import StereoRig
from binocular_recon.io.calibration_yaml import read_rig
from binocular_recon.io.messages.camera_infos import fill_camera_info
from binocular_recon.io.messages.images import fill_image, read_image
from binocular_recon.nodes.runtime.endpoints import Input, Output
from binocular_recon.nodes.runtime.frame_node import FrameNode
from binocular_recon.nodes.runtime.options import (
    CalibrationOptions,
    FrameOptions,
    InputOptions,
    RectifyOptions,
)
from binocular_recon.nodes.runtime.process import run_node
from binocular_recon.nodes.runtime.rectified_frames import RectifiedFrames
from binocular_recon.stereo.rectification import Rectifier, frame_text

_SIDES = ('left', 'right')
_IMAGES = (
    Input('left/image_raw', Image, transported=True),
    Input('right/image_raw', Image, transported=True),
)


class RectifyNode(FrameNode):
    """Rectify image pairs. Encodings are kept, except that Bayer and YUV images become bgr8."""

    NAME = 'rectify_node'
    INPUTS = (
        *_IMAGES,
        Input('left/camera_info', CameraInfo),
        Input('right/camera_info', CameraInfo),
    )
    OUTPUTS = (
        Output('left/camera_info_rect', CameraInfo),
        Output('right/camera_info_rect', CameraInfo),
        Output('left/image_rect', Image),
        Output('right/image_rect', Image),
    )
    LIVE = (RectifyOptions,)
    FIXED = (InputOptions, CalibrationOptions, FrameOptions)

    def __init__(self) -> None:
        super().__init__()
        self._current: tuple[StereoRig, RectifyOptions, Rectifier] | None = None
        self._fixed_rig: StereoRig | None = None
        self._frames = RectifiedFrames(self, self.options.of(FrameOptions).frame_suffix)
        folder = self.options.of(CalibrationOptions).calibration
        if folder:
            self._fixed_rig = read_rig(Path(folder).expanduser())
            self.report_rig(self._fixed_rig)
        self.start(_IMAGES if self._fixed_rig else self.INPUTS)

    def process(self, left: Image, right: Image, *infos: CameraInfo) -> None:
        """Publish one rectified pair."""
        size = self._fixed_rig.left.size if self._fixed_rig else None
        images = read_image(left, 'left image', size), read_image(right, 'right image', size)
        rig = self._fixed_rig or self.rig(infos[0], infos[1], images[0].image)
        if self._fixed_rig:
            self.warn_of_rig(rig)
        rectifier = self._rectifier(rig)
        rectified = rectifier(*(image.image for image in images))
        cameras = rectifier.rig.left, rectifier.rig.right
        frames = left.header.frame_id, right.header.frame_id
        # of two cameras with one frame the left one's holds: clouds are in it
        raw_cameras = {frames[1]: rig.right, frames[0]: rig.left}
        self._frames.update(raw_cameras, left.header.stamp)
        headers = [
            Header(stamp=left.header.stamp, frame_id=self._frames.name(frame)) for frame in frames
        ]
        for side, camera, header in zip(_SIDES, cameras, headers, strict=True):
            if self.wanted(f'{side}/camera_info_rect'):
                info = CameraInfo()
                fill_camera_info(info, camera, header)
                self.publish(f'{side}/camera_info_rect', info)
        for side, pixels, image, header in zip(_SIDES, rectified, images, headers, strict=True):
            if self.wanted(f'{side}/image_rect'):
                message = Image()
                fill_image(message, pixels, image.encoding, header)
                self.publish(f'{side}/image_rect', message)

    def _rectifier(self, rig: StereoRig) -> Rectifier:
        """Return the rectifier of this rig and the current options."""
        options = self.options.of(RectifyOptions)
        if self._current is None or self._current[0] is not rig or self._current[1] != options:
            self._current = rig, options, Rectifier(rig, options.alpha, options.interpolation)
            self.health.state('left rectified frame', frame_text(rig.left))
        return self._current[2]


def main() -> int:
    """Run the node."""
    return run_node(RectifyNode)
