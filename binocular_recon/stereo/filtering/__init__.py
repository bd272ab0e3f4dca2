# SPDX-License-Identifier: Apache-2.0
"""The edge-preserving weighted least squares filter and its solver (eq. 11-15).

`wls_filter` is the filter; `_equations` builds its normal equations; `_wls_solver` solves them
by conjugate gradients with a multigrid preconditioner, whose levels are in `_grids` and whose
kernels are in the modules ``_*_kernels``. Exports `filter_disparity` for a single image pair and
`DisparityFilter` for a stream.
"""

from typing import TYPE_CHECKING

from binocular_recon._lazy import lazy_exports

if TYPE_CHECKING:
    from binocular_recon.stereo.filtering._equations import Equations, normal_equations
    from binocular_recon.stereo.filtering.wls_filter import (
        DisparityFilter,
        Filtered,
        filter_disparity,
    )

__all__ = [
    'DisparityFilter',
    'Equations',
    'Filtered',
    'filter_disparity',
    'normal_equations',
]

__getattr__ = lazy_exports(__name__, __file__)
