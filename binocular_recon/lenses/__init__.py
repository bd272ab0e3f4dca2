# SPDX-License-Identifier: Apache-2.0
"""Lens models: where a lens images a ray, and which ray a point of the image belongs to.

Every part that distorts or undistorts points does it here, so that all agree. Rays are points of
the plane at depth 1, (X / Z, Y / Z); distorted points become pixels by K. To add a lens, derive
from `Lens` and list it in `LENSES`, which is keyed by the ``distortion_model`` of a CameraInfo;
calibration and rectification then know all they need of it.
"""

from typing import TYPE_CHECKING

from binocular_recon._lazy import lazy_exports

if TYPE_CHECKING:
    from binocular_recon.lenses.lens import Lens
    from binocular_recon.lenses.registry import LENSES

__all__ = ['LENSES', 'Lens']

__getattr__ = lazy_exports(__name__, __file__)
