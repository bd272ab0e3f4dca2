# SPDX-License-Identifier: Apache-2.0
"""Accuracy against ground truth and speed against peers, measured side by side.

`accuracy` scores disparities on scenes with truth, `speed` times every stage, `calibration`
checks calibrations against their bound, `paper` runs the paper's experiments. `peers` are
OpenCV's matchers, `timing` times fairly, `tables` writes Markdown.
"""

from typing import TYPE_CHECKING

from binocular_recon._lazy import lazy_exports

if TYPE_CHECKING:
    from binocular_recon.evaluation.peers import OpenCvMatcher, opencv_matchers
    from binocular_recon.evaluation.timing import interleaved

__all__ = [
    'OpenCvMatcher',
    'interleaved',
    'opencv_matchers',
]

__getattr__ = lazy_exports(__name__, __file__)
