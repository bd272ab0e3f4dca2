# SPDX-License-Identifier: Apache-2.0
"""Calibrations of other programs: OpenCV, Kalibr, EuRoC, mrcal, COLMAP, MATLAB, Metashape.

Each format is one module with a reader that states cameras and poses as the program means them
(`RawRig`), converted to the conventions of this package: pixel centres at whole numbers, poses
from a common frame to the camera. What follows is the same for all: `assemble` finds the left
camera, checks the pose and rectifies. Files are read with bounds in `source`, their values in
`values`. To add a format, derive from `CalibrationFormat` and list it in `FORMATS`.
"""

from typing import TYPE_CHECKING

from binocular_recon._lazy import lazy_exports

if TYPE_CHECKING:
    from binocular_recon.io.calibrations.format import CalibrationFormat
    from binocular_recon.io.calibrations.raw_rig import Choice, RawCamera, RawRig
    from binocular_recon.io.calibrations.registry import FORMATS, read_calibration

__all__ = [
    'FORMATS',
    'CalibrationFormat',
    'Choice',
    'RawCamera',
    'RawRig',
    'read_calibration',
]

__getattr__ = lazy_exports(__name__, __file__)
