# SPDX-License-Identifier: Apache-2.0
"""The transformation from the rectified left frame to the frame of a site, with its errors."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from binocular_recon.camera import FloatArray
from binocular_recon.io.exports.placement import PARAMETERS, Georeference, read_georeference
from binocular_recon.measurement.frame import MeasuredFrame
from binocular_recon.measurement.uncertain import CALIBRATION, Uncertain, propagate, root_of
from binocular_recon.rotations import rotation

TIE_FILE = 'georeference.json'


@dataclass(frozen=True, eq=False)
class SiteTie(Georeference):
    """A georeference that takes points to the site with their errors.

    Attributes
    ----------
    facts : dict
        What else the file states.

    """

    facts: dict[str, Any] = field(default_factory=dict)

    def apply(self, points_xyz: FloatArray) -> FloatArray:
        """Return points (..., 3) of the rectified frame in the site's, float64, m."""
        moved: FloatArray = self.scale * (points_xyz - self.pivot) @ self.R.T + self.pivot_site
        return moved

    def errors(self, frame: MeasuredFrame) -> Uncertain:
        """Return the errors of the transformation, (7,), with their sources."""
        effects = {('control', ''): root_of(self.covariance)}
        known = frame.rig.covariance
        if known is not None and self.calibration.shape[1] == len(known.matrix):
            effects[CALIBRATION] = self.calibration @ root_of(known.matrix)
        return Uncertain(np.zeros(PARAMETERS), effects)

    def to_site(self, point: Uncertain, frame: MeasuredFrame) -> Uncertain:
        """Return a point (3,), m, of the rectified frame in the site's.

        Errors that the transformation and the point share, those of the calibration, cancel as
        they do.
        """
        # large coordinates are added last, so that derivatives keep their digits
        local = propagate(
            lambda values, moved: transformed(self.R, self.scale, values - self.pivot, moved),
            point,
            self.errors(frame),
        )
        return Uncertain(local.values + self.pivot_site, local.effects)

    def up(self, frame: MeasuredFrame) -> Uncertain:
        """Return the unit vector along the site's third axis in the rectified frame, (3,)."""
        return propagate(lambda moved: (rotation(moved[:3]) @ self.R)[2], self.errors(frame))

    def to_mapping(self) -> dict[str, Any]:
        """Return the content of ``georeference.json``."""
        return {
            'transform': {
                'R': self.R.tolist(),
                't': self.t.tolist(),
                'scale': self.scale,
                'pivot': self.pivot.tolist(),
                'pivot_site': self.pivot_site.tolist(),
            },
            'axes': list(self.names),
            'level': self.level,
            **self.facts,
            'errors': {
                'parameters': [
                    *(f'turn_{axis}_rad' for axis in 'xyz'),
                    *(f'shift_{axis}_m' for axis in 'xyz'),
                    'relative_scale',
                ],
                'covariance': self.covariance.tolist(),
                'by_calibration': self.calibration.tolist(),
            },
        }


def transformed(R: FloatArray, scale: float, offset: FloatArray, moved: FloatArray) -> FloatArray:
    """Return ``scale R offset`` with a transformation that is moved by its parameters (7,)."""
    turned = rotation(moved[:3]) @ (scale * R @ offset)
    place: FloatArray = (1 + moved[6]) * turned + moved[3:6]
    return place


def read_tie(path: Path) -> SiteTie:
    """Read a ``georeference.json``; raises as `read_georeference`."""
    return SiteTie(**vars(read_georeference(path)))
