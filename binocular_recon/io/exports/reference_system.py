# SPDX-License-Identifier: Apache-2.0
"""Coordinate reference systems of sites, through pyproj."""

from __future__ import annotations

from typing import Any

from binocular_recon.errors import ConfigError, shortened
from binocular_recon.machine import optional_package


def reference_system(text: str) -> Any:
    """Return a coordinate reference system that has metres.

    Parameters
    ----------
    text : str
        ``EPSG:32632``, the number alone, WKT or anything else that pyproj takes.

    Returns
    -------
    pyproj.CRS

    Raises
    ------
    DependencyError
        If pyproj is not installed.
    ConfigError
        If there is no such system, or its coordinates are not lengths in metres.

    """
    pyproj = optional_package('pyproj', 'coordinate reference systems')
    try:
        found = pyproj.CRS.from_user_input(int(text) if text.isdecimal() else text)
    except pyproj.exceptions.CRSError as error:
        raise ConfigError(
            f'there is no coordinate reference system {shortened(text)}: {shortened(error)}; give'
            ' an EPSG code such as 32632 (UTM zone 32 north)'
        ) from error
    units = {axis.unit_name for axis in found.axis_info[:2]}
    if units != {'metre'}:
        raise ConfigError(
            f'{found.name} has {" and ".join(sorted(units))} as units; clouds are in metres, so'
            ' give a projected system such as EPSG:32632 (UTM zone 32 north)'
        )
    return found


def wkt_of(text: str) -> str:
    """Return the WKT of a reference system, '' for none; raises as `reference_system`."""
    return str(reference_system(text).to_wkt()) if text else ''
