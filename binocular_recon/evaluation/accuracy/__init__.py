# SPDX-License-Identifier: Apache-2.0
"""Accuracy of disparities on scenes with ground truth.

`scenes` reads them (`visibility` finds what both cameras see), `methods` are what is compared,
`external` makes one of another program. `scoring` runs and scores them by `metrics`, `parts`
(measured and filled pixels apart) and `error_classes`; `robustness` changes exposure and crop;
`summary` and `part_tables` make the tables and `report` the page.
"""

from typing import TYPE_CHECKING

from binocular_recon._lazy import lazy_exports

if TYPE_CHECKING:
    from binocular_recon.evaluation.accuracy.external import ExternalPeer, external_peer
    from binocular_recon.evaluation.accuracy.methods import (
        Method,
        MethodResult,
        PeerError,
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
    'ExternalPeer',
    'Method',
    'MethodResult',
    'PeerError',
    'SceneResult',
    'TruthScene',
    'accuracy',
    'depth_errors',
    'evaluate_scene',
    'external_peer',
    'find_scenes',
    'normalised_error_rms',
    'opencv_method',
    'preset_method',
    'read_scene',
]

__getattr__ = lazy_exports(__name__, __file__)
