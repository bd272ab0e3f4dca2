# SPDX-License-Identifier: Apache-2.0
"""The camera of an image, from what a camera info or a file states."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from binocular_recon.camera import Camera
from binocular_recon.errors import CalibrationError


def camera_of_image(
    size: tuple[int, int],
    K: npt.ArrayLike,
    D: npt.ArrayLike,
    R: npt.ArrayLike,
    P: npt.ArrayLike,
    distortion_model: str,
    *,
    rectified: bool = False,
    notices: tuple[str, ...] = (),
) -> Camera:
    """Return the camera of an image; of a rectified image only P counts.

    Parameters
    ----------
    size : (int, int)
        Width and height of the image, px.
    K, D, R, P, distortion_model
        As for `Camera`.
    rectified : bool
        Whether the image is rectified. K is then that of P, without distortion; a fault of the
        other members becomes a notice.
    notices : tuple of str
        What was read in another way than it is written so far.

    Raises
    ------
    CalibrationError
        If what counts is not calibrated or contradicts itself.

    """
    K, D, R, P = (np.asarray(values, np.float64) for values in (K, D, R, P))
    if not rectified or P.size != 12:
        return Camera(*size, K, D, R, P, distortion_model, notices)
    fault = ''
    try:
        Camera(*size, K, D, R, P, distortion_model)
    except CalibrationError as error:
        if P.flat[0] > 0 and np.isfinite(P).all():
            what, _, _ = str(error).partition(';')  # its remedy is of no use here
            fault = f'{what}; the images are rectified, so only P is used'
        else:
            raise
    P = P.reshape(3, 4)
    notices = (*notices, fault) if fault else notices
    return Camera(*size, P[:, :3], np.zeros(5), np.eye(3), P, notices=notices)
