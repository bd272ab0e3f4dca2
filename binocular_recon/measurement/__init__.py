# SPDX-License-Identifier: Apache-2.0
"""Sizes of things in a reconstructed cloud.

`lengths` gives a distance with its standard deviation, `ruler` measures heights and distances
between picked pixels, `robust_fits` fits lines and planes to data of which a part belongs to
something else.
"""

from typing import TYPE_CHECKING

from binocular_recon._lazy import lazy_exports

if TYPE_CHECKING:
    from binocular_recon.measurement.lengths import Length, length_between
    from binocular_recon.measurement.robust_fits import consensus_fit, refined_fit
    from binocular_recon.measurement.ruler import Ruler, VerticalPlane

__all__ = [
    'Length',
    'Ruler',
    'VerticalPlane',
    'consensus_fit',
    'length_between',
    'refined_fit',
]

__getattr__ = lazy_exports(__name__, __file__)
