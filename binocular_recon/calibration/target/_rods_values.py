# SPDX-License-Identifier: Apache-2.0
"""Checks of single values of ``rods.yaml``; each error names the value."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from binocular_recon.camera import FloatArray
from binocular_recon.errors import CalibrationError, shortened


def number(name: str, value: object) -> float:
    """Return a value as a number of metres."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise CalibrationError(f'{name} must be a number in metres, got {shortened(value)}')
    try:
        return float(value)
    except OverflowError:
        raise CalibrationError(f'{name} must be a finite number of metres') from None


def list_of(values: Mapping[str, Any], key: str) -> list[Any]:
    """Return the list under a key."""
    if not isinstance(values[key], list):
        raise CalibrationError(f'{key} must be a list, got {shortened(values[key])}')
    return list(values[key])


def rod_feet(rods: object) -> FloatArray:
    """Return x and z of each rod, (R, 2) m, from a list of ``{x, z}``."""
    if not isinstance(rods, list) or not rods:
        raise CalibrationError(
            f'rods must be a list such as [{{x: 0.0}}, {{x: 0.6}}], got {shortened(rods)}'
        )
    feet = []
    for i, rod in enumerate(rods, 1):
        if not isinstance(rod, Mapping) or 'x' not in rod or set(rod) - {'x', 'z'}:
            raise CalibrationError(
                f'rod {i} must be given as {{x: metres, z: metres}}, got {shortened(rod)}'
            )
        feet.append(
            (number(f'x of rod {i}', rod['x']), number(f'z of rod {i}', rod.get('z', 0.0)))
        )
    return np.array(feet)
