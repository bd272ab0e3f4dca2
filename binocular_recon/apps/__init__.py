# SPDX-License-Identifier: Apache-2.0
"""The work behind commands and nodes, without their front ends.

`reconstruction` runs the chain on all pairs of an input: a bag (`bag_input`), or image files or
videos (`file_input`); `pair_input` is what these have in common. `batch` computes the frames, in
this process, several or on a cluster. `output_folder` holds the
results; `frame_formats` is the table of the files of each frame, where a new output format is
added, `summary_entries` what the summary says of it. `stored_frame` reads the frames of such a
folder, `export` writes them in other formats. `earlier_run` tells whether an interrupted
run can be continued.
`kernels` compiles all kernels at once. `progress` is a progress bar. `signals` ends processes
that are interrupted. Commands and nodes parse arguments or parameters and call these.
"""

from typing import TYPE_CHECKING

from binocular_recon._lazy import lazy_exports

if TYPE_CHECKING:
    from binocular_recon.apps.bag_input import BagInput
    from binocular_recon.apps.export import EXPORTS
    from binocular_recon.apps.file_input import FileInput
    from binocular_recon.apps.frame_formats import FRAME_FORMATS, FrameFormat, FrameResult
    from binocular_recon.apps.output_folder import ResultFolder
    from binocular_recon.apps.reconstruction import reconstruct_pairs
    from binocular_recon.apps.stored_frame import StoredFrame, stored_frames

__all__ = [
    'EXPORTS',
    'FRAME_FORMATS',
    'BagInput',
    'FileInput',
    'FrameFormat',
    'FrameResult',
    'ResultFolder',
    'StoredFrame',
    'reconstruct_pairs',
    'stored_frames',
]

__getattr__ = lazy_exports(__name__, __file__)
