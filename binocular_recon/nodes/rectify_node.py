# SPDX-License-Identifier: Apache-2.0
"""Raw pictures of a stereo rig in, rectified pictures and their camera infos out."""

from __future__ import annotations

from pathlib import Path

from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import Header

from binocular_recon.camera import StereoRig
from binocular_recon.io.calibration_yaml import read_rig
from binocular_recon.io.messages.camera_infos import fill_camera_info
from binocular_recon.io.messages.images import fill_image, read_image
from binocular_recon.nodes.runtime.base_node import StereoNode
from binocular_recon.nodes.runtime.endpoints import Input, Output
from binocular_recon.nodes.runtime.options import CalibrationOptions, InputOptions, RectifyOptions
from binocular_recon.nodes.runtime.process import run_node
from binocular_recon.stereo.rectification import Rectifier

_SIDES = ('left', 'right')
_IMAGES = (
    Input('left/image_raw', Image, transported=True),
    Input('right/image_raw', Image, transported=True),
)


class RectifyNode(StereoNode):
    """Rectify pairs; encodings are kept, but Bayer patterns and YUV become bgr8."""

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
    FIXED = (InputOptions, CalibrationOptions)

    def __init__(self) -> None:
        super().__init__()
        self._made: tuple[StereoRig, RectifyOptions, Rectifier] | None = None
        self._own_rig: StereoRig | None = None
        folder = self.options.of(CalibrationOptions).calibration
        if folder:
            self._own_rig = read_rig(Path(folder).expanduser())
            self.state_rig(self._own_rig)
        self.start(_IMAGES if self._own_rig else self.INPUTS)

    def process(self, left: Image, right: Image, *infos: CameraInfo) -> None:
        """Publish one rectified pair."""
        rectifier = self._rectifier(self._own_rig or self.rig(*infos))
        pictures = read_image(left, 'left image'), read_image(right, 'right image')
        rectified = rectifier(*(picture.image for picture in pictures))
        cameras = rectifier.rig.left, rectifier.rig.right
        headers = left.header, Header(stamp=left.header.stamp, frame_id=right.header.frame_id)
        for side, camera, header in zip(_SIDES, cameras, headers, strict=True):
            if self.wanted(f'{side}/camera_info_rect'):
                info = CameraInfo()
                fill_camera_info(info, camera, header)
                self.publish(f'{side}/camera_info_rect', info)
        for side, image, picture, header in zip(_SIDES, rectified, pictures, headers, strict=True):
            if self.wanted(f'{side}/image_rect'):
                message = Image()
                fill_image(message, image, picture.encoding, header)
                self.publish(f'{side}/image_rect', message)

    def _rectifier(self, rig: StereoRig) -> Rectifier:
        """Return the maps of this rig and these options, made when either changes."""
        options = self.options.of(RectifyOptions)
        if self._made is None or self._made[0] is not rig or self._made[1] != options:
            self._made = rig, options, Rectifier(rig, options.alpha, options.interpolation)
        return self._made[2]


def main() -> int:
    """Run the node."""
    return run_node(RectifyNode)
