# SPDX-License-Identifier: Apache-2.0
"""Holes of a disparity map: what is filled, from where, and what remains unexplained.

`completion` gives pixels without a match the disparity of what lies behind them; the matcher and
the filter both use it. Exports its functions and the kernels for runs and regions of NaN.
"""

from typing import TYPE_CHECKING

from binocular_recon._lazy import lazy_exports

if TYPE_CHECKING:
    from binocular_recon.stereo.holes._hole_kernels import (
        count_holes,
        fill_from_nearest,
        fill_holes,
    )
    from binocular_recon.stereo.holes.completion import (
        COMPLETED_CONFIDENCE,
        complete,
        copy_nearest_rows,
        fill_from_background,
        unexplained_holes,
    )

__all__ = [
    'COMPLETED_CONFIDENCE',
    'complete',
    'copy_nearest_rows',
    'count_holes',
    'fill_from_background',
    'fill_from_nearest',
    'fill_holes',
    'unexplained_holes',
]

__getattr__ = lazy_exports(__name__, __file__)
