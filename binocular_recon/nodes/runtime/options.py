# SPDX-License-Identifier: Apache-2.0
"""Options that only the nodes have. Names that image_pipeline knows keep its meaning."""

from __future__ import annotations

from dataclasses import dataclass

import cv2

from binocular_recon.config import PRESETS
from binocular_recon.errors import ConfigError
from binocular_recon.options import Options, option


@dataclass(frozen=True)
class QueueOptions(Options):
    """How long a node waits for messages that belong together."""

    queue_size: int = option(
        5, 'Messages of an input that wait for their partners', minimum=1, maximum=1000
    )


@dataclass(frozen=True)
class InputOptions(QueueOptions):
    """How a node receives and pairs its inputs."""

    image_transport: str = option(
        'raw', 'Form in which pictures arrive', choices=('raw', 'compressed')
    )
    approximate_sync: bool = option(False, 'Pair inputs whose stamps differ')
    approximate_sync_tolerance_seconds: float = option(
        0.0,
        'Largest difference of stamps in a pair with approximate_sync; 0 = any',
        unit='s',
        minimum=0.0,
        maximum=10.0,
    )

    @property
    def tolerance_ns(self) -> int | None:
        """Largest difference of stamps in a pair, None = any."""
        if not self.approximate_sync:
            return 0
        return round(self.approximate_sync_tolerance_seconds * 1e9) or None


@dataclass(frozen=True)
class LateInputOptions(InputOptions):
    """How a node pairs pictures with what another node made of them a while later."""

    queue_size: int = option(
        60,
        'Messages of an input that wait for their partners: pictures wait for their disparities,'
        ' so more than matching time times frame rate',
        minimum=1,
        maximum=1000,
    )


@dataclass(frozen=True)
class PresetOptions(Options):
    """Which preset gives the values that are not set explicitly."""

    preset: str = option(
        'default',
        'Named set of values for all options that are not set explicitly',
        choices=tuple(PRESETS),
    )


@dataclass(frozen=True)
class RectifyOptions(Options):
    """How pictures are rectified."""

    alpha: float = option(
        -1.0,
        "-1: use the camera infos' R and P; 0..1: scale P of both cameras so that at 0 all pixels"
        ' have data and at 1 no raw pixel is lost',
        minimum=-1.0,
        maximum=1.0,
    )
    interpolation: int = option(
        cv2.INTER_LINEAR,
        "OpenCV's interpolation: 0 nearest, 1 linear, 2 cubic, 3 area, 4 Lanczos",
        minimum=0,
        maximum=4,
    )

    def __post_init__(self) -> None:
        """Check that alpha is in its two ranges."""
        super().__post_init__()
        if -1.0 < self.alpha < 0.0:
            raise ConfigError(f'alpha must be -1 or within 0..1, got {self.alpha:g}')


@dataclass(frozen=True)
class CalibrationOptions(Options):
    """Where the calibration comes from."""

    calibration: str = option(
        '',
        "Folder with left.yaml and right.yaml that replaces the cameras' own camera infos; empty:"
        ' use theirs',
    )


@dataclass(frozen=True)
class CloudMessageOptions(Options):
    """What PointCloud2 messages hold."""

    use_color: bool = option(True, 'Give each point the colour of its pixel')
    avoid_point_cloud_padding: bool = option(
        False, 'Leave no unused bytes between the fields of a point'
    )
