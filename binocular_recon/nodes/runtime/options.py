# SPDX-License-Identifier: Apache-2.0
"""Options that only the nodes have; names that image_pipeline has keep its meaning."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2

from binocular_recon.calibration.model import DEFAULT_LENS, calibrated_lenses, lens_text
from binocular_recon.config import PRESETS
from binocular_recon.errors import ConfigError
from binocular_recon.inputs.options import PairingOptions
from binocular_recon.options import Options, option


def _queue_size(default: int, remark: str = '') -> Any:
    text = f'Messages kept per input while they wait for the rest of their frame{remark}'
    return option(default, text, minimum=1, maximum=1000)


@dataclass(frozen=True)
class QueueOptions(Options):
    """How long messages wait for others with a matching stamp."""

    queue_size: int = _queue_size(5)


@dataclass(frozen=True)
class InputOptions(PairingOptions, QueueOptions):
    """How a node receives and pairs its inputs."""

    image_transport: str = option(
        'raw', 'Transport of the incoming images', choices=('raw', 'compressed')
    )
    approximate_sync: bool = option(False, 'Combine messages whose stamps differ')
    approximate_sync_tolerance_seconds: float = option(
        0.0,
        'Largest difference of stamps within a frame with approximate_sync; 0 = any',
        unit='s',
        minimum=0.0,
        maximum=10.0,
    )

    @property
    def tolerance_ns(self) -> int | None:
        """Largest difference of stamps within a frame, None = any."""
        if not self.approximate_sync:
            return 0
        return round(self.approximate_sync_tolerance_seconds * 1e9) or None


@dataclass(frozen=True)
class LoadOptions(Options):
    """How much of the machine a node uses."""

    max_rate: float = option(
        0.0,
        'Frames per second at most; others are dropped before anything is done with them; 0: any',
        unit='Hz',
        minimum=0.0,
        maximum=1000.0,
    )
    threads: int = option(
        0, 'Threads that compute; 0: one per core of the process', minimum=0, maximum=1024
    )


@dataclass(frozen=True)
class LateInputOptions(InputOptions):
    """How a node combines images with data that another node computes from them."""

    queue_size: int = _queue_size(
        60, '; images wait for their disparities, so it must exceed matching time times frame rate'
    )


# Names of the camera infos of rectified images, beside their images: `rectify_node` publishes the
# second; cameras that rectify, and image_pipeline's nodes, have the first.
INFO_TOPICS = ('camera_info', 'camera_info_rect')


@dataclass(frozen=True)
class RectifiedInfoOptions(Options):
    """Where the camera infos of rectified images come from."""

    camera_info: str = option(
        INFO_TOPICS[0],
        'Which topics under left/ and right/ hold the camera infos of the rectified images;'
        ' camera_info_rect: those of rectify_node, which remappings of camera_info do not reach',
        choices=INFO_TOPICS,
    )


@dataclass(frozen=True)
class RectifiedImageOptions(Options):
    """Whether the cameras' images are to be rectified."""

    rectify: bool = option(
        True,
        'Rectify the images; false: take rectified ones from left/image_rect and'
        ' right/image_rect, with their infos on left/camera_info and right/camera_info',
    )


@dataclass(frozen=True)
class PresetOptions(Options):
    """Which preset sets the options that are not set explicitly."""

    preset: str = option(
        'default',
        'Set of values for all options that are not set explicitly',
        choices=tuple(PRESETS),
    )


@dataclass(frozen=True)
class RectifyOptions(Options):
    """How images are rectified."""

    alpha: float = option(
        -1.0,
        '-1: use R and P of the camera infos; 0..1: rescale P of both cameras; at 0 all rectified'
        ' pixels have data, at 1 no raw pixel is lost',
        minimum=-1.0,
        maximum=1.0,
    )
    interpolation: int = option(
        cv2.INTER_LINEAR,
        "OpenCV's interpolation method: 0 nearest, 1 linear, 2 cubic, 3 area, 4 Lanczos",
        minimum=0,
        maximum=4,
    )

    def __post_init__(self) -> None:
        """Check that alpha is in its two ranges."""
        super().__post_init__()
        if -1.0 < self.alpha < 0.0:
            raise ConfigError(f'alpha must be -1 or within 0..1, got {self.alpha:g}')


@dataclass(frozen=True)
class FrameOptions(Options):
    """What frames of rectified images are called."""

    frame_suffix: str = option(
        '',
        "Added to the cameras' frames for rectified images, and so for disparities and clouds;"
        ' the transform is published on /tf_static; empty: rectified images keep the frames of'
        ' the cameras, though R turns them',
    )


@dataclass(frozen=True)
class CalibrationOptions(Options):
    """Which calibration is used."""

    calibration: str = option(
        '',
        "Folder with left.yaml and right.yaml to use instead of the cameras' own camera infos,"
        ' and calibration.json with their covariance for sigma; or the calibration of another'
        ' program; empty: use the camera infos',
    )


@dataclass(frozen=True)
class CloudMessageOptions(Options):
    """What PointCloud2 messages contain."""

    use_color: bool = option(True, 'Give each point the colour of its pixel')
    avoid_point_cloud_padding: bool = option(
        False, 'Leave no unused bytes between the fields of a point'
    )
    validity: bool = option(
        False, 'Add a field validity: 1 measured, 2 filled between measured pixels'
    )


@dataclass(frozen=True)
class DepthBoundOptions(Options):
    """Depths to search instead of a range in pixels."""

    near: float = option(
        0.0,
        'Search from this depth on instead of min_disparity and disparity_range; 0: off',
        unit='m',
        minimum=0.0,
        maximum=1e6,
    )
    far: float = option(
        0.0, 'With near: search up to this depth; 0: infinity', unit='m', minimum=0.0, maximum=1e6
    )

    def __post_init__(self) -> None:
        """Check that the depths are in order."""
        super().__post_init__()
        if self.far and self.far <= self.near:
            raise ConfigError(
                f'near must be below far, got {self.near:g} m and {self.far:g} m (far 0: infinity)'
            )


@dataclass(frozen=True)
class RodOptions(Options):
    """Which rods are captured and where the calibration is kept."""

    rods: str = option('', 'File rods.yaml that describes the rods')
    lens: str = option(DEFAULT_LENS, lens_text().capitalize(), choices=calibrated_lenses())
    output: str = option('', 'Folder of the calibration; captures are kept in captures/ under it')
    left_camera_name: str = option('left', 'Name of the left camera in its calibration file')
    right_camera_name: str = option('right', 'Name of the right camera in its calibration file')
    calibration: str = option(
        '',
        'Folder with left.yaml and right.yaml, or the calibration of another program; capture'
        ' then reports by how many rows the marks differ after rectification with it and how far'
        ' lengths are off. Empty: it does not',
    )
