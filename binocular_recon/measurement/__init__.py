# SPDX-License-Identifier: Apache-2.0
"""Sizes and places of things in a reconstruction, each with one standard deviation.

A measurement goes from `picks` (pixels by name) by `snapping` (the surface that a pixel sees) to
`kinds` (the table of what can be measured, where a new kind is added) and `results`. `frame` is
one reconstructed pair, `session` what the measurements of several share. `uncertain` keeps apart
the sources of error of every value, so that correlated ones cancel where they should. `planes`
fits the ground, `faces` measures flatness and cross-sections, `ruler` people and bicycles;
`robust_fits` fits data of which a part belongs to something else. `lengths` gives a single
distance from a covariance. `clouds` measures in a
cloud without its disparities. `site` ties a rig to control points, or levels it. `check_distance`
compares a calibration with a rod of known length.
"""

from typing import TYPE_CHECKING

from binocular_recon._lazy import lazy_exports

if TYPE_CHECKING:
    from binocular_recon.measurement.frame import MeasuredFrame
    from binocular_recon.measurement.kinds import KINDS, measure
    from binocular_recon.measurement.lengths import Length, length_between
    from binocular_recon.measurement.picks import Pick, Request, read_picks, write_picks
    from binocular_recon.measurement.results import Measurement, Quantity
    from binocular_recon.measurement.robust_fits import consensus_fit, refined_fit
    from binocular_recon.measurement.ruler import Ruler, VerticalPlane
    from binocular_recon.measurement.session import MeasuringSession
    from binocular_recon.measurement.snapping import locate
    from binocular_recon.measurement.uncertain import Uncertain, propagate

__all__ = [
    'KINDS',
    'Length',
    'MeasuredFrame',
    'Measurement',
    'MeasuringSession',
    'Pick',
    'Quantity',
    'Request',
    'Ruler',
    'Uncertain',
    'VerticalPlane',
    'consensus_fit',
    'length_between',
    'locate',
    'measure',
    'propagate',
    'read_picks',
    'refined_fit',
    'write_picks',
]

__getattr__ = lazy_exports(__name__, __file__)
