# SPDX-License-Identifier: Apache-2.0
"""Holes of a disparity map: how they are filled, and which ones half-occlusion does not explain.

`completion` gives pixels without a match the disparity of the background, or by `choice` that of
the surface which the image continues; the matcher and the filter both use it. `uncertainty` says
how far off that may be. Exports their functions, and kernels for runs and regions of NaN.
"""

from typing import TYPE_CHECKING

from binocular_recon._lazy import lazy_exports

if TYPE_CHECKING:
    from binocular_recon.stereo.holes._hole_kernels import (
        copy_from_half,
        count_hole_pixels,
    )
    from binocular_recon.stereo.holes.completion import (
        COMPLETED_CONFIDENCE,
        complete,
        copy_nearest_rows,
        fill_from_background,
        fill_from_nearest,
        unexplained_holes,
    )
    from binocular_recon.stereo.holes.uncertainty import assess_holes

__all__ = [
    'COMPLETED_CONFIDENCE',
    'assess_holes',
    'complete',
    'copy_from_half',
    'copy_nearest_rows',
    'count_hole_pixels',
    'fill_from_background',
    'fill_from_nearest',
    'unexplained_holes',
]

__getattr__ = lazy_exports(__name__, __file__)
