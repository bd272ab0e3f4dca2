# SPDX-License-Identifier: Apache-2.0
"""One cloud of many frames.

`over_time` averages the frames of a rig that stands still, pixel by pixel, and says what is left
of their standard deviation; `standing_still` tells whether it did stand still.
"""

from typing import TYPE_CHECKING

from binocular_recon._lazy import lazy_exports

if TYPE_CHECKING:
    from binocular_recon.merging.over_time import TimeAverage, average, sigma_of
    from binocular_recon.merging.standing_still import Corners, moved_px

__all__ = ['Corners', 'TimeAverage', 'average', 'moved_px', 'sigma_of']

__getattr__ = lazy_exports(__name__, __file__)
