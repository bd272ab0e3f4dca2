# SPDX-License-Identifier: Apache-2.0
"""Cameras and poses as another program states them, in the conventions of this package."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from binocular_recon.camera import Camera, FloatArray
from binocular_recon.errors import CalibrationError
from binocular_recon.io.calibrations.values import inverse, pose_of, turn_of

# Of cameras with any lens, px.
LEAST_FOCAL_PX = 1.0


@dataclass(frozen=True)
class Choice:
    """What the user states where a file leaves it open.

    Attributes
    ----------
    cameras : (str, str), optional
        Names of the two cameras, of those in the file.
    image_size : (int, int), optional
        Width and height, px, where the file has none.
    baseline_m : float, optional
        Distance of the cameras; replaces the unit of the file.

    """

    cameras: tuple[str, str] | None = None
    image_size: tuple[int, int] | None = None
    baseline_m: float | None = None


@dataclass(frozen=True, eq=False)
class RawCamera:
    """One camera as calibrated.

    Attributes
    ----------
    name : str
        What the file calls it.
    where : str
        File and name, for errors.
    size : (int, int) or None
        Width and height of the image, px; None if the file does not state it.
    K : (3, 3) float64
        Intrinsics, px; the centre of the first pixel is (0, 0).
    D : (n,) float64
        Distortion coefficients.
    lens : str
        A key of `LENSES`.
    pose : (4, 4) float64 or None
        From a frame that all cameras share to this one: x right, y down, z forward.
    side : str
        ``'left'`` or ``'right'`` if a name says so.
    R, P : (3, 3) and (3, 4) float64, optional
        Rectification, if the file states it.

    """

    name: str
    where: str
    size: tuple[int, int] | None
    K: FloatArray
    D: FloatArray
    lens: str = 'plumb_bob'
    pose: FloatArray | None = None
    side: str = ''
    R: FloatArray | None = None
    P: FloatArray | None = None

    def camera(self, R: FloatArray | None = None, P: FloatArray | None = None) -> Camera:
        """Return the camera, checked; not rectified without R and P.

        Its size is 1 x 1 px while that is not known.

        Raises
        ------
        CalibrationError
            If its values are not those of a camera; the message begins with `where`.

        """
        if 0 < min(self.K[0, 0], self.K[1, 1]) < LEAST_FOCAL_PX:
            raise CalibrationError(
                f'{self.where}: the focal lengths are {self.K[0, 0]:g} and {self.K[1, 1]:g}, below'
                f' {LEAST_FOCAL_PX:g} px; state them in pixels, not as a share of the image or in'
                ' millimetres'
            )
        if P is None:
            P = np.column_stack([self.K, np.zeros(3)])
            P[0, 1] = 0.0
        R = np.eye(3) if R is None else R
        try:
            return Camera(*(self.size or (1, 1)), self.K, self.D, R, P, self.lens)
        except CalibrationError as error:
            raise CalibrationError(f'{self.where}: {error}') from error

    def rectification(self) -> tuple[FloatArray, FloatArray] | None:
        """Return R (3, 3) and P (3, 4), checked; None unless the file states both.

        Raises
        ------
        CalibrationError
            If they are not those of a rectified camera.

        """
        if self.R is None or self.P is None:
            return None
        R = turn_of(self.R.tolist(), f'{self.where}: R')
        self.camera(R, self.P)
        if min(self.P[0, 0], self.P[1, 1]) < LEAST_FOCAL_PX:
            raise CalibrationError(
                f'{self.where}: the focal lengths of P are {self.P[0, 0]:g} and {self.P[1, 1]:g},'
                f' below {LEAST_FOCAL_PX:g} px; calibrate as a stereo rig'
            )
        return R, self.P

    def rectified_pose(self) -> FloatArray | None:
        """Return the pose that R and P state, from the rectified frame; None without them."""
        found = self.rectification()
        if found is None:
            return None
        R, P = found
        return pose_of(R.T, R.T @ np.linalg.solve(P[:, :3], P[:, 3]))


@dataclass(frozen=True, eq=False)
class RawRig:
    """The cameras of a calibration.

    Attributes
    ----------
    format : str
        Name of the format.
    files : tuple of Path
        Files that were read.
    cameras : sequence of RawCamera
        Those that are wanted, in the order of the file.
    no_pose : str
        What to do if a camera has no pose.
    unit_m : float
        Unit of the poses, m.
    notices : tuple of str
        What the user should know, a sentence each.
    names : tuple of str
        Names of all cameras of the file, if it has more than those in ``cameras``.

    """

    format: str
    files: tuple[Path, ...]
    cameras: Sequence[RawCamera]
    no_pose: str
    unit_m: float = 1.0
    notices: tuple[str, ...] = ()
    names: tuple[str, ...] = ()

    @property
    def listed(self) -> tuple[str, ...]:
        """Names of all cameras of the file."""
        return self.names or tuple(camera.name for camera in self.cameras)

    @property
    def where(self) -> str:
        """Files, for messages."""
        first, *others = self.files
        beside = [
            str(path.relative_to(first.parent)) if path.is_relative_to(first.parent) else str(path)
            for path in others
        ]
        return ' and '.join([str(first), *beside])

    def pair(self, names: tuple[str, str] | None) -> tuple[RawCamera, RawCamera]:
        """Return the cameras with these names, the first two without.

        Raises
        ------
        CalibrationError
            If there are fewer than two, or no cameras with these names.

        """
        known = {camera.name: camera for camera in self.cameras}
        listed = ', '.join(self.listed[:12]) + (', ...' if len(self.listed) > 12 else '')
        if len(self.listed) < 2:
            only = f'one camera only ({listed})' if listed else 'no camera'
            raise CalibrationError(
                f'{self.where} holds {only} ({self.format}); a rig needs both cameras and their'
                f' pose: {self.no_pose}'
            )
        if names is None:
            return self.cameras[0], self.cameras[1]
        for name in names:
            if name not in known:
                raise CalibrationError(
                    f'{self.where} has no camera {name!r}, only {listed}; choose two of them'
                )
        if names[0] == names[1]:
            raise CalibrationError(f'camera {names[0]!r} is chosen twice; choose two of {listed}')
        return known[names[0]], known[names[1]]


def wanted(names: Sequence[str], choice: Choice) -> list[str]:
    """Return which cameras of a file are read: the chosen ones, the first two without a choice.

    Faults of the others do not matter.
    """
    if choice.cameras is None:
        return list(names[:2])
    return [name for name in names if name in choice.cameras]


def relative_pose(first: RawCamera, second: RawCamera, no_pose: str) -> FloatArray:
    """Return the transformation (4, 4) from the first camera's frame to that of the second one.

    Raises
    ------
    CalibrationError
        If a camera has no pose.

    """
    poses = []
    for camera in (first, second):
        pose = camera.rectified_pose() if camera.pose is None else camera.pose
        if pose is None:
            raise CalibrationError(
                f'{camera.where}: the pose of {camera.name} is missing, so the baseline is not'
                f' known; {no_pose}'
            )
        poses.append(pose)
    return poses[1] @ inverse(poses[0])
