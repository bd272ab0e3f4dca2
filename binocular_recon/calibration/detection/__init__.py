# SPDX-License-Identifier: Apache-2.0
"""Detection: the rods of a board are found in an image and their marks measured.

`detect` runs the steps: rods are searched (`_rod_search`), told apart (`_board_layout`,
`_identity`), and their edges and marks fitted below a pixel (`_rod_sides`, `_edge_fit`,
`_refinement`). Exports `detect_rods` and its result.
"""

from typing import TYPE_CHECKING

from binocular_recon._lazy import lazy_exports

if TYPE_CHECKING:
    from binocular_recon.calibration.detection.detect import Detection, detect_rods

__all__ = [
    'Detection',
    'detect_rods',
]

__getattr__ = lazy_exports(__name__, __file__)
