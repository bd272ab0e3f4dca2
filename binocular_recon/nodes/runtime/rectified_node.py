# SPDX-License-Identifier: Apache-2.0
"""The base of nodes that take rectified images: which camera infos are theirs."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np
from sensor_msgs.msg import CameraInfo

from binocular_recon.camera import StereoRig
from binocular_recon.nodes.runtime.endpoints import Input, Output
from binocular_recon.nodes.runtime.frame_node import FrameNode
from binocular_recon.nodes.runtime.options import INFO_TOPICS, InputOptions, RectifiedInfoOptions
from binocular_recon.options import Options

_OF_CAMERAS, _OF_RECTIFIER = INFO_TOPICS


class RectifiedNode(FrameNode):
    """Base of nodes whose camera infos are those of rectified images.

    They come on ``left/camera_info`` and ``right/camera_info``; the parameter ``camera_info``
    replaces the second part. Launch files set it instead of a remapping, because a remapping
    around the launch file, as drivers with other names need, takes precedence over theirs.
    """

    FIXED: ClassVar[Sequence[type[Options]]] = (InputOptions, RectifiedInfoOptions)

    def start(
        self, inputs: Sequence[Input] | None = None, *, outputs: Sequence[Output] | None = None
    ) -> None:
        """Create publishers and subscriptions, with the camera infos that are chosen."""
        chosen = self.options.of(RectifiedInfoOptions).camera_info
        self._info_topic = f'left/{chosen}'
        super().start(
            [
                dataclasses.replace(one, topic=one.topic.replace(_OF_CAMERAS, chosen))
                if one.type is CameraInfo
                else one
                for one in inputs or self.INPUTS
            ],
            outputs=outputs,
        )

    def rectified_rig(self, left_info: Any, right_info: Any, image: Any) -> StereoRig:
        """Return the rig of two CameraInfos of rectified images, the left one an array."""
        rig = self.rig(left_info, right_info, image, image, rectified=True)
        in_use = self.resolve_topic_name(self._info_topic)
        other = self.resolve_topic_name(f'left/{_OF_RECTIFIER}')
        if other != in_use and _is_raw(left_info) and self.count_publishers(other):
            self.health.warning(
                f'{in_use} (f {rig.focal_px:.2f} px, baseline {rig.baseline_m:.4f} m) is that of'
                f' raw images, and {other} is published: if its f differs, depths are wrong; set'
                f' camera_info to {_OF_RECTIFIER} in match_node and wls_filter_node'
            )
        return rig


def _is_raw(info: Any) -> bool:
    """Tell whether a CameraInfo describes a raw image, which is rectified with its R and P."""
    P = np.asarray(info.p).reshape(3, 4)
    return bool(
        np.any(info.d)
        or not np.array_equal(np.asarray(info.k).reshape(3, 3), P[:, :3])
        or not np.array_equal(np.asarray(info.r).reshape(3, 3), np.eye(3))
    )
