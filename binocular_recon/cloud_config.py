# SPDX-License-Identifier: Apache-2.0
"""Options of the cloud, a part of `config`: which points it has, and how many."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from binocular_recon.errors import ConfigError
from binocular_recon.options import Options, option

# A depth with a larger standard deviation, as a share of it, says nothing: there is no point.
LARGEST_SIGMA_SHARE = 1 / 3
# Smaller voxels than any rig resolves; their number would not be counted.
LEAST_VOXEL_M = 1e-4


@dataclass(frozen=True)
class CloudConfig(Options):
    """Options of triangulation (eq. 16-18)."""

    min_depth: float = option(
        0.0, 'Points nearer than this are left out', unit='m', minimum=0.0, maximum=1e6
    )
    max_depth: float = option(
        1e6, 'Points farther than this are left out', unit='m', minimum=0.0, maximum=1e6
    )
    keep: str = option(
        'all', 'Keep measured points only, or filled ones too', choices=('measured', 'all')
    )
    max_sigma: str = option(
        '10%',
        'Points whose depth has a larger standard deviation are left out: in metres, or with % as'
        ' a share of the depth; from a third of the depth on always',
    )
    decimation: int = option(
        1, 'Every n-th row and column of the cloud is kept', minimum=1, maximum=64
    )
    voxel_size: float = option(
        0.0,
        'Edge of the cubes in which the points of the cloud are replaced by their mean; it is not'
        ' organised then; 0: off',
        unit='m',
        minimum=0.0,
        maximum=100.0,
    )

    @property
    def sigma_limit(self) -> tuple[float, float]:
        """Largest standard deviation of the depth of a point: in metres, and as a share of it."""
        text = self.max_sigma.strip()
        value = float(text.removesuffix('%'))
        if text.endswith('%'):
            return math.inf, min(value / 100, LARGEST_SIGMA_SHARE)
        return value, LARGEST_SIGMA_SHARE

    def __post_init__(self) -> None:
        """Check that the depth range is not empty and that ``max_sigma`` is a number above 0."""
        super().__post_init__()
        if not re.fullmatch(r'\s*(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?\s*%?\s*', self.max_sigma) or (
            min(self.sigma_limit) <= 0
        ):
            raise ConfigError(
                'max_sigma must be metres or a share of the depth, above 0, such as 0.05 or 10%,'
                f' got {self.max_sigma!r}'
            )
        if 0 < self.voxel_size < LEAST_VOXEL_M:
            raise ConfigError(
                f'voxel_size must be at least {LEAST_VOXEL_M:g} m, or 0 to keep every point, got'
                f' {self.voxel_size:g}'
            )
        if self.min_depth > self.max_depth:
            raise ConfigError(
                f'min_depth must be at most max_depth, got {self.min_depth:g} m and'
                f' {self.max_depth:g} m'
            )
