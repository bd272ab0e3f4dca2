# SPDX-License-Identifier: Apache-2.0
"""From an image pair to a point cloud: rectify, match, filter, triangulate (eq. 10-18).

`pipeline` runs the chain, one line per step of the paper. Each stage has a subpackage or a module:
`rectification` maps raw images onto common rows, `search_range` finds the disparities to search,
`matching` measures them, `foreign` checks those of others, `holes` fills pixels without a match,
`filtering` denoises, `triangulation` computes metric points, `point_covariance` their covariance,
also between points, from that of the calibration; `thinning` makes clouds smaller; `validity`
tells measured from filled pixels, and `confidence` converts the standard deviation of a match to a
number in [0, 1] and back. Exports the chain and its stages.
"""

from typing import TYPE_CHECKING

from binocular_recon._lazy import lazy_exports

if TYPE_CHECKING:
    from binocular_recon.stereo.confidence import confidence_from_sigma, sigma_from_confidence
    from binocular_recon.stereo.filtering.wls_filter import (
        DisparityFilter,
        Filtered,
        filter_disparity,
    )
    from binocular_recon.stereo.matching.matcher import Match
    from binocular_recon.stereo.matching.registry import match, register_matcher
    from binocular_recon.stereo.pipeline import (
        Chain,
        DisparityEstimate,
        Reconstruction,
        estimate_disparity,
    )
    from binocular_recon.stereo.point_covariance import calibration_derivatives, joint_covariance
    from binocular_recon.stereo.rectification import Rectifier
    from binocular_recon.stereo.search_range import SearchRange
    from binocular_recon.stereo.thinning import PointSet, thin
    from binocular_recon.stereo.triangulation import Cloud, triangulate
    from binocular_recon.stereo.validity import Validity

__all__ = [
    'Chain',
    'Cloud',
    'DisparityEstimate',
    'DisparityFilter',
    'Filtered',
    'Match',
    'PointSet',
    'Reconstruction',
    'Rectifier',
    'SearchRange',
    'Validity',
    'calibration_derivatives',
    'confidence_from_sigma',
    'estimate_disparity',
    'filter_disparity',
    'joint_covariance',
    'match',
    'register_matcher',
    'sigma_from_confidence',
    'thin',
    'triangulate',
]

__getattr__ = lazy_exports(__name__, __file__)
