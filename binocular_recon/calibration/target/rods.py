# SPDX-License-Identifier: Apache-2.0
"""The rods of a board: ``rods.yaml`` and the geometry of its marks.

A board is one row of rods, put up once. Board frame: x along the row, to the right as seen from
the front, y up along the rods, z out of the board's plane towards the viewer, metres.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from binocular_recon.calibration.target._rods_values import list_of, number, rod_feet
from binocular_recon.calibration.target.mark_types import BAND_EDGE, MarkType, find_mark_type
from binocular_recon.camera import FloatArray
from binocular_recon.errors import CalibrationError, FileError
from binocular_recon.images import Mask
from binocular_recon.io.text_files import read_yaml

REQUIRED_KEYS = ('rods', 'marks', 'rod_diameter', 'placement_sigma')
OPTIONAL_KEYS = ('mark_type', 'height_sigma', 'tilt_sigma')
# No survey rod is longer: a larger number is probably in millimetres.
MAX_ROD_LENGTH_M = 20.0


@dataclass(frozen=True, eq=False)
class RodBoard:
    """A row of rods, each with the same marks, as ``rods.yaml`` states it.

    Attributes
    ----------
    rods_xz_m : (R, 2) float64
        Nominal foot of each rod in the board frame, from left to right, m.
    marks_m : (M,) float64
        Heights of the marks above the rod's foot, from the lowest up, m.
    rod_diameter_m : float
        Diameter of the rods, m.
    placement_sigma_m : float
        One standard deviation of a foot's x and z, m; 0 = exact.
    height_sigma_m : float
        One standard deviation of a foot's y, m.
    tilt_sigma_rad : float
        One standard deviation of a rod's tilt about x and about z, rad.
    mark_type : MarkType
        What the marks look like; by default edges of bands, dark below the first mark.

    Raises
    ------
    CalibrationError
        If a value is out of range or contradicts another one.

    """

    rods_xz_m: FloatArray
    marks_m: FloatArray
    rod_diameter_m: float
    placement_sigma_m: float
    height_sigma_m: float
    tilt_sigma_rad: float
    mark_type: MarkType = BAND_EDGE

    def __post_init__(self) -> None:
        """Convert the arrays and check every value."""
        object.__setattr__(
            self, 'rods_xz_m', np.asarray(self.rods_xz_m, np.float64).reshape(-1, 2)
        )
        object.__setattr__(self, 'marks_m', np.asarray(self.marks_m, np.float64).reshape(-1))
        for name in ('rod_diameter_m', 'placement_sigma_m', 'height_sigma_m', 'tilt_sigma_rad'):
            if not np.isfinite(getattr(self, name)):
                raise CalibrationError(
                    f'{name} must be a finite number, got {getattr(self, name)}'
                )
        self._check_sigmas()
        self._check_marks()
        self._check_rods()

    def _check_sigmas(self) -> None:
        for key, value, limit in (
            ('placement_sigma', self.placement_sigma_m, 1.0),
            ('height_sigma', self.height_sigma_m, 1.0),
            ('tilt_sigma', self.tilt_sigma_rad, 0.35),
        ):
            if not 0 <= value <= limit:
                raise CalibrationError(
                    f'{key} must be within 0..{limit:g}, got {value:g}; it is one standard'
                    ' deviation in metres (tilt_sigma: radians)'
                )

    def _check_marks(self) -> None:
        marks = self.marks_m
        if marks.size < 2:
            raise CalibrationError(
                f'marks must hold at least 2 heights per rod, got {marks.size};'
                ' list every edge between a dark and a light band'
            )
        if not np.isfinite(marks).all() or (np.diff(marks) <= 0).any():
            raise CalibrationError(
                f'marks must increase from the foot up, got {marks.tolist()}; sort them and'
                ' remove repeated ones'
            )
        if not marks[0] > 0 or not marks[-1] <= MAX_ROD_LENGTH_M:
            raise CalibrationError(
                f'marks must be heights above the foot within 0..{MAX_ROD_LENGTH_M:g} m, got'
                f' {marks[0]:g}..{marks[-1]:g}; are they in metres?'
            )
        if not 0 < self.rod_diameter_m <= marks[-1] - marks[0]:
            raise CalibrationError(
                f'rod_diameter must be positive and below the length of the marked part'
                f' ({marks[-1] - marks[0]:g} m), got {self.rod_diameter_m:g}; it is in metres'
            )

    def _check_rods(self) -> None:
        if not self.count:
            raise CalibrationError('rods is empty; list at least one rod as {x: 0.0}')
        if not np.isfinite(self.rods_xz_m).all():
            raise CalibrationError(
                'rods holds a position that is not finite; give x and z in metres'
            )
        for i, gap in enumerate(np.diff(self.rods_xz_m[:, 0])):
            if not gap > self.rod_diameter_m:
                raise CalibrationError(
                    f'rods must be listed from left to right and stand apart by more than'
                    f' rod_diameter ({self.rod_diameter_m:g} m), got x ='
                    f' {self.rods_xz_m[i, 0]:g} then {self.rods_xz_m[i + 1, 0]:g} (rods {i + 1}'
                    f' and {i + 2})'
                )

    @property
    def count(self) -> int:
        """Number of rods of a board."""
        return len(self.rods_xz_m)

    @property
    def marks_per_rod(self) -> int:
        """Number of marks of a rod."""
        return self.marks_m.size

    @property
    def light_bands(self) -> Mask:
        """Which bands of a rod are light, from the lowest up: (M + 1,) bool."""
        return self.mark_type.light_bands(self.marks_per_rod)

    @property
    def dark_below(self) -> Mask:
        """Which marks have a dark band below and a light one above, (M,) bool."""
        return self.mark_type.dark_below(self.marks_per_rod)

    @property
    def mark_offset_m(self) -> float:
        """Distance of a visible mark from the rod's axis, towards the camera, m."""
        return self.mark_type.offset_radii * self.rod_diameter_m / 2

    @property
    def row_m(self) -> FloatArray:
        """Position of each rod along and off the row: (R, 2) float64, m."""
        return row_of(self.rods_xz_m)

    def world_points(self) -> FloatArray:
        """Return the marks on the axes of exactly placed rods: (R, M, 3), board frame, m."""
        points = np.empty((self.count, self.marks_per_rod, 3))
        points[..., 0] = self.rods_xz_m[:, None, 0]
        points[..., 1] = self.marks_m
        points[..., 2] = self.rods_xz_m[:, None, 1]
        return points

    @classmethod
    def from_mapping(cls, values: Mapping[str, Any]) -> RodBoard:
        """Make a board from the keys of ``rods.yaml``.

        Parameters
        ----------
        values : mapping
            ``rods`` (list of ``{x, z}``, z 0 unless given), ``marks``, ``rod_diameter``,
            ``placement_sigma``; optional ``mark_type`` (a name of `MARK_TYPES`; ``band_edge``),
            ``height_sigma`` (2 x placement_sigma) and ``tilt_sigma`` (placement_sigma per metre).

        Raises
        ------
        CalibrationError
            If a key is missing, unknown or holds a wrong value; the message names it.

        """
        missing = [key for key in REQUIRED_KEYS if key not in values]
        if missing:
            raise CalibrationError(
                f'missing {", ".join(missing)}; all of {REQUIRED_KEYS} are needed'
            )
        unknown = sorted(map(str, set(values) - {*REQUIRED_KEYS, *OPTIONAL_KEYS}))
        if unknown:
            raise CalibrationError(
                f'unknown {", ".join(unknown)}; the keys are'
                f' {", ".join((*REQUIRED_KEYS, *OPTIONAL_KEYS))}'
            )
        placement = number('placement_sigma', values['placement_sigma'])
        return cls(
            rods_xz_m=rod_feet(values['rods']),
            marks_m=np.array(
                [number(f'mark {i}', mark) for i, mark in enumerate(list_of(values, 'marks'), 1)]
            ),
            rod_diameter_m=number('rod_diameter', values['rod_diameter']),
            placement_sigma_m=placement,
            height_sigma_m=number('height_sigma', values.get('height_sigma', 2 * placement)),
            tilt_sigma_rad=number('tilt_sigma', values.get('tilt_sigma', placement)),
            mark_type=find_mark_type(values.get('mark_type', BAND_EDGE.name)),
        )

    def to_mapping(self) -> dict[str, Any]:
        """Return the keys of ``rods.yaml``; the inverse of ``from_mapping``."""
        return {
            'rods': [{'x': float(x), 'z': float(z)} for x, z in self.rods_xz_m],
            'marks': self.marks_m.tolist(),
            'mark_type': self.mark_type.name,
            'rod_diameter': float(self.rod_diameter_m),
            'placement_sigma': float(self.placement_sigma_m),
            'height_sigma': float(self.height_sigma_m),
            'tilt_sigma': float(self.tilt_sigma_rad),
        }


