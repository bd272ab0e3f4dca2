# SPDX-License-Identifier: Apache-2.0
"""Match rectified image pairs: disparities and their confidence."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from sensor_msgs.msg import CameraInfo, Image

from binocular_recon.config import PRESETS, ChainConfig
from binocular_recon.io.messages.images import read_image
from binocular_recon.nodes.runtime.demand import DISPARITIES_WANTED, PAIRS_WANTED
from binocular_recon.nodes.runtime.endpoints import Input
from binocular_recon.nodes.runtime.options import LoadOptions
from binocular_recon.nodes.runtime.process import run_node
from binocular_recon.nodes.runtime.rectified_node import RectifiedNode
from binocular_recon.nodes.stages.matching import MatchStage
from binocular_recon.stereo.matching import match


class MatchNode(RectifiedNode):
    """Match rectified image pairs; pixels without a match are invalid."""

    NAME = 'match_node'
    INPUTS = (
        Input('left/image_rect', Image, transported=True),
        Input('right/image_rect', Image, transported=True),
        Input('left/camera_info', CameraInfo),
        Input('right/camera_info', CameraInfo),
    )
    OUTPUTS = MatchStage.OUTPUTS
    LIVE = (*MatchStage.LIVE, LoadOptions)
    DEMAND, REQUESTS = DISPARITIES_WANTED, (PAIRS_WANTED,)

    def __init__(self) -> None:
        super().__init__()
        self._match = MatchStage(self)
        self.prepare()
        self.start()

    @staticmethod
    def compile_kernels(presets: Sequence[str] = tuple(PRESETS)) -> None:
        """Match noise with these presets."""
        noise = np.random.default_rng(0).uniform(0, 255, (64, 96)).astype(np.float32)
        for preset in presets:
            match(noise, noise, ChainConfig.preset(preset, disparity_range=16).match)

    def process(
        self, left: Image, right: Image, left_info: CameraInfo, right_info: CameraInfo
    ) -> None:
        """Publish the disparities of one pair."""
        images = read_image(left, 'left image').image, read_image(right, 'right image').image
        rig = self.rectified_rig(left_info, right_info, images[0])
        self._match.publish(self._match(*images, rig), rig, left.header)


def main() -> int:
    """Run the node."""
    return run_node(MatchNode)
