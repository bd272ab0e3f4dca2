# SPDX-License-Identifier: Apache-2.0
"""Matching: rectified rows become disparities, by default by zero-mean NCC (eq. 10).

`registry` has the matchers by name and `match`, which calls one. `matcher` is the built-in one,
step by step: `_preparation` prepares the images; `_ncc_kernels` scores windows and
`_selection_kernels` takes the best score (winner takes all); `_cost_kernels`,
`_aggregation_kernels` and `_semi_global` are semi-global matching; `refinement` drops speckles and
smooths along planes, `half_resolution` matches low texture, `consensus` lets several matches vote.
Exports `match`, its result `Match`, and `register_matcher`.
"""

from typing import TYPE_CHECKING

from binocular_recon._lazy import lazy_exports

if TYPE_CHECKING:
    from binocular_recon.stereo.matching.matcher import Match, disparity_step_px, ncc_scores
    from binocular_recon.stereo.matching.registry import Matcher, match, register_matcher

__all__ = [
    'Match',
    'Matcher',
    'disparity_step_px',
    'match',
    'ncc_scores',
    'register_matcher',
]

__getattr__ = lazy_exports(__name__, __file__)
