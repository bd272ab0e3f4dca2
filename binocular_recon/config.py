# SPDX-License-Identifier: Apache-2.0
"""Options of the chain: every default, unit, range and description is written here and only here.

Nodes declare their ROS parameters from these fields, the command line its options, and the
documentation its tables. Names shared with image_pipeline keep its meaning.
"""

from __future__ import annotations

import dataclasses
import math
import re
from dataclasses import dataclass, field
from typing import Any

from binocular_recon.errors import ConfigError
from binocular_recon.options import Options, OptionValue, option


@dataclass(frozen=True)
class MatchConfig(Options):
    """How rectified rows are matched (eq. 10 and what follows it)."""

    min_disparity: int = option(
        0, 'Smallest disparity searched', unit='px', minimum=-2048, maximum=2048
    )
    disparity_range: int = option(
        0,
        'Number of disparities searched; 0: found from the images, and min_disparity with it'
        ' unless that is set',
        unit='px',
        minimum=0,
        maximum=4096,
    )
    correlation_window_size: int = option(
        5, 'Side of the square correlation window; odd', unit='px', minimum=3, maximum=31, step=2
    )
    semi_global: bool = option(
        True, 'Aggregate the scores along rows and down columns; off: each pixel by itself'
    )
    # the P1 and P2 of Hirschmueller, but in other units than OpenCV's and stereo_image_proc's
    small_step_penalty: int = option(
        30,
        'Semi-global: penalty of a step of one disparity between neighbours; 63 is the cost of'
        ' score 0',
        minimum=0,
        maximum=192,
        step=2,
    )
    large_step_penalty: int = option(
        190,
        'Semi-global: penalty of a larger step where neighbours are equally bright',
        minimum=0,
        maximum=192,
    )
    half_resolution: bool = option(
        True, 'Pixels without a match take that at half resolution, where it sees most of a hole'
    )
    consensus: bool = option(
        False,
        'Match with the next smaller and larger window too, each from both cameras; keep what'
        ' half of these agree on',
    )
    texture_threshold: float = option(
        0.5,
        'Least standard deviation of a window, in grey levels of 255',
        unit='grey levels',
        minimum=0.0,
        maximum=127.0,
    )
    uniqueness_ratio: float = option(
        10.0,
        "Percent by which the best score's 1 - NCC (semi-global: its sum over paths) must beat"
        ' the second best that is not its neighbour',
        unit='%',
        minimum=0.0,
        maximum=100.0,
    )
    disp12_max_diff: float = option(
        1.0,
        'Largest difference between left-to-right and right-to-left disparity; negative = off',
        unit='px',
        minimum=-1.0,
        maximum=128.0,
    )
    subpixel: bool = option(True, 'Interpolate between whole disparities')
    speckle_size: int = option(
        200, 'Smaller connected regions are invalid', unit='px', minimum=0, maximum=100_000
    )
    speckle_range: float = option(
        1.0,
        'Largest step of disparity inside a connected region',
        unit='px',
        minimum=0.0,
        maximum=64.0,
    )

    def __post_init__(self) -> None:
        """Check that a larger step costs at least as much as a small one."""
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
        """Whether the range is to be found from the images."""
        return self.disparity_range == 0

    @property
    def limits_px(self) -> tuple[float, float]:
        """Smallest and largest disparity searched, px; a ConfigError if yet to be found."""
        if self.finds_range:
            raise ConfigError(
                'disparity_range is 0, to be found from the images; apply search_range.find_range'
                ' first, or set it'
            )
        return float(self.min_disparity), float(self.min_disparity + self.disparity_range - 1)


