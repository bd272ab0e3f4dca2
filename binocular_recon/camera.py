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
from binocular_recon.inputs.camera_checks import (
    baseline_axis,
    baseline_warnings,
    check_baseline,
    check_matrices,
    known_lens,
    resolution_warning,
)
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
        A key of `LENSES`: ``plumb_bob``, ``rational_polynomial`` or ``equidistant``. Other
        programs' names of these are replaced. Simulators leave it empty: with ``D`` empty or zero
        that becomes ``plumb_bob`` without distortion.
    notices : tuple of str
        What was read in another way than it is written, for the user.

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
    notices: tuple[str, ...] = ()

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
        check_matrices(self.K, self.P)
        model, D, notices = known_lens(self.distortion_model, self.D)
        object.__setattr__(self, 'distortion_model', model)
        object.__setattr__(self, 'D', D)
        object.__setattr__(self, 'notices', (*self.notices, *notices))
        if self.width <= 0 or self.height <= 0:
            raise CalibrationError(f'image size must be positive, got {self.width}x{self.height}')

    @property
    def size(self) -> tuple[int, int]:
        """Width and height, px."""
        return self.width, self.height

    @property
    def rectified(self) -> bool:
        """Whether its images are rectified already: without distortion, K that of P, R = I."""
        known = np.array_equal(self.K, self.P[:, :3]) and np.array_equal(self.R, np.eye(3))
        return known and not self.D.any()

    @property
    def lens(self) -> Lens:
        """Lens model that ``D`` belongs to."""
        return LENSES[self.distortion_model]

    @property
    def warning(self) -> str:
        """Why the camera seems to be that of images of another size; else empty."""
        return resolution_warning(
            self.size, self.K, rectified=np.array_equal(self.K, self.P[:, :3])
        )


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
    """The two cameras of a rig; their rectified rows correspond, or columns if `turns` is not 0.

    Attributes
    ----------
    left, right : Camera
    covariance : RigCovariance, optional
        Covariance of the calibration; without it sigmas hold the share of matching only.

    The raw images may differ in size; both rectified ones have that of the left one.

    Raises
    ------
    CalibrationError
        If rectified cameras differ in size, the baseline is not positive or the rows do not
        correspond.

    """

    left: Camera
    right: Camera
    covariance: RigCovariance | None = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        """Check that the two cameras form a rectified pair."""
        if self.left.size != self.right.size and self.left.rectified and self.right.rectified:
            raise CalibrationError(
                f'left camera is {self.left.width}x{self.left.height}, right is'
                f' {self.right.width}x{self.right.height}; rectified images must have the same'
                ' size: rectify both to the size of the left one'
            )
        check_baseline(self.left.P, self.right.P)

    @property
    def notices(self) -> tuple[str, ...]:
        """What was read in another way than it is written, a sentence each."""
        sides = ('left', self.left), ('right', self.right)
        return tuple(f'{side} camera: {text}' for side, camera in sides for text in camera.notices)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What is probably wrong in the calibration, a sentence each."""
        sides = ('left', self.left.warning), ('right', self.right.warning)
        texts = [f'{side} camera: {text}' for side, text in sides if text]
        return (*texts, *baseline_warnings(self.left.P, self.right.P))

    @property
    def turns(self) -> int:
        """Quarter turns, counter-clockwise, that bring the baseline of the images into rows.

        0 unless one camera stands above the other: 1 if the right one is below, else -1. Matching
        works on images turned like this; disparities are differences of columns there.
        """
        if baseline_axis(self.left.P, self.right.P) == 0:
            return 0
        return 1 if self.left.P[1, 3] > self.right.P[1, 3] else -1

    @property
    def baseline_m(self) -> float:
        """Distance between the optical centres, m."""
        along = abs(self.turns)
        shift = self.left.P[along, 3] - self.right.P[along, 3]
        return float(abs(shift) / self.right.P[along, along])

    @property
    def right_centre_m(self) -> FloatArray:
        """Optical centre of the right camera in the left rectified frame, (3,) m."""
        centre = np.zeros(3)
        centre[abs(self.turns)] = self.baseline_m * (self.turns or 1)
        return centre

    @property
    def focal_px(self) -> float:
        """Common focal length of the rectified cameras along the baseline, px."""
        along = abs(self.turns)
        return float(self.right.P[along, along])

    @property
    def disparity_offset_px(self) -> float:
        """``cx_left - cx_right``: the raw disparity x_left - x_right of a point at infinity.

        In the images turned by `turns`.
        """
        along = abs(self.turns)
        offset = float(self.left.P[along, 2] - self.right.P[along, 2])
        return -offset if self.turns < 0 else offset
