# SPDX-License-Identifier: Apache-2.0
"""Refinement of chosen disparities, between selection and the filter.

`smoothing` moves them onto planes and states their standard deviation; `rejection` drops speckles
and flying pixels. Exports their functions, which change the disparities in place.
"""

from typing import TYPE_CHECKING

from binocular_recon._lazy import lazy_exports

if TYPE_CHECKING:
    from binocular_recon.stereo.matching.refinement.rejection import drop_flying, drop_speckles
    from binocular_recon.stereo.matching.refinement.smoothing import smooth

__all__ = ['drop_flying', 'drop_speckles', 'smooth']

__getattr__ = lazy_exports(__name__, __file__)