@dataclass(frozen=True)
class FilterConfig(Options):
    """How the disparity map is denoised and completed (eq. 11-15)."""

    wls_lambda: float = option(
        0.02, 'Weight of smoothness against data', minimum=1e-6, maximum=1000.0
    )
    wls_alpha: float = option(
        1.2, "Sensitivity to the guide's gradients", minimum=0.0, maximum=4.0
    )
    wls_epsilon: float = option(
        1e-4,
        'Added to the gradient term so that flat regions stay finite',
        minimum=1e-8,
        maximum=1.0,
    )
    wls_guide: str = option(
        'left', 'Image whose edges are preserved', choices=('left', 'disparity')
    )
    wls_use_confidence: bool = option(
        True,
        "Weigh each pixel by its match's confidence; off: by 1, and a pixel without a match takes"
        ' the nearest in its row',
    )
    wls_complete: bool = option(
        True,
        'Pixels without a match take the disparity of what lies behind them, with a small'
        ' confidence; off: smoothness alone fills them',
    )
    wls_extrapolate: bool = option(
        False,
        'Columns out of sight of the right camera continue the slope of the surface next to them;'
        ' off: its disparity',
    )
    wls_disparity_steps: float = option(
        0.1,
        'Sensitivity to steps of the disparity: times their square, added to the gradient term',
        unit='1/px^2',
        minimum=0.0,
        maximum=100.0,
    )
    wls_tolerance_px: float = option(
        0.01,
        'Largest error of the solution against the exact one',
        unit='px',
        minimum=1e-5,
        maximum=1.0,
    )
    wls_video: bool = option(
        False,
        "Start each frame from the last one's solution; frames then depend on those before them,"
        ' within the tolerance',
    )


# A depth whose standard deviation is a third of it may be any; it is never a point.
LARGEST_SIGMA_SHARE = 1 / 3


@dataclass(frozen=True)
class CloudConfig(Options):
    """Which points the cloud holds (eq. 16-18)."""

    min_depth: float = option(
        0.0, 'Nearer points are left out', unit='m', minimum=0.0, maximum=1e6
    )
    max_depth: float = option(
        1e6, 'Farther points are left out', unit='m', minimum=0.0, maximum=1e6
    )
    keep: str = option(
        'all',
        'Points of the cloud: measured ones only, or filled ones between them too',
        choices=('measured', 'all'),
    )
    max_sigma: str = option(
        '10%',
        'Points with a larger standard deviation of depth are left out: metres, or with % a share'
        ' of the depth; those of a third of the depth or more always are',
    )

    @property
    def sigma_limit(self) -> tuple[float, float]:
        """Largest standard deviation of a point's depth: metres, and as a share of its depth."""
        text = self.max_sigma.strip()
        value = float(text.removesuffix('%'))
        if text.endswith('%'):
            return math.inf, min(value / 100, LARGEST_SIGMA_SHARE)
        return value, LARGEST_SIGMA_SHARE

    def __post_init__(self) -> None:
        """Check that the range is not empty and ``max_sigma`` a number above 0."""
        super().__post_init__()
        if not re.fullmatch(r'\s*(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?\s*%?\s*', self.max_sigma) or (
            min(self.sigma_limit) <= 0
        ):
            raise ConfigError(
                f'max_sigma must be metres or a share of the depth, such as 0.05 or 10%, above 0,'
                f' got {self.max_sigma!r}'
            )
        if self.min_depth > self.max_depth:
            raise ConfigError(
                f'min_depth must be at most max_depth, got {self.min_depth:g} m and'
                f' {self.max_depth:g} m'
            )


@dataclass(frozen=True)
class ChainConfig:
    """All options of the chain."""

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
            Options of any group by name; an explicit value wins over the preset's.

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


# What each preset changes; the rest are the fields' defaults.
PRESETS: dict[str, dict[str, OptionValue]] = {
    # exactly the paper's method, as docs/method.md defines it
    'paper': {
        'semi_global': False,
        'correlation_window_size': 9,
        'half_resolution': False,
        'texture_threshold': 0.0,
        'disp12_max_diff': -1.0,
        'uniqueness_ratio': 0.0,
        'subpixel': False,
        'speckle_size': 0,
        'wls_lambda': 0.35,
        'wls_alpha': 1.8,
        'wls_epsilon': 1e-4,
        'wls_use_confidence': False,
        'wls_complete': False,
        'wls_disparity_steps': 0.0,
    },
    # no volume, each pixel by itself: for high frame rates
    'fast': {'semi_global': False, 'correlation_window_size': 7, 'uniqueness_ratio': 2.0},
    'default': {},
    # several matches of each pair: where time matters less
    'accurate': {'consensus': True, 'wls_extrapolate': True},
}
