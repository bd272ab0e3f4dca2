# SPDX-License-Identifier: Apache-2.0
"""The marks of one board in both images."""

from __future__ import annotations

from dataclasses import dataclass, replace

from binocular_recon.camera import FloatArray
from binocular_recon.inputs.common_size import CommonSize


@dataclass(frozen=True, eq=False)
class Capture:
    """The marks of one board in both images.

    Attributes
    ----------
    name : str
        Name of the board, for messages and reports.
    left_px, right_px : (R, M, 2) float64
        Image positions x, y of the marks, pixel centres at integers; NaN = not found.

    """

    name: str
    left_px: FloatArray
    right_px: FloatArray

    def on_common(self, sizes: CommonSize) -> Capture:
        """Return the marks with those of the right image in pixels of the left one's size."""
        return replace(self, right_px=sizes.to_common(self.right_px)) if sizes.differs else self
