# SPDX-License-Identifier: Apache-2.0
"""Detection: find the rods of a board in an image and measure their marks to subpixel accuracy.

`detect` runs the steps: search for rods (`_rod_search`), decide which rod and which mark each one
is (`_board_layout`, `_identity`), and fit their sides and edges (`_rod_sides`, `_edge_fit`,
`_refinement`). `_reversed_bands` notices a wrong ``mark_type``. Exports `detect_rods` and its
result.
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
