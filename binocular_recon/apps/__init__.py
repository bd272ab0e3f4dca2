# SPDX-License-Identifier: Apache-2.0
"""The work behind commands and nodes, without their front ends.

`bag_reconstruction` runs the chain on a whole bag, the `bag_input`. `output_folder` holds the
results; `frame_formats` is the table of the files of each frame, where a new output format is
added, `summary_entries` what the summary says of it. `earlier_run` tells whether an interrupted
run can be continued.
`kernels` compiles all kernels at once. `progress` is a progress bar. `signals` ends processes
that are interrupted. Commands and nodes parse arguments or parameters and call these.
"""

from typing import TYPE_CHECKING

from binocular_recon._lazy import lazy_exports

if TYPE_CHECKING:
    from binocular_recon.apps.bag_input import BagInput
    from binocular_recon.apps.bag_reconstruction import reconstruct_bag
    from binocular_recon.apps.frame_formats import FRAME_FORMATS, FrameFormat, FrameResult
    from binocular_recon.apps.output_folder import ResultFolder

__all__ = [
    'FRAME_FORMATS',
    'BagInput',
    'FrameFormat',
    'FrameResult',
    'ResultFolder',
    'reconstruct_bag',
]

__getattr__ = lazy_exports(__name__, __file__)
