# SPDX-License-Identifier: Apache-2.0
"""Calibrated cameras and stereo rigs: the numbers of a CameraInfo, without ROS.

Coordinate frames are optical: x right, y down, z forward, metres. ``x_rectified = R x_camera``;
``P = K* [I | t]`` projects rectified points, ``P_right[0, 3] = -f B``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from binocular_recon.errors import CalibrationError
from binocular_recon.lenses.lens import Lens
from binocular_recon.lenses.registry import LENSES

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Camera:
    """One calibrated camera, as described by a CameraInfo.

    Attributes
    ----------
    width, height : int
        Size of the image, px.
    K : (3, 3) float64
        Intrinsics of the raw image, px.
    D : (n,) float64
        Distortion coefficients of ``distortion_model``.
    R : (3, 3) float64
        Rotation from the camera's to the rectified frame; `Rectifier` checks it.
    P : (3, 4) float64
        Projection of rectified points to rectified pixels.
    distortion_model : str
        A key of `LENSES`: ``plumb_bob``, ``rational_polynomial`` or ``equidistant``. Simulators
        leave it empty: with ``D`` empty or zero that becomes ``plumb_bob`` without distortion.

    Raises
    ------
    CalibrationError
        If the camera is not calibrated or its values contradict each other.

    """

    width: int
    height: int
    K: FloatArray
    D: FloatArray
    R: FloatArray
    P: FloatArray
    distortion_model: str = 'plumb_bob'

    def __post_init__(self) -> None:
        """Convert the matrices to float64 of the right shapes and check them."""
        for name, shape in (('K', (3, 3)), ('D', (-1,)), ('R', (3, 3)), ('P', (3, 4))):
            values = np.asarray(getattr(self, name), np.float64)
            if name != 'D' and values.size != math.prod(shape):
                raise CalibrationError(
                    f'{name} must have {math.prod(shape)} values, got {values.size}'
                )
            if not np.isfinite(values).all():
                raise CalibrationError(f'{name} holds values that are not finite; calibrate again')
            object.__setattr__(self, name, values.reshape(shape))
        if self.K[0, 0] <= 0 or self.K[1, 1] <= 0:
            raise CalibrationError(
                f'camera is not calibrated (fx = {self.K[0, 0]:g}, fy = {self.K[1, 1]:g} px);'
                ' calibrate it or give a calibration folder'
            )
        if self.P[0, 0] <= 0 or self.P[1, 1] <= 0:
            raise CalibrationError(
                f'P is not that of a rectified camera (fx = {self.P[0, 0]:g},'
                f' fy = {self.P[1, 1]:g} px); calibrate as a stereo rig'
            )
        if not self.distortion_model and not self.D.any():
            object.__setattr__(self, 'distortion_model', 'plumb_bob')
            object.__setattr__(self, 'D', np.zeros(5))
        if self.distortion_model not in LENSES:
            raise CalibrationError(
                f'distortion model {self.distortion_model!r} is not one of {", ".join(LENSES)}'
            )
        if self.D.size not in self.lens.counts:
            raise CalibrationError(
                f'{self.distortion_model} takes {" or ".join(map(str, self.lens.counts))}'
                f' distortion coefficients, got {self.D.size}'
            )
        if self.width <= 0 or self.height <= 0:
            raise CalibrationError(f'image size must be positive, got {self.width}x{self.height}')

    @property
    def size(self) -> tuple[int, int]:
        """Width and height, px."""
        return self.width, self.height

    @property
    def lens(self) -> Lens:
        """Lens model that ``D`` belongs to."""
        return LENSES[self.distortion_model]


@dataclass(frozen=True, eq=False)
class StereoRig:
    """The two cameras of a rig; their rectified rows correspond.

    Raises
    ------
    CalibrationError
        If the sizes differ, the baseline is not positive or the rows do not correspond.

    """

    left: Camera
    right: Camera

    def __post_init__(self) -> None:
        """Check that the two cameras form a rectified pair."""
        if self.left.size != self.right.size:
            raise CalibrationError(
                f'left camera is {self.left.width}x{self.left.height}, right is'
                f' {self.right.width}x{self.right.height}; both must have the same size'
            )
        if not self.baseline_m > 0:
            raise CalibrationError(
                f'baseline must be positive, got {self.baseline_m:g} m (P_right[0, 3] ='
                f' {self.right.P[0, 3]:g}); check that left and right are not swapped'
            )
        left_rows, right_rows = self.left.P[1, 1:3], self.right.P[1, 1:3]
        if not np.allclose(left_rows, right_rows, atol=0.5) or not np.isclose(
            self.left.P[0, 0], self.right.P[0, 0], rtol=1e-3
        ):
            raise CalibrationError(
                f'rectified cameras must share fx, fy and cy, got left {self.left.P[0, 0]:g},'
                f' {left_rows} and right {self.right.P[0, 0]:g}, {right_rows};'
                ' rectify them as a pair'
            )

    @property
    def baseline_m(self) -> float:
        """Distance between the optical centres, m."""
        return float((self.left.P[0, 3] - self.right.P[0, 3]) / self.right.P[0, 0])

    @property
    def focal_px(self) -> float:
        """Common horizontal focal length of the rectified cameras, px."""
        return float(self.right.P[0, 0])

    @property
    def disparity_offset_px(self) -> float:
        """``cx_left - cx_right``: the raw disparity x_left - x_right of a point at infinity."""
        return float(self.left.P[0, 2] - self.right.P[0, 2])
