# SPDX-License-Identifier: Apache-2.0
"""Estimation of a calibration from marks, and how certain it is.

`planar` is Zhang's method per camera, the start (`fisheye_start` for fisheye lenses);
`bundle_adjustment` adjusts both cameras, all boards and every rod together (`linearisation`:
predictions and derivatives); `estimation` adds what must be found out on the way: noise, outliers,
bad boards; `tone_curve` finds edges that a tone curve shifts; `distortion` chooses the lens terms;
`split_halves` checks the covariance on halves of the boards; `uncertainty` says what it means for
depth.
"""

from typing import TYPE_CHECKING

from binocular_recon._lazy import lazy_exports

if TYPE_CHECKING:
    from binocular_recon.calibration.adjustment.bundle_adjustment import Problem, minimise
    from binocular_recon.calibration.adjustment.distortion import Evidence, compare_models
    from binocular_recon.calibration.adjustment.estimation import Estimate, estimate
    from binocular_recon.calibration.adjustment.linearisation import State, predict
    from binocular_recon.calibration.adjustment.planar import calibrate_planar
    from binocular_recon.calibration.adjustment.split_halves import SplitHalves, compare_halves
    from binocular_recon.calibration.adjustment.uncertainty import (
        baseline_sigma_m,
        depth_sigma_m,
        matching_sigma_m,
    )

__all__ = [
    'Estimate',
    'Evidence',
    'Problem',
    'SplitHalves',
    'State',
    'baseline_sigma_m',
    'calibrate_planar',
    'compare_halves',
    'compare_models',
    'depth_sigma_m',
    'estimate',
    'matching_sigma_m',
    'minimise',
    'predict',
]

__getattr__ = lazy_exports(__name__, __file__)
