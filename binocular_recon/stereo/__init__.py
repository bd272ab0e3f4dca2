# SPDX-License-Identifier: Apache-2.0
"""From a stereo pair to a point cloud: rectify, match, filter, triangulate (eq. 10-18).

`pipeline` runs the chain and reads like the paper. Each stage has a room or a module:
`rectification` maps raw images onto common rows, `matching` measures disparities, `holes`
completes what was not measured, `filtering` denoises, `triangulation` makes metric points;
`confidence` says how a match and its standard deviation are written as one number. Exports the
chain and its stages.
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
    from binocular_recon.stereo.matching.matcher import Match, match
    from binocular_recon.stereo.pipeline import Chain, Reconstruction, estimate_disparity
    from binocular_recon.stereo.rectification import Rectifier
    from binocular_recon.stereo.triangulation import Cloud, triangulate

__all__ = [
    'Chain',
    'Cloud',
    'DisparityFilter',
    'Filtered',
    'Match',
    'Reconstruction',
    'Rectifier',
    'confidence_from_sigma',
    'estimate_disparity',
    'filter_disparity',
    'match',
    'sigma_from_confidence',
    'triangulate',
]

__getattr__ = lazy_exports(__name__, __file__)
