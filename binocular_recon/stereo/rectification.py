# SPDX-License-Identifier: Apache-2.0
"""Rectification: the raw images of a rig become images whose rows correspond."""

from __future__ import annotations

import dataclasses
import math
from functools import cached_property
from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from binocular_recon.camera import Camera, FloatArray, StereoRig
from binocular_recon.errors import CalibrationError, ConfigError, ImageError
from binocular_recon.images import Image
from binocular_recon.inputs.camera_checks import check_image_size
from binocular_recon.number_text import fixed, significant

Map = npt.NDArray[np.float32]

# Longest side of an image that cv2.remap accepts.
LARGEST_SIDE_PX = 32766
# Largest element of R R^T - I accepted in a rotation: files may hold few digits.
_ROTATION_TOLERANCE = 1e-3
# A smaller angle between two frames moves no point by what matters, rad; 15 m is a depth of use.
_NO_TURN, _FAR_M = 1e-6, 15
# A rectified pixel that is almost a whole number of raw ones wide is taken for it.
_WHOLE_BLOCK = 0.1
# Points per side of the image in `_border_points`.
_BORDER_SAMPLES = 65


def rectification_maps(camera: Camera, size: tuple[int, int] | None = None) -> tuple[Map, Map]:
    """Return where each rectified pixel lies in the raw image.

    Parameters
    ----------
    camera : Camera
        Calibrated camera; ``R`` and ``P`` define the rectified image.
    size : (int, int), optional
        Width and height of the rectified image, px; that of the raw one by default.

    Returns
    -------
    map_x, map_y : (H, W) float32
        Raw column and row, px; pixel centres are at whole numbers.

    """
    columns, rows = camera.lens.raw_pixels(
        camera.K, camera.D, camera.R, camera.P[:, :3], size or camera.size
    )
    skew = camera.K[0, 1] / camera.K[1, 1]  # lenses leave it out
    if skew:
        columns += np.float32(skew) * (rows - np.float32(camera.K[1, 2]))
    return columns, rows


def rectified_points(camera: Camera, points_px: FloatArray) -> FloatArray:
    """Return where points of the raw image lie in the rectified one.

    Parameters
    ----------
    camera : Camera
        Calibrated camera.
    points_px : (N, 2) float64
        Raw columns and rows, px; NaN stays NaN.

    Returns
    -------
    points_px : (N, 2) float64
        Rectified columns and rows, px; NaN where the lens model does not invert.

    """
    rays = camera.lens.rays(points_px, camera.K, camera.D)
    homography = camera.P[:, :3] @ camera.R
    mapped = rays @ homography[:, :2].T + homography[:, 2]
    points: FloatArray = mapped[:, :2] / mapped[:, 2:]
    return points


class Rectifier:
    """Rectify image pairs of one rig; the maps are computed once.

    Parameters
    ----------
    rig : StereoRig
        Calibration of the raw images. Both rectified images have the size of the left one.
    alpha : float
        -1 uses P as it is. 0..1 scales the focal length of both cameras about their principal
        points, as ``cv2.stereoRectify`` does: at 0 every rectified pixel has data, at 1 every raw
        pixel is kept. R does not change.
    interpolation : int
        OpenCV's interpolation flag.

    Attributes
    ----------
    rig : StereoRig
        The rectified rig: no distortion, K = P[:, :3], R = identity.

    Raises
    ------
    ConfigError
        If ``alpha`` is neither -1 nor within 0..1.
    CalibrationError
        If an R is not a rotation, or ``alpha`` needs an image border that the lens model cannot
        undistort.
    ImageError
        If the images are larger than `LARGEST_SIDE_PX`.

    """

    def __init__(
        self, rig: StereoRig, alpha: float = -1.0, interpolation: int = cv2.INTER_LINEAR
    ) -> None:
        if alpha != -1.0 and not 0.0 <= alpha <= 1.0:
            raise ConfigError(f'alpha must be -1 (keep P) or within 0..1, got {alpha}')
        for camera in (rig.left, rig.right):
            if max(camera.size) > LARGEST_SIDE_PX:
                raise ImageError(
                    f'images of {camera.width}x{camera.height} px cannot be rectified: the longest'
                    f' side may have at most {LARGEST_SIDE_PX} px; use a lower resolution'
                )
        _check_rotation(rig.left, 'left')
        _check_rotation(rig.right, 'right')
        if alpha >= 0.0:
            rig = _rescaled(rig, alpha)
        cameras = (_rectified(camera, rig.left.size) for camera in (rig.left, rig.right))
        self.rig = StereoRig(*cameras, covariance=rig.covariance)
        self._interpolation = interpolation
        self._raw = rig

    def __call__(self, left: Image, right: Image) -> tuple[Image, Image]:
        """Rectify a pair.

        Parameters
        ----------
        left, right : (H, W) or (H, W, C), uint8, uint16 or float32
            Raw images of the calibrated size.

        Returns
        -------
        left, right : (H, W) or (H, W, C) of the left image's size, same dtype
            Rectified images; 0 outside the raw image.

        Raises
        ------
        ImageError
            If an image does not have the calibrated size.

        """
        check_size(left, self._raw.left.size, 'left')
        check_size(right, self._raw.right.size, 'right')
        of_left, of_right = self._maps
        return (
            _resampled(left, of_left, self._interpolation),
            _resampled(right, of_right, self._interpolation),
        )

    @cached_property
    def _maps(self) -> tuple[_Maps, _Maps]:
        """Return the maps, made for the first pair that has the calibrated size.

        They are not converted to fixed-point by convertMaps: with float maps OpenCV 5 is exact,
        and twice as fast on grey images. OpenCV 4 rounds both to 1/32 px.
        """
        size = self._raw.left.size
        left, right = (
            _Maps.of(*rectification_maps(camera, size))
            for camera in (self._raw.left, self._raw.right)
        )
        return left, right


