# SPDX-License-Identifier: Apache-2.0
"""Epipolar correction: homographies that turn epipolar lines into rows (eq. 1-9).

`epipolar` is the paper's correction, `metric_rectification` the one that keeps Z = f T / d and is
written into the camera files, `recalibration` the paper's third step, `homography` what they
share.
"""

from typing import TYPE_CHECKING

from binocular_recon._lazy import lazy_exports

if TYPE_CHECKING:
    from binocular_recon.calibration.rectification.epipolar import (
        free_pair,
        fundamental_matrix,
        row_aligning_pair,
    )
    from binocular_recon.calibration.rectification.metric_rectification import (
        correction_of,
        metric_rig,
    )
    from binocular_recon.calibration.rectification.recalibration import (
        Recalibration,
        corrected_marks,
        recalibrate,
    )

__all__ = [
    'Recalibration',
    'corrected_marks',
    'correction_of',
    'free_pair',
    'fundamental_matrix',
    'metric_rig',
    'recalibrate',
    'row_aligning_pair',
]

__getattr__ = lazy_exports(__name__, __file__)
