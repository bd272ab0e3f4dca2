# SPDX-License-Identifier: Apache-2.0
"""A calibration on disk: captured boards, points of other detectors, saved results.

`captures` detects the boards of a folder, `capture_store` keeps those of a calibration in
progress, `points_csv` reads points that another detector found, `calibration_files` saves a
result as a whole, `board_images` draws the boards for the report.
"""

from typing import TYPE_CHECKING

from binocular_recon._lazy import lazy_exports

if TYPE_CHECKING:
    from binocular_recon.calibration.session.calibration_files import (
        finish_saving,
        save_calibration,
    )
    from binocular_recon.calibration.session.capture_store import CaptureStore
    from binocular_recon.calibration.session.captures import (
        BoardFiles,
        BoardReading,
        CaptureSet,
        find_boards,
        read_board,
        read_captures,
    )
    from binocular_recon.calibration.session.points_csv import read_points

__all__ = [
    'BoardFiles',
    'BoardReading',
    'CaptureSet',
    'CaptureStore',
    'find_boards',
    'finish_saving',
    'read_board',
    'read_captures',
    'read_points',
    'save_calibration',
]

__getattr__ = lazy_exports(__name__, __file__)
