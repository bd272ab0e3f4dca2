# SPDX-License-Identifier: Apache-2.0
"""Match rectified pairs, say what is wrong with them, and publish their disparities."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from sensor_msgs.msg import Image
from std_msgs.msg import Header
from stereo_msgs.msg import DisparityImage

from binocular_recon.camera import StereoRig
from binocular_recon.config import MatchConfig
from binocular_recon.images import FloatImage, mark_empty, to_grey
from binocular_recon.images import Image as ImageArray
from binocular_recon.inputs.image_faults import image_fault
from binocular_recon.inputs.levels import Levels, LevelTracker
from binocular_recon.inputs.options import ImageConfig
from binocular_recon.io.messages.disparities import fill_disparity
from binocular_recon.io.messages.images import fill_image
from binocular_recon.nodes.runtime.endpoints import Output
from binocular_recon.nodes.runtime.frame_node import FrameNode
from binocular_recon.nodes.runtime.options import DepthBoundOptions, PresetOptions
from binocular_recon.options import Options
from binocular_recon.stereo.diagnosis import Findings, PairCheck
from binocular_recon.stereo.matching import Match, disparity_step_px, match
from binocular_recon.stereo.orientation import turn, turn_back, turned_colours
from binocular_recon.stereo.range_tracker import RangeTracker
from binocular_recon.stereo.rectification import check_size
from binocular_recon.stereo.search_range import range_of_depths
from binocular_recon.stereo.validity import few_matched_warning


@dataclass(frozen=True, eq=False)
class MatchedPair:
    """The matches of a pair.

    Attributes
    ----------
    matched : Match
        Of the pair turned so that its baseline lies along the rows (`StereoRig.turns`).
    left_grey : (H, W) float32
        Left image, grey and turned; NaN = no data.
    levels : Levels
        Black and white of the left image.
    config : MatchConfig
        Options, with the range that was searched.

    """

    matched: Match
    left_grey: FloatImage
    levels: Levels
    config: MatchConfig


class MatchStage:
    """Matching in a node; pixels without a match are invalid."""

    OUTPUTS = (
        Output('confidence', Image),
        Output('match_validity', Image),
        Output('disparity', DisparityImage),
    )
    LIVE: ClassVar[Sequence[type[Options]]] = (
        PresetOptions,
        MatchConfig,
        DepthBoundOptions,
        ImageConfig,
    )

    def __init__(self, node: FrameNode) -> None:
        self._node = node
        self._range = RangeTracker()
        self._levels = LevelTracker()
        self._check = PairCheck()

    def __call__(self, left: ImageArray, right: ImageArray, rig: StereoRig) -> MatchedPair:
        """Match a pair of a rectified rig and report what is wrong with it."""
        health = self._node.health
        self._levels.config = self._node.options.of(ImageConfig)
        levels = self._levels.update(left, right)
        greys, faults, missing = [], [], []
        for image, level, side in zip((left, right), levels, ('left', 'right'), strict=True):
            check_size(image, rig.left.size, side)
            grey = to_grey(image, level)
            faults.append(image_fault(grey))
            missing.append(float(np.isnan(grey).mean()))
            self._warn_of_fault(faults[-1], missing[-1], side)
            grey = turn(grey, rig.turns)
            mark_empty(grey)
            greys.append(grey)
        left_grey, right_grey = greys
        config = self._with_range(left_grey, right_grey, rig)
        colours = turned_colours((left, right), levels, rig.turns)
        matched = match(left_grey, right_grey, config, colours)
        health.state('matched', f'{matched.matched_share:.1%} of the pixels')
        findings = self._check.update(
            *(left_grey, right_grey, matched, config, rig.disparity_offset_px),
            faults=(faults[0], faults[1]),
        )
        self._report_findings(
            findings, matched.matched_share, warn=not (any(faults) or any(missing))
        )
        return MatchedPair(matched, left_grey, levels[0], config)

    def publish(self, pair: MatchedPair, rig: StereoRig, header: Header) -> None:
        """Publish what is wanted of the matches of a pair, the disparities last."""
        node = self._node
        if not node.wanted(*(one.topic for one in self.OUTPUTS)):
            return
        matched = turn_back(pair.matched, rig.turns)
        if node.wanted('confidence'):
            confidence = Image()
            fill_image(confidence, matched.confidence, '32FC1', header)
            node.publish('confidence', confidence)
        if node.wanted('match_validity'):
            validity = Image()
            fill_image(validity, matched.validity, 'mono8', header)
            node.publish('match_validity', validity)
        if node.wanted('disparity'):
            disparity = DisparityImage()
            fill_disparity(
                disparity,
                matched.disparity_px,
                rig,
                pair.config.limits_px,
                header,
                step_px=disparity_step_px(pair.config),
            )
            node.publish('disparity', disparity)

    def _with_range(
        self, left_grey: FloatImage, right_grey: FloatImage, rig: StereoRig
    ) -> MatchConfig:
        """Return the options with the range to search in this frame."""
        node = self._node
        config, bounds = node.options.of(MatchConfig), node.options.of(DepthBoundOptions)
        if bounds.near > 0:
            config = range_of_depths(bounds.near, bounds.far or math.inf, rig).applied_to(config)
        found = self._range.update(
            left_grey, right_grey, config, rig.disparity_offset_px, time.monotonic()
        )
        text = found.search.describe(rig)
        node.health.state('search range', text)
        if found.changed:
            node.get_logger().info(f'search range: {text}')
        if found.warning:
            node.health.warning(found.warning)
        return found.search.applied_to(config)

    def _report_findings(self, findings: Findings, share: float, *, warn: bool) -> None:
        health = self._node.health
        if findings.rows.points:
            text = f'{findings.rows.median_px:.2f} px (median of {findings.rows.points} matches)'
            health.state('row offset', text)
        warnings = *findings.warnings, few_matched_warning(share, findings.cause)
        for warning in filter(None, warnings):
            if warn:
                health.warning(warning)

    def _warn_of_fault(self, fault: str, missing: float, side: str) -> None:
        """Warn if few pixels can be matched, and say why."""
        if missing > 0:
            fault = (
                f'has no data (NaN) in {100 * missing:.1f} % of its pixels; they get no disparity'
            )
        if fault:
            self._node.health.warning(f'{side} image {fault}')
