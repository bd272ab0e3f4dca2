# SPDX-License-Identifier: Apache-2.0
"""What is done with the output folder of `reconstruct`: measuring in it, tying it to a site.

`measured_folder` reads what measuring needs of such a folder; `measuring` writes tables and
images of measurements, `georeferencing` the tie to control points or the vertical. `merging` makes
one frame of many, `stations` one cloud of several folders, which `stations_folder` reads. `report`
puts all of it into one page; `simulated_site` makes the input of a survey whose truth is known.
"""

from typing import TYPE_CHECKING

from binocular_recon._lazy import lazy_exports

if TYPE_CHECKING:
    from binocular_recon.apps.survey.measured_folder import MeasuredFolder

__all__ = ['MeasuredFolder']

__getattr__ = lazy_exports(__name__, __file__)
