# SPDX-License-Identifier: Apache-2.0
"""Types of marks: the values of ``mark_type`` in ``rods.yaml``.

A mark is the edge between a dark and a light band of a rod. Its type says which of the two is
below and where on the rod a camera sees the edge. Detection, simulation and calibration ask the
type; another type of this kind is one more entry of `MARK_TYPES`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from binocular_recon.camera import FloatArray
from binocular_recon.errors import CalibrationError
from binocular_recon.images import Mask

# Bands alternate, so a rod moved by this many marks has the same bands.
PERIOD = 2


@dataclass(frozen=True)
class MarkType:
    """What the marks of a rod look like.

    Attributes
    ----------
    name : str
        Value of ``mark_type`` in ``rods.yaml``.
    lowest_band : str
        ``dark`` or ``light``: the band below the first mark. From there up, bands alternate.
    offset_radii : float
        Distance of the visible mark from the rod's axis, towards the camera, in radii of the rod.
        1 = on the surface.

    """

    name: str
    lowest_band: Literal['dark', 'light']
    offset_radii: float = 1.0

    def light_bands(self, marks: int) -> Mask:
        """Return which bands of a rod are light, from the lowest up: (marks + 1,) bool.

        Band i lies below mark i; the last one lies above the top mark.
        """
        first = 1 if self.lowest_band == 'light' else 0
        light: Mask = (np.arange(marks + 1) + first) % PERIOD == 1
        return light

    def dark_below(self, marks: int) -> Mask:
        """Return which marks have a dark band below and a light one above, (marks,) bool."""
        return ~self.light_bands(marks)[:-1]

    @property
    def remedy(self) -> str:
        """What to change where images show rods of this type and ``rods.yaml`` states another."""
        return (
            f'the rods begin with a {self.lowest_band} band; set mark_type: {self.name} in'
            ' rods.yaml'
        )

    def reversed(self) -> MarkType | None:
        """Return the known type with dark and light exchanged; None if there is none."""
        for other in MARK_TYPES.values():
            if other.lowest_band != self.lowest_band and other.offset_radii == self.offset_radii:
                return other
        return None


BAND_EDGE = MarkType('band_edge', lowest_band='dark')
BAND_EDGE_LIGHT = MarkType('band_edge_light', lowest_band='light')
# Every type that rods.yaml may name.
MARK_TYPES = {mark_type.name: mark_type for mark_type in (BAND_EDGE, BAND_EDGE_LIGHT)}


def find_mark_type(name: object) -> MarkType:
    """Return the mark type of a name.

    Raises
    ------
    CalibrationError
        If the name is unknown; the message lists the known ones.

    """
    mark_type = MARK_TYPES.get(name) if isinstance(name, str) else None
    if mark_type is None:
        raise CalibrationError(f'mark_type must be one of {", ".join(MARK_TYPES)}, got {name!r}')
    return mark_type


def visible_edges(
    marks_xyz: FloatArray, direction_xyz: FloatArray, centre_xyz: FloatArray, offset_m: float
) -> FloatArray:
    """Return the point of each mark's edge that faces the camera.

    The edge is a ring around the rod. What a camera sees of it on the rod's centre line is the
    point nearest to the camera, not the axis.

    Parameters
    ----------
    marks_xyz : (..., 3) float64
        Marks on the rod's axis, m.
    direction_xyz : (..., 3) float64
        Unit direction of the rod's axis, broadcast against ``marks_xyz``.
    centre_xyz : (3,) float64
        Optical centre of the camera in the same frame, m.
    offset_m : float
        Distance of the visible mark from the axis, `RodBoard.mark_offset_m`, m.

    Returns
    -------
    (..., 3) float64
        Points that the camera sees, same frame, m.

    """
    sight = centre_xyz - marks_xyz
    sight = sight - np.sum(sight * direction_xyz, axis=-1, keepdims=True) * direction_xyz
    facing: FloatArray = sight / np.linalg.norm(sight, axis=-1, keepdims=True)
    return marks_xyz + offset_m * facing
