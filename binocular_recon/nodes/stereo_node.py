# SPDX-License-Identifier: Apache-2.0
"""The whole chain in one process: rectify, match, filter, triangulate."""

from __future__ import annotations

import functools
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from sensor_msgs.msg import CameraInfo, Image

from binocular_recon.config import PRESETS
from binocular_recon.io.messages.images import read_image
from binocular_recon.nodes.match_node import MatchNode
from binocular_recon.nodes.rectify_node import RectifyNode
from binocular_recon.nodes.runtime.frame_node import FrameNode
from binocular_recon.nodes.runtime.options import InputOptions, LoadOptions, RectifiedImageOptions
from binocular_recon.nodes.runtime.process import run_node
from binocular_recon.nodes.runtime.worker import Rest
from binocular_recon.nodes.stages.filtering import FilterStage, Measured
from binocular_recon.nodes.stages.matching import MatchedPair, MatchStage
from binocular_recon.nodes.stages.rectification import RectifiedPair, RectifyStage
from binocular_recon.nodes.wls_filter_node import WlsFilterNode
from binocular_recon.stereo.matching import disparity_step_px

_FILTERED = [one.topic for one in FilterStage.OUTPUTS]
_MATCHED = [one.topic for one in MatchStage.OUTPUTS]


class StereoNode(FrameNode):
    """Rectify, match and filter image pairs in one process, and triangulate them.

    It gives what `rectify_node`, `match_node` and `wls_filter_node` give together, without
    messages between the stages.
    """

    NAME = 'stereo_node'
    INPUTS = RectifyNode.INPUTS
    OUTPUTS = (*RectifyStage.OUTPUTS, *MatchStage.OUTPUTS, *FilterStage.OUTPUTS)
    LIVE = tuple(
        dict.fromkeys((*RectifyStage.LIVE, *MatchStage.LIVE, *FilterStage.LIVE, LoadOptions))
    )
    FIXED = (InputOptions, RectifiedImageOptions, *RectifyStage.FIXED)

    def __init__(self) -> None:
        super().__init__()
        self._match = MatchStage(self)
        self._filter = FilterStage(self)
        self._rectify = None
        if self.options.of(RectifiedImageOptions).rectify:
            self._rectify = RectifyStage(self)
        self.prepare()
        if self._rectify is None:
            self.start(
                (*MatchNode.INPUTS[:2], *self.INPUTS[2:]),
                outputs=(*MatchStage.OUTPUTS, *FilterStage.OUTPUTS),
            )
        else:
            self.start(self.INPUTS[:2] if self._rectify.calibrated else self.INPUTS)

    @staticmethod
    def compile_kernels(presets: Sequence[str] = tuple(PRESETS)) -> None:
        """Do what the stages do."""
        MatchNode.compile_kernels(presets)
        WlsFilterNode.compile_kernels(presets)

    def process(self, left: Image, right: Image, *infos: CameraInfo) -> Rest | None:
        """Publish the outputs that somebody subscribes to, and compute no more than they need."""
        with self._timed('rectify'):
            pair = self._rectified(left, right, *infos)
        if not self.wanted(*_MATCHED, *_FILTERED):
            return None
        with self._timed('match'):
            matched = self._match(pair.images[0].image, pair.images[1].image, pair.rig)
            self._match.publish(matched, pair.rig, pair.headers[0])
        if not self.wanted(*_FILTERED):
            return None
        return functools.partial(self._filtered, _measured(pair, matched))

    def _filtered(self, measured: Measured) -> None:
        with self._timed('filter'):
            self._filter(measured)

    @contextmanager
    def _timed(self, stage: str) -> Iterator[None]:
        """State in the diagnostics how long a stage takes."""
        begun_s = time.monotonic()
        yield
        self.health.state(f'time of {stage}', f'{1000 * (time.monotonic() - begun_s):.1f} ms')

    def _rectified(self, left: Image, right: Image, *infos: CameraInfo) -> RectifiedPair:
        """Return a pair rectified and published, or as it is if the cameras rectify."""
        if self._rectify is not None:
            pair = self._rectify(left, right, *infos)
            self._rectify.publish(pair)
            return pair
        images = read_image(left, 'left image'), read_image(right, 'right image')
        left_image, right_image = (image.image for image in images)
        rig = self.rig(infos[0], infos[1], left_image, right_image, rectified=True)
        return RectifiedPair(images, rig, (left.header, right.header))


def _measured(pair: RectifiedPair, matched: MatchedPair) -> Measured:
    """Return what the filter takes of a matched pair."""
    return Measured(
        matched.matched.disparity_px,
        matched.matched.confidence,
        matched.matched.validity,
        matched.left_grey,
        limits_px=matched.config.limits_px,
        step_px=disparity_step_px(matched.config),
        image=pair.images[0].image,
        levels=matched.levels,
        rig=pair.rig,
        header=pair.headers[0],
    )


def main() -> int:
    """Run the node."""
    return run_node(StereoNode)
