# SPDX-License-Identifier: Apache-2.0
"""Calibration targets: the rods that ``rods.yaml`` describes, and their marks.

`rods` reads and checks the file; `mark_types` is the registry of ``mark_type``. `target` is the
geometry that the adjustment takes: rods, or points known exactly. `capture` holds the marks of
one board in both images, `missing_marks` names those that were not found. `board_plane` predicts
where a board's marks lie in an image.
"""

from typing import TYPE_CHECKING

from binocular_recon._lazy import lazy_exports

if TYPE_CHECKING:
    from binocular_recon.calibration.target.capture import Capture
    from binocular_recon.calibration.target.mark_types import MARK_TYPES, MarkType
    from binocular_recon.calibration.target.rods import RodBoard, load_rods, save_rods
    from binocular_recon.calibration.target.target import Target

__all__ = [
    'MARK_TYPES',
    'Capture',
    'MarkType',
    'RodBoard',
    'Target',
    'load_rods',
    'save_rods',
]

__getattr__ = lazy_exports(__name__, __file__)
