# SPDX-License-Identifier: Apache-2.0
"""Calibrated cameras and stereo rigs: the numbers of a CameraInfo, without ROS.

Coordinate frames are optical: x right, y down, z forward, metres. ``x_rectified = R x_camera``;
``P = K* [I | t]`` projects rectified points, ``P_right[0, 3] = -f B``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from binocular_recon.errors import CalibrationError
from binocular_recon.lenses.lens import Lens
from binocular_recon.lenses.registry import LENSES

FloatArray = npt.NDArray[np.float64]

# Parameters of a calibration: of each camera, before its distortion coefficients; and of the pose.
INTRINSICS = ('fx', 'fy', 'cx', 'cy')
POSE = ('turn_x', 'turn_y', 'turn_z', 'T_x', 'T_y', 'T_z')


def parameter_names(coefficients: Sequence[str]) -> tuple[str, ...]:
    """Return the parameters of a calibration in the order of covariance matrices.

    Those of the left and of the right camera with these distortion coefficients, then the pose of
    the right camera: a small turn about its own axes (rad) and the translation (m).
    """
    names = (*INTRINSICS, *coefficients)
    return (*(f'{name}_left' for name in names), *(f'{name}_right' for name in names), *POSE)


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
class RigCovariance:
    """How well a calibration is known: the covariance of the parameters of both raw cameras.

    Attributes
    ----------
    left, right : Camera
        The cameras as calibrated, with the R and P that rectify them.
    parameters : tuple of str
        Names of the p parameters: `parameter_names` of the lens' distortion coefficients.
    matrix : (p, p) float64
        Their covariance; px, rad and m. 0 for parameters that were not estimated.

    Raises
    ------
    CalibrationError
        If the names or the matrix do not fit the cameras, or the matrix is not a covariance.

    """

    left: Camera
    right: Camera
    parameters: tuple[str, ...]
    matrix: FloatArray

    def __post_init__(self) -> None:
        """Check names and matrix."""
        count = len(self.parameters)
        if self.parameters != parameter_names(self.coefficients):
            raise CalibrationError(
                f'the parameters of the covariance are {", ".join(self.parameters)}; they must be'
                f' {", ".join(INTRINSICS)} and the distortion coefficients of the left and of the'
                f' right camera, then {", ".join(POSE)}; calibrate again'
            )
        given = len(self.coefficients)
        for camera in (self.left, self.right):
            kin = [lens for lens in LENSES.values() if lens.POLYNOMIAL == camera.lens.POLYNOMIAL]
            known = [
                lens.COEFFICIENTS[:given]
                for lens in kin
                if given in (len(lens.COEFFICIENTS), *lens.counts) and given
            ]
            if self.coefficients not in known or camera.D[given:].any():
                raise CalibrationError(
                    f'the covariance is that of {given} distortion coefficients, the camera has'
                    f' {camera.D.size} of {camera.distortion_model}; calibrate again'
                )
        if self.matrix.shape != (count, count) or not np.isfinite(self.matrix).all():
            raise CalibrationError(
                f'the covariance must have {count} rows and columns of finite numbers, one for'
                f' each of its parameters, got {self.matrix.shape}; calibrate again'
            )
        scale = np.sqrt(np.abs(np.diag(self.matrix)))
        scale[scale == 0] = 1.0
        correlation = self.matrix / np.outer(scale, scale)
        if not np.allclose(correlation, correlation.T, atol=1e-9) or (
            np.linalg.eigvalsh(correlation).min() < -1e-6
        ):
            raise CalibrationError(
                'the covariance of the calibration is not symmetric with eigenvalues of at least'
                ' 0; calibrate again'
            )

    @property
    def coefficients(self) -> tuple[str, ...]:
        """Names of the distortion coefficients of either camera."""
        names = self.parameters[: (len(self.parameters) - len(POSE)) // 2][len(INTRINSICS) :]
        return tuple(name.removesuffix('_left') for name in names)

    def distortion(self, camera: Camera) -> FloatArray:
        """Return all calibrated coefficients of a camera, 0 for those that its D leaves out."""
        coefficients = np.zeros(len(self.coefficients))
        known = camera.D[: coefficients.size]
        coefficients[: known.size] = known
        return coefficients


@dataclass(frozen=True, eq=False)
class StereoRig:
    """The two cameras of a rig; their rectified rows correspond.

    Attributes
    ----------
    left, right : Camera
    covariance : RigCovariance, optional
        Covariance of the calibration; without it sigmas hold the share of matching only.

    Raises
    ------
    CalibrationError
        If the sizes differ, the baseline is not positive or the rows do not correspond.

    """

    left: Camera
    right: Camera
    covariance: RigCovariance | None = field(default=None, kw_only=True)

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
