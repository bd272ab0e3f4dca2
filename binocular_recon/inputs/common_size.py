# SPDX-License-Identifier: Apache-2.0
"""Cameras of different resolution: pixels of the right image on the left image's grid.

The right image is scaled, alike along both axes, as far as it fits into the left one's size, and
put into the middle. Lenses stay as they are; only K changes. Pixel centres are at integers, so
the corner of an image, at -0.5, stays a corner.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True)
class CommonSize:
    """Sizes (width, height) of the left and the right image, px."""

    left: tuple[int, int]
    right: tuple[int, int]

    @property
    def differs(self) -> bool:
        """Whether the sizes are two."""
        return self.left != self.right

    @property
    def scale(self) -> float:
        """Pixels of the common grid per pixel of the right image."""
        return min(self.left[0] / self.right[0], self.left[1] / self.right[1])

    @property
    def matrix(self) -> FloatArray:
        """Homogeneous pixels of the right image to those of the common grid, (3, 3)."""
        if not self.differs:
            return np.eye(3)
        scale = self.scale
        x, y = ((a - 1 - scale * (b - 1)) / 2 for a, b in zip(self.left, self.right, strict=True))
        return np.array([[scale, 0, x], [0, scale, y], [0, 0, 1]])

    def __str__(self) -> str:
        """Say the sizes, one if they are alike."""
        sizes = (self.left, self.right) if self.differs else (self.left,)
        return f'{" and ".join("{}x{}".format(*size) for size in sizes)} px'

    def to_common(self, right_px: FloatArray) -> FloatArray:
        """Return pixels of the right image, (..., 2), on the common grid."""
        common: FloatArray = right_px * self.matrix[0, 0] + self.matrix[:2, 2]
        return common

    def to_right(self, common_px: FloatArray) -> FloatArray:
        """Return pixels of the common grid, (..., 2), as those of the right image."""
        right: FloatArray = (common_px - self.matrix[:2, 2]) / self.matrix[0, 0]
        return right
