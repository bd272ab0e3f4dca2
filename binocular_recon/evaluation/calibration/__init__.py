# SPDX-License-Identifier: Apache-2.0
"""How good a calibration is: against the Cramer-Rao bound and against OpenCV.

`self_check` calibrates simulated boards many times, `detection` scores detected rods against
their truth, `opencv_calibration` is the peer.
"""

from typing import TYPE_CHECKING

from binocular_recon._lazy import lazy_exports

if TYPE_CHECKING:
    from binocular_recon.evaluation.calibration.detection import BoardScore, score_capture
    from binocular_recon.evaluation.calibration.opencv_calibration import calibrate_in_two_steps
    from binocular_recon.evaluation.calibration.self_check import check_accuracy, check_rows

__all__ = [
    'BoardScore',
    'calibrate_in_two_steps',
    'check_accuracy',
    'check_rows',
    'score_capture',
]

__getattr__ = lazy_exports(__name__, __file__)
