# SPDX-License-Identifier: Apache-2.0
"""The report of a survey: one HTML file with everything inside, to hand to a client.

`sources` reads what an output folder and its calibration hold; `recording`, `findings` (measured
sizes, control points), `rig`, `frames` and `cloud` write a section or two each from that;
`survey_report` puts them together, `stations_report` those of several stations, in the
`whole_page` that both have. What is not there is said, with the remedy. Style and viewer
come from `drawing`.
"""

from typing import TYPE_CHECKING

from binocular_recon._lazy import lazy_exports

if TYPE_CHECKING:
    from binocular_recon.apps.survey.report.sources import ReportDetails
    from binocular_recon.apps.survey.report.survey_report import write_report

__all__ = ['ReportDetails', 'write_report']

__getattr__ = lazy_exports(__name__, __file__)
