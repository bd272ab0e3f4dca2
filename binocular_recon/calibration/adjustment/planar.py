# SPDX-License-Identifier: Apache-2.0
"""Planar calibration: Zhang's method per camera, then the pose between the cameras.

Takes the rods as exactly placed, as the paper does (section 2.2, steps 1 and 2). It is the
start of everything that follows and the "uncorrected" column of the tables.

Source: Zhang, "A Flexible New Technique for Camera Calibration" (2000), through OpenCV.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

import cv2
import numpy as np

from binocular_recon.calibration.adjustment._camera_estimate import CameraEstimate
from binocular_recon.calibration.adjustment.bundle_adjustment import (
    NOISE_FLOOR_PX,
    Problem,
    free_parameters,
    minimise,
)
from binocular_recon.calibration.adjustment.fisheye_start import start_fisheye
from binocular_recon.calibration.adjustment.linearisation import State, predict
from binocular_recon.calibration.model import DEFAULT_LENS, StereoCalibration, check_finite
from binocular_recon.calibration.target.target import Target
from binocular_recon.camera import FloatArray
from binocular_recon.errors import CalibrationError
from binocular_recon.images import Mask
from binocular_recon.lenses.lens import Lens
from binocular_recon.lenses.registry import LENSES

# Marks of a board that one camera must see for a homography that means something.
MIN_MARKS = 6
# Boards that Zhang's method starts from; the refinement that follows uses all.
_ZHANG_BOARDS = 20
_FLAGS = cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_FIX_K3


def calibrate_planar(
    observed_px: FloatArray,
    target: Target,
    image_size: tuple[int, int],
    lens: str = DEFAULT_LENS,
) -> State:
    """Calibrate both cameras and their pose from boards taken as exact and without thickness.

    Zhang's method per camera, then both cameras and all boards refined together by
    `bundle_adjustment`: as ``cv2.stereoCalibrate``, but robust against single marks and with
    its priors on lenses; left and right are free to differ. A wide-angle lens starts from
    `fisheye_start` instead of Zhang's method.

    Parameters
    ----------
    observed_px : (B, R, M, 4) float64
        Marks of each board in raw images, px: left u, left v, right u, right v; NaN = not found.
        Each camera must see at least ``MIN_MARKS`` marks of every board.
    target : Target
        The boards' nominal geometry.
    image_size : (int, int)
        Width and height, px.
    lens : str
        Lens of both cameras, one of `model.calibrated_lenses`.

    Returns
    -------
    State
        Both cameras (`Lens.DEFAULT_COEFFICIENTS`; `distortion` adds terms where the marks call
        for them) and the boards' poses, no rod displaced.

    Raises
    ------
    CalibrationError
        If no camera fits the marks.

    """
    points = target.nominal_m.reshape(-1, 3)
    count = len(observed_px)
    model = LENSES[lens]
    start = start_fisheye if model.WIDE_ANGLE else _calibrate_camera
    left, right = (
        start(points, pixels.reshape(count, -1, 2), image_size, model)
        for pixels in (observed_px[..., :2], observed_px[..., 2:])
    )
    # each board gives the pose between the cameras once; the medians ignore a few bad boards
    R = _mean_rotation(right.rotations @ np.swapaxes(left.rotations, -1, -2))
    T = np.median(right.translations_m - left.translations_m @ R.T, axis=0)
    calibration = StereoCalibration(image_size, left.K, left.D, right.K, right.D, R, T, lens)
    check_finite(calibration)
    state = State(
        calibration, left.rotations, left.translations_m, np.zeros((count, target.shape[0], 5))
    )
    errors = np.abs(observed_px - predict(state, target.exact()))
    noise = np.full(2, max(np.nanmedian(errors) / 0.6745, NOISE_FLOOR_PX))
    free = free_parameters(model.DEFAULT_COEFFICIENTS, lens)
    return minimise(Problem(target.exact(), observed_px, free, noise), state)


@contextlib.contextmanager
def _one_thread() -> Iterator[None]:
    """Let OpenCV use one thread: several add up the boards in the order in which they finish."""
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(threads)


def _calibrate_camera(
    points: FloatArray, pixels: FloatArray, image_size: tuple[int, int], lens: Lens
) -> CameraEstimate:
    """Return a camera by Zhang's method, without distortion if the lens' D is not OpenCV's."""
    seen: Mask = np.all(np.isfinite(pixels), axis=-1)
    # the effort of OpenCV's method grows with the third power of the number of boards
    some = np.unique(np.linspace(0, len(pixels) - 1, _ZHANG_BOARDS).astype(int))
    try:
        with _one_thread():
            K, D = cv2.calibrateCamera(
                [np.ascontiguousarray(points[seen[i]], np.float32)[:, None] for i in some],
                [np.ascontiguousarray(pixels[i][seen[i]], np.float32)[:, None] for i in some],
                image_size,
                first_guess(points, pixels, image_size),
                np.zeros(5),
                flags=_FLAGS,
            )[1:3]
        poses = [
            cv2.solvePnP(points[found], board[found], K, D)[1:]
            for board, found in zip(pixels, seen, strict=True)
        ]
    except cv2.error as error:
        raise CalibrationError(
            f'no camera fits the marks ({error.err or error}); check that rods.yaml states the'
            ' rods in the images, and capture boards at more distances and angles'
        ) from error
    return CameraEstimate(
        K=K,
        D=D.ravel() if lens.POLYNOMIAL else np.zeros(len(lens.COEFFICIENTS)),
        rotations=np.array([cv2.Rodrigues(turn)[0] for turn, _ in poses]),
        translations_m=np.array([shift.ravel() for _, shift in poses]),
    )


def first_guess(points: FloatArray, pixels: FloatArray, image_size: tuple[int, int]) -> FloatArray:
    """Return K with a centred principal point and the focal length of the homographies.

    For a board's homography [h1 h2 h3] about the image centre, h1 and h2 stand at right angles
    and are equally long once their z is multiplied by f (Zhang, eq. 3 and 4); every board
    gives f twice and the median of what is possible is taken.
    """
    width, height = image_size
    centre = np.array([(width - 1) / 2, (height - 1) / 2])
    squares = []
    for board in pixels:
        seen = np.isfinite(board).all(axis=-1)
        homography, _ = cv2.findHomography(points[seen, :2], board[seen] - centre)
        if homography is None:
            continue
        h1, h2 = homography[:, 0], homography[:, 1]
        plane1, plane2 = h1[:2], h2[:2]
        upright = -(plane1 @ plane2), h1[2] * h2[2]
        equal = plane2 @ plane2 - plane1 @ plane1, h1[2] ** 2 - h2[2] ** 2
        # weighted by how much each equation says about f
        squares += [(weight**2, value * weight) for value, weight in (upright, equal)]
    total, value = np.sum(squares, axis=0) if squares else (0.0, 0.0)
    focal = np.sqrt(value / total) if total > 0 and value > 0 else 0.0
    if not 0.3 * max(image_size) < focal < 20 * max(image_size):
        focal = 1.2 * max(image_size)
    return np.array([[focal, 0, centre[0]], [0, focal, centre[1]], [0, 0, 1.0]])


def _mean_rotation(rotations: FloatArray) -> FloatArray:
    """Return the rotation nearest to the element-wise median of rotations (N, 3, 3)."""
    u, _, vt = np.linalg.svd(np.median(rotations, axis=0))
    rotation: FloatArray = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    return rotation
