# SPDX-License-Identifier: Apache-2.0
"""Coarse to fine: a match of half the resolution, refined at full resolution.

`guided` scores a few disparities around those of the coarse match and checks the result. Of its
kernels, `_guess_kernels` work at half resolution, `_guided_kernels` score at full resolution, and
`_visibility_kernels` drop what is hidden. Exports `refine_coarse` and the options of the coarse
match.
"""

from typing import TYPE_CHECKING

from binocular_recon._lazy import lazy_exports

if TYPE_CHECKING:
    from binocular_recon.stereo.matching.coarse_to_fine.guided import (
        coarse_config,
        is_noise,
        refine_coarse,
    )

__all__ = ['coarse_config', 'is_noise', 'refine_coarse']

__getattr__ = lazy_exports(__name__, __file__)
