# SPDX-License-Identifier: Apache-2.0
"""Filter disparities and triangulate them: dense disparities, points, depth, a heat map."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
from sensor_msgs.msg import CameraInfo, Image
from stereo_msgs.msg import DisparityImage

from binocular_recon.camera import StereoRig
from binocular_recon.config import PRESETS, ChainConfig
from binocular_recon.errors import ImageError
from binocular_recon.images import ByteImage, FloatImage, mark_empty, to_grey
from binocular_recon.inputs.levels import LevelTracker
from binocular_recon.inputs.options import ImageConfig
from binocular_recon.io.messages.disparities import read_disparity
from binocular_recon.io.messages.images import read_image
from binocular_recon.nodes.runtime.demand import DISPARITIES_WANTED, PAIRS_WANTED
from binocular_recon.nodes.runtime.endpoints import Input
from binocular_recon.nodes.runtime.options import (
    LateInputOptions,
    LoadOptions,
    RectifiedInfoOptions,
)
from binocular_recon.nodes.runtime.process import run_node
from binocular_recon.nodes.runtime.rectified_node import RectifiedNode
from binocular_recon.nodes.stages.filtering import FilterStage, Measured
from binocular_recon.stereo.filtering.wls_filter import filter_disparity
from binocular_recon.stereo.orientation import turn
from binocular_recon.stereo.rectification import check_size


class WlsFilterNode(RectifiedNode):
    """Filter the disparities of match_node or stereo_image_proc and triangulate them."""

    NAME = 'wls_filter_node'
    INPUTS = (
        Input('left/image_rect', Image, transported=True),
        Input('left/camera_info', CameraInfo),
        Input('right/camera_info', CameraInfo),
        Input('disparity', DisparityImage),
        Input('confidence', Image, optional=True),
        Input('match_validity', Image, optional=True),
    )
    OUTPUTS = FilterStage.OUTPUTS
    LIVE = (*FilterStage.LIVE, ImageConfig, LoadOptions)
    FIXED = (LateInputOptions, RectifiedInfoOptions, *FilterStage.FIXED)
    # pairs are those that it has asked disparities of
    REQUESTS, ASKS_EARLY = (DISPARITIES_WANTED, PAIRS_WANTED), True

    def __init__(self) -> None:
        super().__init__()
        self._levels = LevelTracker()
        self._filter = FilterStage(self)
        self.prepare()
        self.start()

    @staticmethod
    def compile_kernels(presets: Sequence[str] = tuple(PRESETS)) -> None:
        """Filter noise with these presets and either guide."""
        generator = np.random.default_rng(0)
        grey = generator.uniform(0, 255, (48, 64)).astype(np.float32)
        disparity = generator.uniform(1, 8, grey.shape).astype(np.float32)
        ones = np.ones_like(grey)
        for preset, guide in itertools.product(presets, ('left', 'disparity')):
            config = ChainConfig.preset(preset, wls_guide=guide).filter
            filter_disparity(disparity, ones, grey, config, limits_px=(0.0, 15.0))

    def process(
        self,
        left: Image,
        left_info: CameraInfo,
        right_info: CameraInfo,
        disparity: DisparityImage,
        confidence: Image | None,
        reasons: Image | None,
    ) -> None:
        """Publish the outputs that somebody subscribes to."""
        image = read_image(left, 'left image').image
        rig = self.rectified_rig(left_info, right_info, image)
        found = read_disparity(disparity, rig)
        for pixels, name in ((found.disparity_px, 'disparity'), (image, 'left')):
            check_size(pixels, rig.left.size, name)
        self._levels.config = self.options.of(ImageConfig)
        (levels,) = self._levels.update(image)
        guide = turn(to_grey(image, levels), rig.turns)
        mark_empty(guide)
        self._filter(
            Measured(
                turn(found.disparity_px, rig.turns),
                turn(_confidence(confidence, found.disparity_px), rig.turns),
                _reasons(reasons, rig),
                guide,
                limits_px=found.limits_px,
                step_px=disparity.delta_d,
                image=image,
                levels=levels,
                rig=rig,
                header=left.header,
            )
        )


def _confidence(message: Image | None, disparity_px: FloatImage) -> FloatImage:
    """Return the confidence of each pixel; without a message, 1 where there is a disparity."""
    if message is None:
        return np.isfinite(disparity_px).astype(np.float32)
    if message.encoding != '32FC1':
        raise ImageError(f'confidence has encoding {message.encoding!r}; it must be 32FC1')
    return read_image(message, 'confidence').image


def _reasons(message: Image | None, rig: StereoRig) -> ByteImage | None:
    """Return why pixels have no match, turned like the pair; None without a message."""
    if message is None:
        return None
    if message.encoding != 'mono8':
        raise ImageError(f'match_validity has encoding {message.encoding!r}; it must be mono8')
    validity = read_image(message, 'match_validity').image
    check_size(validity, rig.left.size, 'match_validity')
    return turn(validity, rig.turns)


def main() -> int:
    """Run the node."""
    return run_node(WlsFilterNode)
