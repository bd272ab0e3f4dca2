# SPDX-License-Identifier: Apache-2.0
"""Matching: rectified rows become disparities by zero-mean NCC (eq. 10).

`matcher` runs the steps. `_layout` prepares the images; `_ncc_kernels` scores windows and
`_selection_kernels` takes the best (winner takes all); `_cost_kernels`, `_aggregation_kernels`
and `_semi_global` do the same semi-globally; `refinement` smooths along planes,
`half_resolution` matches where noise hides texture, `consensus` lets several matches vote.
Exports `match` and its result `Match`.
"""

from typing import TYPE_CHECKING

from binocular_recon._lazy import lazy_exports

if TYPE_CHECKING:
    from binocular_recon.stereo.matching.matcher import Match, disparity_step_px, match, ncc_scores

__all__ = [
    'Match',
    'disparity_step_px',
    'match',
    'ncc_scores',
]

__getattr__ = lazy_exports(__name__, __file__)
