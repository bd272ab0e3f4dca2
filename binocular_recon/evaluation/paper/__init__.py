# SPDX-License-Identifier: Apache-2.0
"""The paper end to end on simulated sites: its Tables 1, 2 and 3 beside ours.

`site` simulates a site, `runs` calibrates and reconstructs it, `sizes` measures people and
bicycle, `tables` and `drawing` show the results; `sigmas` compares points and lengths with their
standard deviations.
"""

from typing import TYPE_CHECKING

from binocular_recon._lazy import lazy_exports

if TYPE_CHECKING:
    from binocular_recon.evaluation.paper.runs import PaperRun, run_paper, run_site
    from binocular_recon.evaluation.paper.site import Site, simulate_site

__all__ = [
    'PaperRun',
    'Site',
    'run_paper',
    'run_site',
    'simulate_site',
]

__getattr__ = lazy_exports(__name__, __file__)
