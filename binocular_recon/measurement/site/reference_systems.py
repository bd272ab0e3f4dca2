# SPDX-License-Identifier: Apache-2.0
"""Coordinate reference systems of control points, by EPSG code (pyproj, extra ``survey``)."""

from __future__ import annotations

from dataclasses import dataclass

from binocular_recon.camera import FloatArray
from binocular_recon.errors import MeasurementError
from binocular_recon.machine import optional_package

# Radius of the earth for the scale by height, m.
_EARTH_M = 6_371_000.0


@dataclass(frozen=True)
class ReferenceSystem:
    """A projected coordinate reference system in metres.

    Attributes
    ----------
    epsg : int
    name, wkt : str
    scale : float
        Lengths on the map over those on the ground at the site.
    latitude_deg, longitude_deg : float
        Where the site is if the system is right; a neighbouring zone fits the same coordinates.

    """

    epsg: int
    name: str
    wkt: str
    scale: float
    latitude_deg: float
    longitude_deg: float

    @property
    def place(self) -> str:
        """Where the site is, as text: ``48.8613 N, 9.1684 E``."""
        latitude = f'{abs(self.latitude_deg):.4f} {"N" if self.latitude_deg >= 0 else "S"}'
        return (
            f'{latitude}, {abs(self.longitude_deg):.4f} {"E" if self.longitude_deg >= 0 else "W"}'
        )


def reference_system(epsg: int, place: FloatArray) -> ReferenceSystem:
    """Return a reference system and its scale at a place.

    Parameters
    ----------
    epsg : int
        Code of a projected system in metres; x is the easting, y the northing.
    place : (3,) float64
        Easting, northing and height of the site, m.

    Raises
    ------
    DependencyError
        If pyproj is not installed.
    MeasurementError
        If the code is unknown, its system is not projected or not in metres, or the place is
        outside of its area.

    """
    pyproj = optional_package('pyproj', 'reference systems (--epsg)')
    try:
        system = pyproj.CRS.from_epsg(epsg)
    except pyproj.exceptions.CRSError as error:
        raise MeasurementError(
            f'EPSG:{epsg} is not a known reference system; give the code of a projected one, such'
            ' as 25832 (UTM 32N)'
        ) from error
    horizontal = system.sub_crs_list[0] if system.is_compound else system
    if not horizontal.is_projected:
        raise MeasurementError(
            f'EPSG:{epsg} ({system.name}) is not projected: its coordinates are no lengths; give'
            ' control points in a projected system, such as UTM'
        )
    units = {axis.unit_name for axis in horizontal.axis_info}
    if units != {'metre'}:
        raise MeasurementError(
            f'EPSG:{epsg} ({system.name}) is in {", ".join(sorted(units))}; give control points in'
            ' metres'
        )
    to_degrees = pyproj.Transformer.from_crs(horizontal, horizontal.geodetic_crs, always_xy=True)
    longitude, latitude = to_degrees.transform(float(place[0]), float(place[1]))
    area = system.area_of_use
    inside = area is None or (
        area.south - 1 <= latitude <= area.north + 1 and _within(longitude, area.west, area.east)
    )
    if not inside:
        raise MeasurementError(
            f'the control points at easting {place[0]:.0f} and northing {place[1]:.0f} m are'
            f' outside of the area of EPSG:{epsg} ({system.name}: {area.name}); check the code,'
            ' and that x is the easting and y the northing'
        )
    factors = pyproj.Proj(horizontal).get_factors(longitude, latitude)
    scale = float(factors.areal_scale**0.5) * (1 - float(place[2]) / _EARTH_M)
    return ReferenceSystem(
        epsg, str(system.name), str(system.to_wkt()), scale, float(latitude), float(longitude)
    )


def _within(longitude: float, west: float, east: float) -> bool:
    if west <= east:
        return west - 1 <= longitude <= east + 1
    return longitude >= west - 1 or longitude <= east + 1
