# SPDX-License-Identifier: Apache-2.0
"""Calibration of a long-baseline rig from rods in the scene (section 2 of the paper).

`solve` is the calibration on one page. It takes marks (`target`), found in images by `detection`,
through `adjustment` (planar calibration, bundle adjustment, uncertainty) and `rectification`
(epipolar correction). `model` is what is estimated and `result` what comes out; `screening`
decides which boards can be used, `verdict` whether the result may be relied on, `advice` which
board to add, and `holding` whether an older result still holds. `report` shows a result and
`session` keeps captures and results on disk. Exports what a program needs to calibrate.
"""

from typing import TYPE_CHECKING

from binocular_recon._lazy import lazy_exports

if TYPE_CHECKING:
    from binocular_recon.calibration.adjustment.estimation import Estimate
    from binocular_recon.calibration.detection.detect import Detection, detect_rods
    from binocular_recon.calibration.holding import Holding, check_holding
    from binocular_recon.calibration.model import StereoCalibration
    from binocular_recon.calibration.result import CalibrationResult
    from binocular_recon.calibration.screening import Rejected
    from binocular_recon.calibration.session.calibration_files import save_calibration
    from binocular_recon.calibration.session.captures import read_captures
    from binocular_recon.calibration.solve import calibrate
    from binocular_recon.calibration.target.capture import Capture
    from binocular_recon.calibration.target.rods import RodBoard, load_rods, save_rods
    from binocular_recon.calibration.target.target import Target

__all__ = [
    'CalibrationResult',
    'Capture',
    'Detection',
    'Estimate',
    'Holding',
    'Rejected',
    'RodBoard',
    'StereoCalibration',
    'Target',
    'calibrate',
    'check_holding',
    'detect_rods',
    'load_rods',
    'read_captures',
    'save_calibration',
    'save_rods',
]

__getattr__ = lazy_exports(__name__, __file__)
