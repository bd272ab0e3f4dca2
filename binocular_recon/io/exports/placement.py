# SPDX-License-Identifier: Apache-2.0
"""Where a cloud lies at its site: from the camera's frame to that of control points."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from binocular_recon.camera import FloatArray
from binocular_recon.errors import CalibrationError, shortened
from binocular_recon.images import FloatImage
from binocular_recon.io.text_files import number, numbers, read_json, whole_number
from binocular_recon.rotations import similarity_derivatives

_REMEDY = 'georeference again, or delete it to stay in the frame of the rig'
# Small turn, shift and relative scale.
PARAMETERS = 7
_SIGMAS = ('sigma_x', 'sigma_y', 'sigma_z')
# A larger element of R R^T - I is no rotation.
_ROTATION_TOLERANCE = 1e-6


@dataclass(frozen=True, eq=False)
class Placement:
    """``x_site = scale R x_camera + t``.

    Attributes
    ----------
    rotation : (3, 3) float64
        R.
    translation_m : (3,) float64
        t.
    scale : float
    covariance : (7, 7) float64, optional
        Of a small turn of the cloud about ``centre_m`` in the site's axes (rad), of the place of
        that centre (m) and of the relative scale.
    centre_m : (3,) float64, optional
        Centre in the site's frame; needed with ``covariance``.
    crs : str
        Coordinate reference system of the site, as `reference_system.wkt_of` takes it; empty for
        a local one.

    Raises
    ------
    CalibrationError
        If R is not a rotation or the scale is not positive.

    """

    rotation: FloatArray
    translation_m: FloatArray
    scale: float = 1.0
    covariance: FloatArray | None = None
    centre_m: FloatArray | None = None
    crs: str = ''

    def __post_init__(self) -> None:
        """Check the rotation and the scale."""
        R = self.rotation
        off = np.abs(R @ R.T - np.eye(3)).max()
        if not off < _ROTATION_TOLERANCE or np.linalg.det(R) < 0 or not self.scale > 0:
            raise CalibrationError(
                f'R R^T of the placement differs from 1 by {off:.1e}, its scale is {self.scale};'
                ' both must be those of a turn without a reflection'
            )

    def points(self, points_xyz: FloatArray) -> FloatArray:
        """Return points, (N, 3) m, of the camera's frame in that of the site."""
        placed: FloatArray = self.scale * (points_xyz @ self.rotation.T) + self.translation_m
        return placed

    @property
    def own_sigma_m(self) -> list[float] | None:
        """One standard deviation of the camera's own place, (3,); None if it is not known."""
        if self.covariance is None or self.centre_m is None:
            return None
        effect = similarity_derivatives(self.translation_m[None] - self.centre_m)[0]
        sigma: FloatArray = np.sqrt(np.diag(effect @ self.covariance @ effect.T))
        return [float(one) for one in sigma]

    def sigmas(
        self, points_xyz: FloatArray, sigmas_m: Mapping[str, npt.NDArray[Any]]
    ) -> dict[str, FloatImage]:
        """Return the standard deviations of points along the axes of the site.

        Parameters
        ----------
        points_xyz : (N, 3) float64
            In the camera's frame, m.
        sigmas_m : dict of str to (N,) float64
            ``sigma_z``, and ``sigma_x`` and ``sigma_y`` if they are known, in the camera's frame.

        Returns
        -------
        dict of str to (N,) float32

        Notes
        -----
        A point is uncertain along its ray most of all. sigma_z belongs to that direction, and what
        sigma_x and sigma_y hold beyond it is across; so the covariance has the given diagonal.

        """
        along = points_xyz * (sigmas_m['sigma_z'] / points_xyz[:, 2])[:, None]
        turned = self.scale * self.rotation
        variance = (along @ turned.T) ** 2
        for axis, name in enumerate(_SIGMAS[:2]):
            if name in sigmas_m:
                across = np.maximum(sigmas_m[name] ** 2 - along[:, axis] ** 2, 0)
                variance += across[:, None] * turned[:, axis] ** 2
        if self.covariance is not None and self.centre_m is not None:
            arms = self.points(points_xyz) - self.centre_m
            effect = similarity_derivatives(arms)
            variance += np.einsum('nip,pq,niq->ni', effect, self.covariance, effect, optimize=True)
        sigma = np.sqrt(variance).astype(np.float32)
        return {name: sigma[:, axis] for axis, name in enumerate(_SIGMAS)}


