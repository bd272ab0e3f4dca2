# SPDX-License-Identifier: Apache-2.0
"""Accuracy of disparities on scenes with ground truth.

`scenes` reads them, `methods` are what is compared, `scoring` runs and scores them by `metrics`,
`robustness` changes exposure and crop, `summary` makes the tables and `report` the page.
"""

from typing import TYPE_CHECKING

from binocular_recon._lazy import lazy_exports

if TYPE_CHECKING:
    from binocular_recon.evaluation.accuracy.methods import (
        Method,
        MethodResult,
        opencv_method,
        preset_method,
    )
    from binocular_recon.evaluation.accuracy.metrics import (
        Accuracy,
        accuracy,
        depth_errors,
        normalised_error_rms,
    )
    from binocular_recon.evaluation.accuracy.scenes import TruthScene, find_scenes, read_scene
    from binocular_recon.evaluation.accuracy.scoring import SceneResult, evaluate_scene

__all__ = [
    'Accuracy',
    'Method',
    'MethodResult',
    'SceneResult',
    'TruthScene',
    'accuracy',
    'depth_errors',
    'evaluate_scene',
    'find_scenes',
    'normalised_error_rms',
    'opencv_method',
    'preset_method',
    'read_scene',
]

__getattr__ = lazy_exports(__name__, __file__)
