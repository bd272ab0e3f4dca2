# SPDX-License-Identifier: Apache-2.0
"""Options of the chain: the one place for their defaults, units, ranges and descriptions.

The nodes' ROS parameters, the command line's options and the tables of the documentation are made
from these fields; `inputs.options` holds those of the input, `cloud_config` those of the points,
`stereo.foreign.conventions` those of networks. Names shared with image_pipeline have the same
meaning there.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from typing import Any

from binocular_recon.cloud_config import CloudConfig
from binocular_recon.errors import ConfigError
from binocular_recon.inputs.options import ImageConfig
from binocular_recon.options import Options, OptionValue, option
from binocular_recon.stereo.foreign.conventions import NetworkConfig

# Values of the option `matcher`: the built-in ones, and those that `register_matcher` adds.
MATCHER_NAMES = ['ncc', 'onnx']


@dataclass(frozen=True)
class CorrelationConfig(Options):
    """Options of the matcher, its search range and the built-in one (eq. 10 and its checks)."""

    matcher: str = option(
        'ncc',
        'Matching algorithm; onnx: the network onnx_model; programs can register others',
        choices=MATCHER_NAMES,
    )

    min_disparity: int = option(
        0, 'Smallest disparity searched', unit='px', minimum=-2048, maximum=2048
    )
    disparity_range: int = option(
        0,
        'Number of disparities searched; 0: found from the images, like min_disparity unless'
        ' that is set',
        unit='px',
        minimum=0,
        maximum=4096,
    )
    correlation_window_size: int = option(
        5, 'Side of the square correlation window; odd', unit='px', minimum=3, maximum=31, step=2
    )
    semi_global: bool = option(
        True,
        'Semi-global matching: aggregate the scores along rows and down columns; off: each pixel'
        ' takes its best score (winner takes all)',
    )
    # Hirschmueller's P1 and P2, in other units than those of OpenCV and stereo_image_proc
    small_step_penalty: int = option(
        30,
        'Semi-global matching: penalty for neighbours whose disparities differ by 1 px; 63 is the'
        ' cost of a pixel with score 0',
        minimum=0,
        maximum=192,
        step=2,
    )
    large_step_penalty: int = option(
        190,
        'Semi-global matching: penalty for a larger step between equally bright neighbours',
        minimum=0,
        maximum=192,
    )
    coarse_to_fine: bool = option(
        False,
        'Match at half resolution, and at full resolution only near the disparities found there',
    )
    half_resolution: bool = option(
        True, 'Fill holes from a match at half resolution where that covers most of the hole'
    )
    consensus: bool = option(
        False,
        'Match with the next smaller and the next larger window too, each from both cameras, and'
        ' keep disparities on which at least half of these matches agree',
    )
    texture_threshold: float = option(
        0.5,
        'Smallest standard deviation of the grey levels (0..255) in a window that is matched',
        unit='grey levels',
        minimum=0.0,
        maximum=127.0,
    )
    uniqueness_ratio: float = option(
        10.0,
        'Margin by which 1 - NCC of the best disparity (semi-global: its cost summed over paths)'
        ' must be below that of the second best that is not its neighbour; 0 = off',
        unit='%',
        minimum=0.0,
        maximum=100.0,
    )
    disp12_max_diff: float = option(
        1.0,
        'Left-right check: largest difference between the disparities found from the left and'
        ' from the right image; negative = off',
        unit='px',
        minimum=-1.0,
        maximum=128.0,
    )
    subpixel: bool = option(True, 'Interpolate between whole disparities')
    speckle_size: int = option(
        200, 'Smaller connected regions are dropped', unit='px', minimum=0, maximum=100_000
    )
    speckle_range: float = option(
        1.0,
        'Largest difference between the disparities of neighbours in a connected region',
        unit='px',
        minimum=0.0,
        maximum=64.0,
    )
    edge_support: int = option(
        20,
        'Fewest pixels of similar disparity around a match at an edge of disparity, in 7x7 px;'
        ' matches with fewer lie between the surfaces and are dropped; 0 = off',
        unit='px',
        minimum=0,
        maximum=49,
    )

    def __post_init__(self) -> None:
        """Check that a large step costs at least as much as a small one."""
        super().__post_init__()
        if self.disparity_range == 1:
            raise ConfigError(
                'disparity_range must be within 2..4096 px, or 0 to find it from the images, got 1'
            )
        small, large = self.small_step_penalty, self.large_step_penalty
        if small > large:
            raise ConfigError(
                f'small_step_penalty must be at most large_step_penalty, got {small} and {large}'
            )

    @property
    def finds_range(self) -> bool:
        """Whether the search range is to be found from the images."""
        return self.disparity_range == 0

    @property
    def limits_px(self) -> tuple[float, float]:
        """Smallest and largest disparity searched, px; a ConfigError if `finds_range`."""
        if self.finds_range:
            raise ConfigError(
                'disparity_range is 0, to be found from the images; set it, or call'
                ' search_range.choose_range first'
            )
        return float(self.min_disparity), float(self.min_disparity + self.disparity_range - 1)


@dataclass(frozen=True)
class MatchConfig(NetworkConfig, CorrelationConfig):
    """Options of matching, by correlation or by a network."""

    def __post_init__(self) -> None:
        """Check that a network is named where one is to match."""
        super().__post_init__()
        if self.matcher == 'onnx' and not self.onnx_model:
            raise ConfigError('matcher onnx needs onnx_model, the file of the network')


@dataclass(frozen=True)
class FilterConfig(Options):
    """Options of the filter that denoises and completes the disparity map (eq. 11-15)."""

    wls_lambda: float = option(
        0.02, 'Weight of smoothness relative to the data', minimum=1e-6, maximum=1000.0
    )
    wls_alpha: float = option(
        1.2, 'Exponent of the gradient term: sensitivity to edges', minimum=0.0, maximum=4.0
    )
    wls_epsilon: float = option(
        1e-4, 'Added to the gradient term; limits smoothing', minimum=1e-8, maximum=1.0
    )
    wls_guide: str = option(
        'left', 'Image whose edges are preserved', choices=('left', 'disparity')
    )
    wls_use_confidence: bool = option(
        True,
        'Weight each pixel by the confidence of its match; off: all weights are 1, and pixels'
        ' without a match take the nearest disparity of their row',
    )
    wls_complete: bool = option(
        True,
        'Give pixels without a match the disparity of the background, with a small weight; off:'
        ' they are filled by smoothness alone',
    )
    wls_extrapolate: bool = option(
        True,
        'In columns that the right camera does not see, continue the slope of the adjacent'
        ' surface; off: continue its disparity',
    )
    wls_disparity_steps: float = option(
        0.1,
        'Sensitivity to disparity steps: factor on their square, added to the gradient term',
        unit='1/px^2',
        minimum=0.0,
        maximum=100.0,
    )
    wls_tolerance_px: float = option(
        0.01, 'Largest error of the solver', unit='px', minimum=1e-5, maximum=1.0
    )
    wls_video: bool = option(
        False,
        'Start the solver from the solution of the previous frame; faster, but results then depend'
        ' on earlier frames, within the tolerance',
    )


@dataclass(frozen=True)
class ChainConfig:
    """All options of the chain."""

    images: ImageConfig = field(default_factory=ImageConfig)
    match: MatchConfig = field(default_factory=MatchConfig)
    filter: FilterConfig = field(default_factory=FilterConfig)
    cloud: CloudConfig = field(default_factory=CloudConfig)

    @classmethod
    def preset(cls, name: str, **overrides: OptionValue) -> ChainConfig:
        """Return preset ``name`` with single options replaced.

        Parameters
        ----------
        name : str
            One of ``PRESETS``.
        **overrides : bool, int, float or str
            Options of any group by name; they override the preset's values.

        Raises
        ------
        ConfigError
            If the preset or an option is unknown or a value is out of range.

        """
        if name not in PRESETS:
            raise ConfigError(f'preset must be one of {", ".join(PRESETS)}, got {name!r}')
        values = {**PRESETS[name], **overrides}
        groups = {}
        for group in dataclasses.fields(cls):
            kind: Any = group.default_factory
            names = {spec.name for spec in dataclasses.fields(kind)}
            groups[group.name] = kind(**{key: values.pop(key) for key in names & values.keys()})
        if values:
            raise ConfigError(f'unknown options: {", ".join(sorted(values))}')
        return cls(**groups)


# The options that each preset changes; all others keep their defaults.
PRESETS: dict[str, dict[str, OptionValue]] = {
    # the paper's method exactly, as defined in docs/method.md
    'paper': {
        'semi_global': False,
        'correlation_window_size': 9,
        'half_resolution': False,
        'texture_threshold': 0.0,
        'disp12_max_diff': -1.0,
        'uniqueness_ratio': 0.0,
        'subpixel': False,
        'speckle_size': 0,
        'edge_support': 0,
        'wls_lambda': 0.35,
        'wls_alpha': 1.8,
        'wls_epsilon': 1e-4,
        'wls_use_confidence': False,
        'wls_complete': False,
        'wls_extrapolate': False,
        'wls_disparity_steps': 0.0,
    },
    # an eighth of the disparities of all pixels: for high frame rates
    'fast': {
        'coarse_to_fine': True,
        'correlation_window_size': 3,
        'half_resolution': False,
    },
    'default': {},
    # several matches per pair: where time matters less
    'accurate': {'consensus': True},
}
