# SPDX-License-Identifier: Apache-2.0
"""Filter disparities and triangulate them: dense disparities, points, depth, a heat map."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
from sensor_msgs.msg import CameraInfo, Image, PointCloud2, PointField
from stereo_msgs.msg import DisparityImage

from binocular_recon.camera import StereoRig
from binocular_recon.cloud_config import CloudConfig
from binocular_recon.config import PRESETS, ChainConfig, FilterConfig
from binocular_recon.drawing.colormap import heat_map
from binocular_recon.errors import ImageError
from binocular_recon.images import ByteImage, FloatImage, mark_empty, to_bgr8, to_grey
from binocular_recon.images import Image as ImageArray
from binocular_recon.inputs.levels import Levels, LevelTracker
from binocular_recon.inputs.options import ImageConfig
from binocular_recon.io.calibration_yaml import read_rig
from binocular_recon.io.messages.camera_infos import fill_camera_info
from binocular_recon.io.messages.clouds import fill_cloud
from binocular_recon.io.messages.disparities import DisparityMap, fill_disparity, read_disparity
from binocular_recon.io.messages.images import fill_image, read_image
from binocular_recon.nodes.runtime.endpoints import Input, Output
from binocular_recon.nodes.runtime.options import (
    CalibrationOptions,
    CloudMessageOptions,
    LateInputOptions,
    PresetOptions,
    RectifiedInfoOptions,
)
from binocular_recon.nodes.runtime.process import run_node
from binocular_recon.nodes.runtime.rectified_node import RectifiedNode
from binocular_recon.stereo.filtering.wls_filter import DisparityFilter, Filtered, filter_disparity
from binocular_recon.stereo.orientation import turn, turn_back
from binocular_recon.stereo.point_covariance import add_covariance, sigma_shares
from binocular_recon.stereo.rectification import check_size
from binocular_recon.stereo.thinning import PointSet, thin
from binocular_recon.stereo.triangulation import Cloud, triangulate

_CLOUD_OUTPUTS = ('points2', 'depth', 'depth/camera_info')


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
    OUTPUTS = (
        Output('disparity_wls', DisparityImage),
        Output('points2', PointCloud2),
        Output('depth', Image),
        Output('depth/camera_info', CameraInfo),
        Output('disparity_color', Image),
        Output('validity', Image),
    )
    LIVE = (PresetOptions, FilterConfig, CloudConfig, CloudMessageOptions, ImageConfig)
    FIXED = (LateInputOptions, RectifiedInfoOptions, CalibrationOptions)

    def __init__(self) -> None:
        super().__init__()
        self._filter = DisparityFilter(FilterConfig())
        self._levels = LevelTracker()
        self._calibrated: tuple[StereoRig, StereoRig] | None = None
        folder = self.options.of(CalibrationOptions).calibration
        self._covariance = read_rig(Path(folder).expanduser()).covariance if folder else None
        self.prepare()
        self.start()

    @staticmethod
    def compile_kernels() -> None:
        """Filter noise with every preset and either guide."""
        generator = np.random.default_rng(0)
        grey = generator.uniform(0, 255, (48, 64)).astype(np.float32)
        disparity = generator.uniform(1, 8, grey.shape).astype(np.float32)
        ones = np.ones_like(grey)
        for preset, guide in itertools.product(PRESETS, ('left', 'disparity')):
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
        measured = read_disparity(disparity, rig)
        for pixels, name in ((measured.disparity_px, 'disparity'), (image, 'left')):
            check_size(pixels, rig.left.size, name)
        self._levels.config = self.options.of(ImageConfig)
        (levels,) = self._levels.update(image)
        guide = turn(to_grey(image, levels), rig.turns)
        mark_empty(guide)
        filtered = self._current_filter()(
            turn(measured.disparity_px, rig.turns),
            turn(_confidence(confidence, measured.disparity_px), rig.turns),
            guide,
            limits_px=measured.limits_px,
            reasons=_reasons(reasons, rig),
        )
        filtered = turn_back(filtered, rig.turns)
        self.health.state('measured', f'{filtered.measured_share:.1%} of the pixels')
        self.health.state('iterations', str(filtered.iterations))
        self.health.state('estimated error', f'{filtered.error_estimate_px:.4f} px')
        self._publish_disparity(filtered, measured, disparity, rig, left)
        if self.wanted(*_CLOUD_OUTPUTS):
            config = self.options.of(CloudConfig)
            cloud = triangulate(
                filtered.disparity_px,
                filtered.sigma_px,
                filtered.validity,
                self._with_covariance(rig),
                config,
            )
            self._publish_cloud(cloud, filtered, (image, levels), rig, left)

    def _with_covariance(self, rig: StereoRig) -> StereoRig:
        """Return the rig of the camera infos with the covariance of the calibration folder."""
        if self._calibrated is None or self._calibrated[0] is not rig:
            self._calibrated = rig, add_covariance(rig, self._covariance)
        self.health.state('sigma', sigma_shares(self._covariance is not None))
        return self._calibrated[1]

    def _current_filter(self) -> DisparityFilter:
        config = self.options.of(FilterConfig)
        if self._filter.config != config:
            self._filter = DisparityFilter(config)
        return self._filter

    def _publish_disparity(
        self,
        filtered: Filtered,
        measured: DisparityMap,
        source: DisparityImage,
        rig: StereoRig,
        left: Image,
    ) -> None:
        if self.wanted('disparity_wls'):
            message = DisparityImage()
            fill_disparity(
                message,
                filtered.disparity_px,
                rig,
                measured.limits_px,
                left.header,
                step_px=source.delta_d,
            )
            self.publish('disparity_wls', message)
        if self.wanted('disparity_color'):
            colours = Image()
            heat = heat_map(filtered.disparity_px, measured.limits_px)
            fill_image(colours, heat, 'bgr8', left.header)
            self.publish('disparity_color', colours)

        if self.wanted('validity'):
            bits = Image()
            fill_image(bits, filtered.validity, 'mono8', left.header)
            self.publish('validity', bits)

    def _publish_cloud(
        self,
        cloud: Cloud,
        filtered: Filtered,
        image: tuple[ImageArray, Levels],
        rig: StereoRig,
        left: Image,
    ) -> None:
        if self.wanted('depth', 'depth/camera_info'):
            info, depth = CameraInfo(), Image()
            fill_camera_info(info, rig.left, left.header)
            self.publish('depth/camera_info', info)
            fill_image(depth, cloud.depth_m, '32FC1', left.header)
            self.publish('depth', depth)
        if self.wanted('points2'):
            options = self.options.of(CloudMessageOptions)
            colour = to_bgr8(*image) if options.use_color else None
            points = PointSet(cloud, filtered.validity, colour)
            kept, validity, colour = thin(points, self.options.of(CloudConfig))
            message = PointCloud2()
            fill_cloud(
                message,
                kept,
                left.header,
                PointField,
                colour=colour,
                validity=validity if options.validity else None,
                padding=not options.avoid_point_cloud_padding,
            )
            self.publish('points2', message)


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
