# SPDX-License-Identifier: Apache-2.0
"""Options of networks that match, a part of `config`: the file and its conventions."""

from __future__ import annotations

import math
from dataclasses import dataclass

from binocular_recon.errors import ConfigError, shortened
from binocular_recon.options import Options, option


@dataclass(frozen=True)
class NetworkConfig(Options):
    """Options of the matcher 'onnx'."""

    onnx_model: str = option('', 'Network for the matcher onnx: a file .onnx that takes a pair')
    onnx_channels: str = option(
        'rgb', 'Channels of the images that the network takes', choices=('rgb', 'bgr', 'grey')
    )
    onnx_layout: str = option(
        'nchw',
        'Axes of its inputs: nchw: channels before rows and columns; nhwc: after them',
        choices=('nchw', 'nhwc'),
    )
    onnx_scale: float = option(
        1.0,
        'It takes (scale * level - mean) / std of the levels 0..255; scale: 1, or 0.00392157 for'
        ' levels 0..1',
        minimum=1e-6,
        maximum=1000.0,
    )
    onnx_mean: str = option(
        '0.0', 'The mean of that: a number, or one per channel in its order, with commas'
    )
    onnx_std: str = option(
        '1.0', 'The std of that: a number, or one per channel in its order, with commas'
    )
    onnx_multiple: int = option(
        32,
        'Images are padded on the right and below to a multiple of this',
        unit='px',
        minimum=1,
        maximum=1024,
    )
    onnx_output: str = option('', 'Name of the output that is the disparity; empty: the first')
    onnx_output_scale: float = option(
        1.0,
        'Factor that makes it x_left - x_right in px; -1 for networks that give the flow to the'
        ' right image',
        minimum=-10000.0,
        maximum=10000.0,
    )

    def __post_init__(self) -> None:
        """Check the numbers per channel."""
        super().__post_init__()
        _ = self.onnx_mean_by_channel
        if min(self.onnx_std_by_channel) <= 0:
            raise ConfigError(f'onnx_std must be above 0, got {self.onnx_std!r}')
        if self.onnx_output_scale == 0:
            raise ConfigError('onnx_output_scale must not be 0: every disparity would be 0')

    @property
    def onnx_mean_by_channel(self) -> tuple[float, ...]:
        """The mean: one number, or one per channel."""
        return _numbers('onnx_mean', self.onnx_mean, self.onnx_channels)

    @property
    def onnx_std_by_channel(self) -> tuple[float, ...]:
        """The standard deviation: one number, or one per channel."""
        return _numbers('onnx_std', self.onnx_std, self.onnx_channels)


def _numbers(name: str, text: str, channels: str) -> tuple[float, ...]:
    try:
        values = tuple(float(word) for word in text.split(','))
    except ValueError:
        values = (math.nan,)
    if not all(map(math.isfinite, values)) or len(values) not in (
        1,
        1 if channels == 'grey' else 3,
    ):
        wanted = 'a number' if channels == 'grey' else 'a number, or three with commas'
        raise ConfigError(f'{name} must be {wanted}, got {shortened(text)}')
    return values
