# SPDX-License-Identifier: Apache-2.0
"""Rectify the raw images of a stereo rig."""

from __future__ import annotations

from sensor_msgs.msg import CameraInfo, Image

from binocular_recon.nodes.runtime.demand import PAIRS_WANTED
from binocular_recon.nodes.runtime.endpoints import Input
from binocular_recon.nodes.runtime.frame_node import FrameNode
from binocular_recon.nodes.runtime.options import InputOptions, LoadOptions
from binocular_recon.nodes.runtime.process import run_node
from binocular_recon.nodes.stages.rectification import RectifyStage

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
    OUTPUTS = RectifyStage.OUTPUTS
    LIVE = (*RectifyStage.LIVE, LoadOptions)
    FIXED = (InputOptions, *RectifyStage.FIXED)
    DEMAND = PAIRS_WANTED

    def __init__(self) -> None:
        super().__init__()
        self._rectify = RectifyStage(self)
        self.start(_IMAGES if self._rectify.calibrated else self.INPUTS)

    def process(self, left: Image, right: Image, *infos: CameraInfo) -> None:
        """Publish one rectified pair."""
        self._rectify.publish(self._rectify(left, right, *infos))


def main() -> int:
    """Run the node."""
    return run_node(RectifyNode)
