# SPDX-License-Identifier: Apache-2.0
"""Filter disparities, triangulate them, and publish dense disparities, points and depth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from sensor_msgs.msg import CameraInfo, Image, PointCloud2, PointField
from std_msgs.msg import Header
from stereo_msgs.msg import DisparityImage

from binocular_recon.camera import StereoRig
from binocular_recon.cloud_config import CloudConfig
from binocular_recon.config import FilterConfig
from binocular_recon.drawing.colormap import heat_map
from binocular_recon.images import ByteImage, FloatImage, to_bgr8
from binocular_recon.images import Image as ImageArray
from binocular_recon.inputs.levels import Levels
from binocular_recon.io.calibration_yaml import read_rig
from binocular_recon.io.messages.camera_infos import fill_camera_info
from binocular_recon.io.messages.clouds import fill_cloud
from binocular_recon.io.messages.disparities import fill_disparity
from binocular_recon.io.messages.images import fill_image
from binocular_recon.nodes.runtime.endpoints import Output
from binocular_recon.nodes.runtime.frame_node import FrameNode
from binocular_recon.nodes.runtime.options import (
    CalibrationOptions,
    CloudMessageOptions,
    PresetOptions,
)
from binocular_recon.options import Options
from binocular_recon.stereo.filtering.wls_filter import DisparityFilter, Filtered
from binocular_recon.stereo.orientation import turn_back
from binocular_recon.stereo.point_covariance import add_covariance, sigma_shares
from binocular_recon.stereo.thinning import PointSet, thin
from binocular_recon.stereo.triangulation import Cloud, triangulate

_CLOUD_OUTPUTS = ('points2', 'depth', 'depth/camera_info')


@dataclass(frozen=True, eq=False)
class Measured:
    """What was measured of a frame, its maps turned by ``rig.turns``.

    Attributes
    ----------
    disparity_px, confidence : (H, W) float32
        Raw disparities, NaN = none, and their confidence.
    reasons : (H, W) uint8, optional
        Bits of `Validity` that say why pixels have no match.
    guide : (H, W) float32
        Left image, grey; NaN = no data.
    limits_px : (float, float)
        Smallest and largest disparity searched.
    step_px : float
        Sub-pixel step of the disparities.
    image : (H, W) or (H, W, C)
        Left image as it came, not turned.
    levels : Levels
        Its black and white.
    rig : StereoRig
        Rectified rig.
    header : Header
        Header of the left image.

    """

    disparity_px: FloatImage
    confidence: FloatImage
    reasons: ByteImage | None
    guide: FloatImage
    limits_px: tuple[float, float]
    step_px: float
    image: ImageArray
    levels: Levels
    rig: StereoRig
    header: Header


class FilterStage:
    """Filtering and triangulation in a node."""

    OUTPUTS = (
        Output('disparity_wls', DisparityImage),
        Output('points2', PointCloud2),
        Output('depth', Image),
        Output('depth/camera_info', CameraInfo),
        Output('disparity_color', Image),
        Output('validity', Image),
    )
    LIVE: ClassVar[Sequence[type[Options]]] = (
        PresetOptions,
        FilterConfig,
        CloudConfig,
        CloudMessageOptions,
    )
    FIXED: ClassVar[Sequence[type[Options]]] = (CalibrationOptions,)

    def __init__(self, node: FrameNode) -> None:
        self._node = node
        self._filter = DisparityFilter(FilterConfig())
        self._cloud = (
            PointCloud2()
        )  # used again: new memory of this size takes longer than to fill
        self._calibrated: tuple[StereoRig, StereoRig] | None = None
        folder = node.options.of(CalibrationOptions).calibration
        self._covariance = read_rig(Path(folder).expanduser()).covariance if folder else None

    def __call__(self, measured: Measured) -> None:
        """Make and publish the outputs that somebody subscribes to."""
        health = self._node.health
        filtered = self._current_filter()(
            measured.disparity_px,
            measured.confidence,
            measured.guide,
            limits_px=measured.limits_px,
            reasons=measured.reasons,
        )
        filtered = turn_back(filtered, measured.rig.turns)
        health.state('measured', f'{filtered.measured_share:.1%} of the pixels')
        health.state('iterations', str(filtered.iterations))
        health.state('estimated error', f'{filtered.error_estimate_px:.4f} px')
        self._publish_disparity(filtered, measured)
        if self._node.wanted(*_CLOUD_OUTPUTS):
            cloud = triangulate(
                filtered.disparity_px,
                filtered.sigma_px,
                filtered.validity,
                self._with_covariance(measured.rig),
                self._node.options.of(CloudConfig),
            )
            self._publish_cloud(cloud, filtered, measured)

    def _with_covariance(self, rig: StereoRig) -> StereoRig:
        """Return the rig of the camera infos with the covariance of the calibration folder."""
        if self._calibrated is None or self._calibrated[0] is not rig:
            self._calibrated = rig, add_covariance(rig, self._covariance)
        self._node.health.state('sigma', sigma_shares(self._covariance is not None))
        return self._calibrated[1]

    def _current_filter(self) -> DisparityFilter:
        config = self._node.options.of(FilterConfig)
        if self._filter.config != config:
            self._filter = DisparityFilter(config)
        return self._filter

    def _publish_disparity(self, filtered: Filtered, measured: Measured) -> None:
        node, header = self._node, measured.header
        if node.wanted('disparity_wls'):
            message = DisparityImage()
            fill_disparity(
                message,
                filtered.disparity_px,
                measured.rig,
                measured.limits_px,
                header,
                step_px=measured.step_px,
            )
            node.publish('disparity_wls', message)
        if node.wanted('disparity_color'):
            colours = Image()
            heat = heat_map(filtered.disparity_px, measured.limits_px)
            fill_image(colours, heat, 'bgr8', header)
            node.publish('disparity_color', colours)
        if node.wanted('validity'):
            bits = Image()
            fill_image(bits, filtered.validity, 'mono8', header)
            node.publish('validity', bits)

    def _publish_cloud(self, cloud: Cloud, filtered: Filtered, measured: Measured) -> None:
        node, header = self._node, measured.header
        if node.wanted('depth', 'depth/camera_info'):
            info, depth = CameraInfo(), Image()
            fill_camera_info(info, measured.rig.left, header)
            node.publish('depth/camera_info', info)
            fill_image(depth, cloud.depth_m, '32FC1', header)
            node.publish('depth', depth)
        if node.wanted('points2'):
            options = node.options.of(CloudMessageOptions)
            colour = to_bgr8(measured.image, measured.levels) if options.use_color else None
            points = PointSet(cloud, filtered.validity, colour)
            kept, validity, colour, _ = thin(points, node.options.of(CloudConfig))
            fill_cloud(
                self._cloud,
                kept,
                header,
                PointField,
                colour=colour,
                validity=validity if options.validity else None,
                padding=not options.avoid_point_cloud_padding,
            )
            node.publish('points2', self._cloud)
