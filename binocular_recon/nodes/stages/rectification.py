# SPDX-License-Identifier: Apache-2.0
"""Rectify raw pairs, and publish the rectified ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import Header

from binocular_recon.camera import StereoRig
from binocular_recon.inputs.image_faults import same_image
from binocular_recon.io.calibration_yaml import read_rig
from binocular_recon.io.messages.camera_infos import fill_camera_info
from binocular_recon.io.messages.images import DecodedImage, fill_image, read_image
from binocular_recon.nodes.runtime.endpoints import Output
from binocular_recon.nodes.runtime.frame_node import FrameNode
from binocular_recon.nodes.runtime.options import CalibrationOptions, FrameOptions, RectifyOptions
from binocular_recon.nodes.runtime.rectified_frames import RectifiedFrames
from binocular_recon.options import Options
from binocular_recon.stereo.rectification import Rectifier, frame_text

_SIDES = ('left', 'right')


@dataclass(frozen=True, eq=False)
class RectifiedPair:
    """A rectified pair.

    Attributes
    ----------
    images : (DecodedImage, DecodedImage)
        Left and right, with the encodings of their messages.
    rig : StereoRig
        Rectified rig.
    headers : (Header, Header)
        Those of the rectified images.

    """

    images: tuple[DecodedImage, DecodedImage]
    rig: StereoRig
    headers: tuple[Header, Header]


class RectifyStage:
    """Rectification in a node; without `CalibrationOptions` the rig is that of the messages."""

    OUTPUTS = (
        Output('left/camera_info_rect', CameraInfo),
        Output('right/camera_info_rect', CameraInfo),
        Output('left/image_rect', Image),
        Output('right/image_rect', Image),
    )
    LIVE: ClassVar[Sequence[type[Options]]] = (RectifyOptions,)
    FIXED: ClassVar[Sequence[type[Options]]] = (CalibrationOptions, FrameOptions)

    def __init__(self, node: FrameNode) -> None:
        self._node = node
        self._current: tuple[StereoRig, RectifyOptions, Rectifier] | None = None
        self._fixed_rig: StereoRig | None = None
        self._frames = RectifiedFrames(node, node.options.of(FrameOptions).frame_suffix)
        folder = node.options.of(CalibrationOptions).calibration
        if folder:
            self._fixed_rig = read_rig(Path(folder).expanduser())
            node.report_rig(self._fixed_rig)

    @property
    def calibrated(self) -> bool:
        """Whether the rig is that of a folder, so that no camera infos are needed."""
        return self._fixed_rig is not None

    def __call__(self, left: Image, right: Image, *infos: CameraInfo) -> RectifiedPair:
        """Return the rectified pair of two images and, unless `calibrated`, their infos."""
        fixed = self._fixed_rig
        images = (
            read_image(left, 'left image', fixed.left.size if fixed else None),
            read_image(right, 'right image', fixed.right.size if fixed else None),
        )
        if same := same_image(*(image.image for image in images)):
            self._node.health.warning(same)
        rig = fixed or self._node.rig(infos[0], infos[1], *(image.image for image in images))
        if self._fixed_rig:
            self._node.warn_of_rig(rig)
        rectifier = self._rectifier(rig)
        rectified = rectifier(*(image.image for image in images))
        frames = left.header.frame_id, right.header.frame_id
        # of two cameras with one frame the left one's holds: clouds are in it
        raw_cameras = {frames[1]: rig.right, frames[0]: rig.left}
        self._frames.update(raw_cameras, left.header.stamp)
        left_header, right_header = (
            Header(stamp=left.header.stamp, frame_id=self._frames.name(frame)) for frame in frames
        )
        return RectifiedPair(
            (
                DecodedImage(rectified[0], images[0].encoding),
                DecodedImage(rectified[1], images[1].encoding),
            ),
            rectifier.rig,
            (left_header, right_header),
        )

    def publish(self, pair: RectifiedPair) -> None:
        """Publish what is wanted of a rectified pair, the camera infos first."""
        cameras = pair.rig.left, pair.rig.right
        for side, camera, header in zip(_SIDES, cameras, pair.headers, strict=True):
            if self._node.wanted(f'{side}/camera_info_rect'):
                info = CameraInfo()
                fill_camera_info(info, camera, header)
                self._node.publish(f'{side}/camera_info_rect', info)
        for side, image, header in zip(_SIDES, pair.images, pair.headers, strict=True):
            if self._node.wanted(f'{side}/image_rect'):
                message = Image()
                fill_image(message, image.image, image.encoding, header)
                self._node.publish(f'{side}/image_rect', message)

    def _rectifier(self, rig: StereoRig) -> Rectifier:
        """Return the rectifier of this rig and the current options."""
        options = self._node.options.of(RectifyOptions)
        if self._current is None or self._current[0] is not rig or self._current[1] != options:
            self._current = rig, options, Rectifier(rig, options.alpha, options.interpolation)
            self._node.health.state('left rectified frame', frame_text(rig.left))
        return self._current[2]
