# SPDX-License-Identifier: Apache-2.0
"""The lens models by the ``distortion_model`` of a CameraInfo."""

from __future__ import annotations

from binocular_recon.lenses.equidistant import EquidistantLens
from binocular_recon.lenses.lens import Lens
from binocular_recon.lenses.polynomial import PlumbBobLens, PolynomialLens

# An empty D of the first two means no distortion.
LENSES: dict[str, Lens] = {
    lens.name: lens
    for lens in (
        PlumbBobLens('plumb_bob', (0, 4, 5)),
        PolynomialLens('rational_polynomial', (0, 8, 12, 14)),
        EquidistantLens('equidistant', (4,)),
    )
}
