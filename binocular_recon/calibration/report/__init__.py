# SPDX-License-Identifier: Apache-2.0
"""The calibration report: one HTML file that needs no network.

`report` writes the sections, `_charts` and `_parameters` what is in them, `mark_errors` compares
reconstructed marks with the known ones. Page style and charts come from `drawing`.
"""

from typing import TYPE_CHECKING

from binocular_recon._lazy import lazy_exports

if TYPE_CHECKING:
    from binocular_recon.calibration.report.mark_errors import mark_errors_m
    from binocular_recon.calibration.report.report import BoardImage, render_report

__all__ = [
    'BoardImage',
    'mark_errors_m',
    'render_report',
]

__getattr__ = lazy_exports(__name__, __file__)
