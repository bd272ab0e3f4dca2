# SPDX-License-Identifier: Apache-2.0
"""Compile the kernels for the tests of an environment: two environments can do so side by side.

Compiled on demand they would keep one core busy for a minute, twice.
"""

from __future__ import annotations

import importlib.util
import os
import sys
from pathlib import Path

# What Numba compiles for one environment, another's discards: not beside the sources.
os.environ.setdefault('NUMBA_CACHE_DIR', str(Path(sys.prefix, 'numba_cache')))


def compile_kernels() -> None:
    """Run every kernel that the nodes use, and those that draw the pictures of tests."""
    import numpy as np

    from binocular_recon.nodes import calibration_node, match_node, wls_filter_node
    from binocular_recon.simulation.capture import simulate_capture
    from binocular_recon.simulation.rig import survey_rig
    from binocular_recon.simulation.rods import paper_board

    match_node.compile_kernels()
    wls_filter_node.compile_kernels()
    calibration_node.compile_kernels(paper_board())
    simulate_capture(paper_board(), survey_rig(scale=0.1), np.random.default_rng(0))


if __name__ == '__main__':
    if importlib.util.find_spec('rclpy'):  # the nodes know the kernels
        compile_kernels()
