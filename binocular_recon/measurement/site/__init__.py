# SPDX-License-Identifier: Apache-2.0
"""The frame of a site: control points, the vertical, and coordinate reference systems.

`control_points` reads control and check points, `adjustment` ties the rig to them, `levelling`
takes the vertical from the ground, from rods or plumb lines. Both make a `tie`: the
transformation with what it shares with the errors of points. `reference_systems` knows EPSG
codes.
"""

from typing import TYPE_CHECKING

from binocular_recon._lazy import lazy_exports

if TYPE_CHECKING:
    from binocular_recon.measurement.site.adjustment import Adjustment, adjust
    from binocular_recon.measurement.site.control_points import ControlPoint, read_control
    from binocular_recon.measurement.site.levelling import level_by_ground, level_by_uprights
    from binocular_recon.measurement.site.tie import SiteTie, read_tie

__all__ = [
    'Adjustment',
    'ControlPoint',
    'SiteTie',
    'adjust',
    'level_by_ground',
    'level_by_uprights',
    'read_control',
    'read_tie',
]

__getattr__ = lazy_exports(__name__, __file__)