def load_rods(path: str | Path) -> RodBoard:
    """Read ``rods.yaml``.

    Raises
    ------
    FileError
        If the file cannot be read or is not YAML.
    CalibrationError
        If its content is not a valid board; the message names the file and the key.

    """
    values = read_yaml(Path(path), 'give the rods.yaml of the rods')
    if not isinstance(values, Mapping):
        raise CalibrationError(
            f'{path} holds no rods; expected the keys {", ".join(REQUIRED_KEYS)}'
        )
    try:
        return RodBoard.from_mapping(values)
    except CalibrationError as error:
        raise CalibrationError(f'{path}: {error}') from error


def save_rods(board: RodBoard, path: str | Path) -> None:
    """Write ``rods.yaml``.

    Raises
    ------
    FileError
        If the file cannot be written.

    """
    text = '# metres; board frame: x along the row of rods, y up, z out of the plane\n'
    text += yaml.safe_dump(board.to_mapping(), sort_keys=False, default_flow_style=None)
    try:
        Path(path).write_text(text, encoding='utf-8')
    except OSError as error:
        raise FileError(f'cannot write {path}: {error}') from error


def row_of(places_m: FloatArray) -> FloatArray:
    """Rotate positions x, z (N, 2), m, about the y axis until their best line lies along x."""
    x, z = places_m.T
    centred = x - x.mean()
    slope = centred @ z / max(float(centred @ centred), 1e-9)
    along, off = np.array([[1.0, slope], [-slope, 1.0]]) / np.hypot(1.0, slope) @ places_m.T
    return np.stack([along, off - off.mean()], -1)