class _Maps(NamedTuple):
    """Where each rectified pixel lies in the raw image, averaged over squares of ``block`` px."""

    x: Map
    y: Map
    block: int

    @classmethod
    def of(cls, x: Map, y: Map) -> _Maps:
        """Return maps into the means of as many raw pixels as come to a rectified one.

        Interpolation looks at the four nearest only: the detail that a camera of twice the
        resolution sees in between would become false texture, another in each image.
        """
        rows, columns = (slice(n // 4, max(n // 4 + 2, 3 * n // 4)) for n in x.shape)
        steps = [np.gradient(one[rows, columns]) for one in (x, y)]
        area = np.abs(steps[0][1] * steps[1][0] - steps[0][0] * steps[1][1])
        block = max(1, int(math.sqrt(np.median(area)) + _WHOLE_BLOCK))
        if block > 1:
            x, y = (((one + 0.5) / block - 0.5).astype(np.float32) for one in (x, y))
        return cls(x, y, block)


def _resampled(image: Image, maps: _Maps, interpolation: int) -> Image:
    if maps.block > 1:
        height, width = (-n % maps.block for n in image.shape[:2])
        padded = cv2.copyMakeBorder(image, 0, height, 0, width, cv2.BORDER_REPLICATE)
        share = 1 / maps.block
        image = cv2.resize(padded, None, fx=share, fy=share, interpolation=cv2.INTER_AREA)
    resampled: Image = cv2.remap(image, maps.x, maps.y, interpolation)
    return resampled


def is_turned(camera: Camera) -> bool:
    """Tell whether the rectified frame of a calibrated camera differs from the camera's."""
    return _turn(camera) > _NO_TURN


def frame_text(camera: Camera) -> str:
    """Return how the rectified frame of a calibrated camera lies to the camera's, for a person."""
    if not is_turned(camera):
        return 'that of the camera: R is the identity'
    turn = _turn(camera)
    shift_mm = fixed(1000 * _FAR_M * math.tan(turn), 0)
    return (
        f"turned by {math.degrees(turn):.3f} deg against the camera's ({shift_mm} mm at"
        f' {_FAR_M} m); x_rectified = R x_camera'
    )


def _turn(camera: Camera) -> float:
    return float(np.linalg.norm(cv2.Rodrigues(camera.R)[0]))


def _check_rotation(camera: Camera, side: str) -> None:
    deviation = np.abs(camera.R @ camera.R.T - np.eye(3)).max()
    if deviation > _ROTATION_TOLERANCE or np.linalg.det(camera.R) < 0:
        raise CalibrationError(
            f'{side} camera: R is not a rotation (R R^T is {significant(deviation, 2)} from the'
            f' identity, determinant {significant(np.linalg.det(camera.R), 2)}); calibrate'
            ' as a stereo rig'
        )


def check_size(image: Image, size: tuple[int, int], side: str) -> None:
    """Raise an ImageError if ``image`` does not have the calibrated ``size`` (width, height)."""
    height, width = image.shape[:2]
    check_image_size((width, height), size, f'{side} image')


def _rectified(camera: Camera, size: tuple[int, int]) -> Camera:
    return dataclasses.replace(
        camera,
        width=size[0],
        height=size[1],
        K=camera.P[:, :3],
        D=np.zeros(5),
        R=np.eye(3),
        distortion_model='plumb_bob',
    )


def _rescaled(rig: StereoRig, alpha: float) -> StereoRig:
    """Scale both focal lengths so that no pixel is empty (alpha 0) or none is lost (alpha 1)."""
    inner, outer = [], []
    for camera in (rig.left, rig.right):
        left, top, right, bottom = _border_points(camera)
        centre = camera.P[:2, 2]
        # distance of the four sides from the principal point: of the image, and of the data
        sides = np.array([*centre, *(np.array(rig.left.size) - 1 - centre)])
        nearest = [left[:, 0].max(), top[:, 1].max(), right[:, 0].min(), bottom[:, 1].min()]
        every = np.concatenate([left, top, right, bottom])
        farthest = [*every.min(axis=0), *every.max(axis=0)]
        sign, centres = np.array([-1, -1, 1, 1]), np.tile(centre, 2)
        inner.append(sides / (sign * (nearest - centres)))
        outer.append(sides / (sign * (farthest - centres)))
    scale = (1 - alpha) * np.max(inner) + alpha * np.min(outer)
    factors = np.array([[scale, 1, 1, scale], [1, scale, 1, scale], [1, 1, 1, 1]])
    left_camera, right_camera = (
        dataclasses.replace(camera, P=camera.P * factors) for camera in (rig.left, rig.right)
    )
    return StereoRig(left_camera, right_camera, covariance=rig.covariance)


def _border_points(camera: Camera) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return the left, top, right and bottom border of the raw image, rectified, px."""
    x = np.linspace(0, camera.width - 1, _BORDER_SAMPLES)
    y = np.linspace(0, camera.height - 1, _BORDER_SAMPLES)
    sides = [
        np.stack(np.broadcast_arrays(column, row), axis=-1)
        for column, row in ((x[0], y), (x, y[0]), (x[-1], y), (x, y[-1]))
    ]
    raw = np.concatenate(sides)
    points = rectified_points(camera, raw)
    lost = np.isnan(points[:, 0]).mean()
    if lost:
        raise CalibrationError(
            f'{camera.distortion_model} cannot undistort {lost:.0%} of the image border with'
            f' D = {camera.D.tolist()}, which alpha would need; use alpha -1, or calibrate with'
            ' boards near the corners'
        )
    left, top, right, bottom = points.reshape(4, _BORDER_SAMPLES, 2)
    return left, top, right, bottom