@dataclass(frozen=True, eq=False)
class Georeference:
    """Content of a ``georeference.json``: ``site = pivot_site + scale R (point - pivot)``.

    Attributes
    ----------
    R : (3, 3) float64
        Rotation from the left rectified frame to the site's.
    scale : float
    pivot, pivot_site : (3,) float64
        A point in both frames, m, near which the transformation is known best.
    covariance : (7, 7) float64
        As that of `Placement`, without the share of the calibration.
    calibration : (7, p) float64
        How these seven move with the parameters of the rig's calibration; p may be 0.
    names : tuple of str
        Names of the three axes.
    level : bool
        Whether the third axis is up.
    epsg : int, optional
        Code of the coordinate reference system.

    """

    R: FloatArray
    scale: float
    pivot: FloatArray
    pivot_site: FloatArray
    covariance: FloatArray
    calibration: FloatArray
    names: tuple[str, str, str] = ('X', 'Y', 'Z')
    level: bool = True
    epsg: int | None = None

    @property
    def t(self) -> FloatArray:
        """Where the left camera is, (3,) m: ``site = scale R point + t``."""
        place: FloatArray = self.pivot_site - self.scale * self.R @ self.pivot
        return place

    @property
    def placement(self) -> Placement:
        """Where a cloud lies; raises a CalibrationError if R is not a rotation."""
        return Placement(
            self.R,
            self.t,
            self.scale,
            self.covariance,
            self.pivot_site,
            '' if self.epsg is None else f'EPSG:{self.epsg}',
        )


def read_georeference(path: Path) -> Georeference:
    """Read the ``georeference.json`` of an output folder.

    Raises
    ------
    FileError
        If the file cannot be read or is not JSON.
    CalibrationError
        If it is not a georeference; the message begins with the path.

    """
    content = read_json(path, _REMEDY)
    try:
        transform, errors, crs = content['transform'], content['errors'], content.get('crs')
        R, pivot, pivot_site = (
            numbers(name, transform[name], CalibrationError)
            for name in ('R', 'pivot', 'pivot_site')
        )
        covariance = numbers('covariance', errors['covariance'], CalibrationError)
        by_calibration = errors['by_calibration']
        calibration = (
            numbers('by_calibration', by_calibration, CalibrationError)
            if by_calibration != [[]] * PARAMETERS
            else np.empty((PARAMETERS, 0))
        )
        names = content['axes']
        if (
            (R.shape, pivot.shape, pivot_site.shape) != ((3, 3), (3,), (3,))
            or covariance.shape != (PARAMETERS, PARAMETERS)
            or calibration.shape[:-1] != (PARAMETERS,)
        ):
            raise CalibrationError('its matrices have other sizes')
        if (np.diag(covariance) < 0).any():
            raise CalibrationError('its covariance has negative variances')
        if len(names) != 3 or not all(isinstance(name, str) for name in names):
            raise CalibrationError(f'axes must be three names, got {shortened(names)}')
        found = Georeference(
            R,
            number('scale', transform['scale'], CalibrationError),
            pivot,
            pivot_site,
            covariance,
            calibration,
            (names[0], names[1], names[2]),
            content['level'] is True,
            whole_number('epsg', crs['epsg'], CalibrationError) if crs else None,
        )
        _ = found.placement  # checks the rotation
    except (ValueError, LookupError, TypeError, AttributeError) as error:
        reason = str(error) if isinstance(error, CalibrationError) else shortened(repr(error))
        raise CalibrationError(f'{path} is not a georeference: {reason}; {_REMEDY}') from error
    return found


def read_placement(path: Path) -> Placement:
    """Return where a ``georeference.json`` puts clouds; raises as `read_georeference`."""
    return read_georeference(path).placement
