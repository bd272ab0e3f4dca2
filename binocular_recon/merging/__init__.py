# SPDX-License-Identifier: Apache-2.0
"""One cloud of many frames.

`over_time` averages the frames of a rig that stands still, pixel by pixel, and says what is left
of their standard deviation; `standing_still` tells whether it did stand still. `overlap` finds the
pose of one station against another from what both see, `voxels` makes one cloud of several.
"""

from typing import TYPE_CHECKING

from binocular_recon._lazy import lazy_exports

if TYPE_CHECKING:
    from binocular_recon.merging.over_time import TimeAverage, average, sigma_of
    from binocular_recon.merging.overlap import Pose, find_pose, surface_distances
    from binocular_recon.merging.standing_still import Corners, moved_px
    from binocular_recon.merging.voxels import VoxelCloud

__all__ = [
    'Corners',
    'Pose',
    'TimeAverage',
    'VoxelCloud',
    'average',
    'find_pose',
    'moved_px',
    'sigma_of',
    'surface_distances',
]

__getattr__ = lazy_exports(__name__, __file__)
