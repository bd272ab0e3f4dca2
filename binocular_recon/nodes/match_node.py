# SPDX-License-Identifier: Apache-2.0
"""Match rectified image pairs: disparities and their confidence."""

from __future__ import annotations

import math
import time

import numpy as np
from sensor_msgs.msg import CameraInfo, Image
from stereo_msgs.msg import DisparityImage

from binocular_recon.camera import StereoRig
from binocular_recon.config import PRESETS, ChainConfig, MatchConfig
from binocular_recon.images import FloatImage, mark_empty, to_grey
from binocular_recon.inputs.levels import LevelTracker
from binocular_recon.inputs.options import ImageConfig
from binocular_recon.io.messages.disparities import fill_disparity
from binocular_recon.io.messages.images import fill_image, read_image
from binocular_recon.nodes.runtime.endpoints import Input, Output
from binocular_recon.nodes.runtime.options import DepthBoundOptions, PresetOptions
from binocular_recon.nodes.runtime.process import run_node
from binocular_recon.nodes.runtime.rectified_node import RectifiedNode
from binocular_recon.stereo.diagnosis import Findings, PairCheck, image_fault
from binocular_recon.stereo.matching import disparity_step_px, match
from binocular_recon.stereo.orientation import turn, turn_back
from binocular_recon.stereo.range_tracker import RangeTracker
from binocular_recon.stereo.rectification import check_size
from binocular_recon.stereo.search_range import range_of_depths
from binocular_recon.stereo.validity import few_matched_warning


class MatchNode(RectifiedNode):
    """Match rectified image pairs; pixels without a match are invalid."""

    NAME = 'match_node'
    INPUTS = (
        Input('left/image_rect', Image, transported=True),
        Input('right/image_rect', Image, transported=True),
        Input('left/camera_info', CameraInfo),
        Input('right/camera_info', CameraInfo),
    )
    OUTPUTS = (
        Output('confidence', Image),
        Output('match_validity', Image),
        Output('disparity', DisparityImage),
    )
    LIVE = (PresetOptions, MatchConfig, DepthBoundOptions, ImageConfig)

    def __init__(self) -> None:
        super().__init__()
        self._range = RangeTracker()
        self._levels = LevelTracker()
        self._check = PairCheck()
        self.prepare()
        self.start()

    @staticmethod
    def compile_kernels() -> None:
        """Match noise with every preset."""
        noise = np.random.default_rng(0).uniform(0, 255, (64, 96)).astype(np.float32)
        for preset in PRESETS:
            match(noise, noise, ChainConfig.preset(preset, disparity_range=16).match)

    def process(
        self, left: Image, right: Image, left_info: CameraInfo, right_info: CameraInfo
    ) -> None:
        """Publish the disparities of one pair."""
        images = read_image(left, 'left image').image, read_image(right, 'right image').image
        rig = self.rectified_rig(left_info, right_info, images[0])
        self._levels.config = self.options.of(ImageConfig)
        levels = self._levels.update(*images)
        greys, exposed = [], True
        for image, level, side in zip(images, levels, ('left', 'right'), strict=True):
            check_size(image, rig.left.size, side)
            grey = to_grey(image, level)
            exposed = self._warn_of_bad_exposure(grey, side) and exposed
            grey = turn(grey, rig.turns)
            mark_empty(grey)
            greys.append(grey)
        left_grey, right_grey = greys
        config = self._with_range(left_grey, right_grey, rig)
        matched = match(left_grey, right_grey, config)
        self.health.state('matched', f'{matched.matched_share:.1%} of the pixels')
        findings = self._check.update(
            left_grey, right_grey, matched, config, rig.disparity_offset_px
        )
        self._report_findings(findings, matched.matched_share, warn=exposed)
        matched = turn_back(matched, rig.turns)
        if self.wanted('confidence'):
            confidence = Image()
            fill_image(confidence, matched.confidence, '32FC1', left.header)
            self.publish('confidence', confidence)
        if self.wanted('match_validity'):
            validity = Image()
            fill_image(validity, matched.validity, 'mono8', left.header)
            self.publish('match_validity', validity)
        if self.wanted('disparity'):
            disparity = DisparityImage()
            fill_disparity(
                disparity,
                matched.disparity_px,
                rig,
                config.limits_px,
                left.header,
                step_px=disparity_step_px(config),
            )
            self.publish('disparity', disparity)

    def _with_range(
        self, left_grey: FloatImage, right_grey: FloatImage, rig: StereoRig
    ) -> MatchConfig:
        """Return the options with the range to search in this frame."""
        config, bounds = self.options.of(MatchConfig), self.options.of(DepthBoundOptions)
        if bounds.near > 0:
            config = range_of_depths(bounds.near, bounds.far or math.inf, rig).applied_to(config)
        found = self._range.update(
            left_grey, right_grey, config, rig.disparity_offset_px, time.monotonic()
        )
        text = found.search.describe(rig)
        self.health.state('search range', text)
        if found.changed:
            self.get_logger().info(f'search range: {text}')
        if found.warning:
            self.health.warning(found.warning)
        return found.search.applied_to(config)

    def _report_findings(self, findings: Findings, share: float, *, warn: bool) -> None:
        if findings.rows.points:
            text = f'{findings.rows.median_px:.2f} px (median of {findings.rows.points} matches)'
            self.health.state('row offset', text)
        warnings = *findings.warnings, few_matched_warning(share, findings.cause)
        for warning in filter(None, warnings):
            if warn:
                self.health.warning(warning)

    def _warn_of_bad_exposure(self, grey: FloatImage, side: str) -> bool:
        """Warn if few pixels can be matched, and say why; return whether all is well."""
        missing = np.mean(np.isnan(grey))
        text = image_fault(grey)
        if missing > 0:
            text = (
                f'has no data (NaN) in {100 * missing:.1f} % of its pixels; they get no disparity'
            )
        if text:
            self.health.warning(f'{side} image {text}')
        return not text


def main() -> int:
    """Run the node."""
    return run_node(MatchNode)
