# SPDX-License-Identifier: Apache-2.0
"""Measured quantities with one standard deviation, and the tables of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from binocular_recon.camera import FloatArray
from binocular_recon.io.files import write_json
from binocular_recon.measurement.picks import write_table
from binocular_recon.measurement.uncertain import Uncertain
from binocular_recon.number_text import fixed

MEASUREMENTS_FILE = 'measurements.json'
# What was found of check distances, beside them.
CHECK_FILE = 'check.json'
# Decimals of each unit, for people.
_DECIMALS = {'m': 3, 'm2': 3, 'deg': 2, '': 4}


@dataclass(frozen=True)
class Quantity:
    """A number with its unit and one standard deviation.

    Attributes
    ----------
    value, sigma : float
    unit : str
        ``m``, ``m2``, ``deg`` or none.
    shares : dict of str to float
        What each kind of error alone would leave of sigma: ``matching``, ``pick``,
        ``calibration`` ...

    """

    value: float
    sigma: float
    unit: str = 'm'
    shares: dict[str, float] = field(default_factory=dict)

    @property
    def main_source(self) -> str:
        """The kind of error that has the largest share, '' if none is known."""
        return max(self.shares, key=lambda kind: self.shares[kind], default='')

    def __str__(self) -> str:
        """Return the quantity as a report states it: ``1.795 +- 0.006 m``."""
        decimals = _DECIMALS[self.unit]
        if 0 < self.sigma < 0.5 * 10**-decimals:  # it is not 0
            decimals += 1
        text = f'{fixed(self.value, decimals)} +- {fixed(self.sigma, decimals)} {self.unit}'
        return text.rstrip()


def quantities(found: Uncertain, unit: str = 'm') -> list[Quantity]:
    """Return each of the uncertain values as a quantity."""
    shares = found.shares
    return [
        Quantity(
            float(value),
            float(sigma),
            unit,
            {kind: float(share[index]) for kind, share in shares.items()},
        )
        for index, (value, sigma) in enumerate(zip(found.values, found.sigma, strict=True))
    ]


@dataclass(frozen=True, eq=False)
class Measurement:
    """What was measured.

    Attributes
    ----------
    name, kind : str
    points : tuple of str
        Picks that it was measured between.
    quantities : dict of str to Quantity
        By what they are; the first is the main one.
    outline_px : (N, 2) float64
        What is drawn in the left image, px.
    frame : int
        Frame of the image.
    closed : bool
        Whether the outline is closed.
    profile : dict of str to FloatArray
        Columns of a cross-section, (n,) each.

    """

    name: str
    kind: str
    points: tuple[str, ...]
    quantities: dict[str, Quantity]
    outline_px: FloatArray
    frame: int = 0
    closed: bool = False
    profile: dict[str, FloatArray] = field(default_factory=dict)

    @property
    def main(self) -> Quantity:
        """The quantity that the image shows."""
        return next(iter(self.quantities.values()))

    @property
    def label(self) -> str:
        """What the image shows: for a point its name."""
        return self.name if self.kind == 'point' else str(self.main)

    def to_mapping(self) -> dict[str, Any]:
        """Return the measurement for JSON."""
        content: dict[str, Any] = {
            'name': self.name,
            'kind': self.kind,
            'points': list(self.points),
            'frame': self.frame,
        }
        for name, one in self.quantities.items():
            content[name] = {
                'value': one.value,
                'sigma': one.sigma,
                'unit': one.unit,
                'sigma_by_source': one.shares,
            }
        if self.profile:
            content['profile'] = {name: column.tolist() for name, column in self.profile.items()}
        return content


def table(found: Sequence[Measurement]) -> str:
    """Return the measurements for a terminal, one quantity a line."""
    rows = [
        (one.name if first else '', what, str(quantity), quantity.main_source)
        for one in found
        for first, (what, quantity) in zip(
            [True, *[False] * len(one.quantities)], one.quantities.items(), strict=False
        )
    ]
    header = ('measurement', 'quantity', 'value +- sigma', 'mostly from')
    widths = [max(len(row[i]) for row in [header, *rows]) for i in range(len(header))]
    lines = ('  '.join(map(str.ljust, row, widths)).rstrip() for row in [header, *rows])
    return '\n'.join(lines)


def write_results(folder: Path, found: Sequence[Measurement], facts: dict[str, Any]) -> list[Path]:
    """Write ``measurements.json``, ``measurements.csv`` and the profile of each cross-section.

    Returns the paths. Raises a FileError if one cannot be written.
    """
    paths = [folder / MEASUREMENTS_FILE, folder / 'measurements.csv']
    write_json(paths[0], {**facts, 'measurements': [one.to_mapping() for one in found]})
    rows: list[Sequence[object]] = [
        (one.name, one.kind, ' '.join(one.points), one.frame, what, q.value, q.sigma, q.unit)
        for one in found
        for what, q in one.quantities.items()
    ]
    write_table(
        paths[1], ['name', 'kind', 'points', 'frame', 'quantity', 'value', 'sigma', 'unit'], rows
    )
    for number, one in enumerate((one for one in found if one.profile), 1):
        paths.append(folder / f'section_{number:02d}.csv')
        write_table(paths[-1], list(one.profile), np.column_stack(list(one.profile.values())))
    return paths
