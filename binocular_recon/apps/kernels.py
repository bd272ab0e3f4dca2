# SPDX-License-Identifier: Apache-2.0
"""Compile the kernels of all programs: an installation step, so that the first start is quick."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable

import numpy as np

from binocular_recon.calibration.detection.detect import detect_rods
from binocular_recon.calibration.target.rods import RodBoard
from binocular_recon.config import ChainConfig
from binocular_recon.stereo.pipeline import warm_up

_SWITCHES: tuple[tuple[str, bool | str], ...] = (
    ('wls_guide', 'left'),
    ('wls_guide', 'disparity'),
    ('wls_complete', True),
    ('wls_complete', False),
    ('wls_extrapolate', True),
    ('wls_use_confidence', False),
)


def compile_all(presets: Iterable[str], done: Callable[[str], None] = lambda _: None) -> None:
    """Compile, or load, every kernel that nodes and commands call with these presets.

    Parameters
    ----------
    presets : iterable of str
        Among `PRESETS`.
    done : callable
        Called with the name of each part that is ready.

    """
    for preset in presets:
        # what a preset sets may be set otherwise by itself
        for name, value in _SWITCHES:
            warm_up(ChainConfig.preset(preset, **{name: value}))
        done(preset)
    compile_detection()
    done('calibration')


def compile_detection() -> None:
    """Detect the rods in a drawing of some."""
    marks_m = np.linspace(0.3, 1.8, 6)
    feet = np.column_stack([0.6 * np.arange(5), np.zeros(5)])
    board = RodBoard(feet, marks_m, 0.04, 0.005, 0.01, 0.005)
    columns = 60 + 40 * np.arange(board.count)
    image = np.full((600, columns[-1] + 60), 128, np.uint8)
    edges = 550 - np.r_[0, 500 / marks_m[-1] * marks_m, 530].astype(int)
    for column in columns:
        bands = zip(itertools.pairwise(edges), board.light_bands, strict=True)
        for (bottom, top), light in bands:
            image[top:bottom, column - 4 : column + 4] = 235 if light else 20
    detect_rods(image, board)
