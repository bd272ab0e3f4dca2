# SPDX-License-Identifier: Apache-2.0
"""Accurate 3-D point clouds of large scenes from a long-baseline stereo rig.

This is the public interface: what a program needs to turn image pairs into clouds. `Chain` runs
rectification, matching, filtering and triangulation; `ChainConfig` holds every option;
`read_rig` reads a calibration; all errors derive from `BinocularReconError`. The subpackages
export the rest: `stereo` (the chain's stages), `calibration`, `measurement`, `io`, `drawing`,
`simulation`, `evaluation`, `apps`, `viewer`, and the front ends `nodes` and `cli`.
"""

from typing import TYPE_CHECKING

from binocular_recon._lazy import lazy_exports

if TYPE_CHECKING:
    from binocular_recon.camera import Camera, StereoRig
    from binocular_recon.config import PRESETS, ChainConfig
    from binocular_recon.errors import (
        BagError,
        BinocularReconError,
        CalibrationError,
        ConfigError,
        FileError,
        ImageError,
    )
    from binocular_recon.io.calibration_yaml import read_rig
    from binocular_recon.stereo.pipeline import Chain, Reconstruction

__all__ = [
    'PRESETS',
    'BagError',
    'BinocularReconError',
    'CalibrationError',
    'Camera',
    'Chain',
    'ChainConfig',
    'ConfigError',
    'FileError',
    'ImageError',
    'Reconstruction',
    'StereoRig',
    '__version__',
    'read_rig',
]

__version__ = '0.1.0'

__getattr__ = lazy_exports(__name__, __file__)
