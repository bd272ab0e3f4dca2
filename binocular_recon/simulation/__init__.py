# SPDX-License-Identifier: Apache-2.0
"""Rigs, rods and scenes whose truth is known.

`rig` is the simulated rig; `rods`, `render`, `clutter` and `capture` make images of boards;
`scene` and `scene_things` a survey scene at 10 to 20 m with exact disparities.
"""

from typing import TYPE_CHECKING

from binocular_recon._lazy import lazy_exports

if TYPE_CHECKING:
    from binocular_recon.simulation.capture import (
        CaptureOptions,
        SimulatedCapture,
        simulate_capture,
    )
    from binocular_recon.simulation.rig import RawRig, survey_rig
    from binocular_recon.simulation.rods import paper_board
    from binocular_recon.simulation.scene import Scene, build_scene, render_scene, scene_truth

__all__ = [
    'CaptureOptions',
    'RawRig',
    'Scene',
    'SimulatedCapture',
    'build_scene',
    'paper_board',
    'render_scene',
    'scene_truth',
    'simulate_capture',
    'survey_rig',
]

__getattr__ = lazy_exports(__name__, __file__)
