# SPDX-License-Identifier: Apache-2.0
"""The vertical, from the ground plane, from upright rods or from plumb lines.

A levelled frame has x to the right, y ahead of the left camera and z up, and its origin at the
left camera, or on the ground below it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from binocular_recon.camera import FloatArray
from binocular_recon.errors import MeasurementError
from binocular_recon.io.exports.placement import PARAMETERS
from binocular_recon.measurement.frame import MeasuredFrame
from binocular_recon.measurement.planes import fitted_ground, height_above, normal_of
from binocular_recon.measurement.site.tie import SiteTie
from binocular_recon.measurement.uncertain import CALIBRATION, Uncertain, joined, propagate
from binocular_recon.number_text import significant

# How upright things are, one standard deviation, rad.
TILT_SIGMA_RAD = {'rods': 0.005, 'plumb': 0.001}
# The camera is held level to this, degrees.
MOST_TILT_DEG = 45.0
# Things that differ by more sigmas from the vertical of all are not upright.
MOST_SIGMAS = 3.5
LEAST_LENGTH_M = 0.2


def level_by_ground(frame: MeasuredFrame) -> SiteTie:
    """Return the frame whose third axis is perpendicular to the ground, with 0 on the ground.

    Raises a MeasurementError if the cloud shows no ground.
    """
    support = fitted_ground(frame).support
    up = propagate(normal_of, support)
    height = propagate(lambda ground: height_above(ground, np.zeros(3)), support)
    return _levelled(frame, up, height, 'ground plane')


def level_by_uprights(
    frame: MeasuredFrame, ends: Mapping[str, tuple[Uncertain, Uncertain]], kind: str = 'rods'
) -> SiteTie:
    """Return the frame whose third axis is along upright things.

    Parameters
    ----------
    frame : MeasuredFrame
    ends : mapping of str to pair of Uncertain
        Both ends, (3,) m each, of things by name, in either order.
    kind : str
        A key of `TILT_SIGMA_RAD`.

    Raises
    ------
    MeasurementError
        If there is none, one is short or lies, or they contradict each other.

    """
    if not ends:
        raise MeasurementError('there is nothing upright to level by; pick both ends of a rod')
    directions = []
    for name, (first, last) in ends.items():
        length = float(np.linalg.norm(first.values - last.values))
        if length < LEAST_LENGTH_M:
            raise MeasurementError(
                f'{name} is {length:.3f} m long, {LEAST_LENGTH_M} m is the least to level by; pick'
                ' its ends'
            )
        direction = propagate(_upwards, joined(first, last))
        if -direction.values[1] < np.cos(np.deg2rad(MOST_TILT_DEG)):
            begin, end = (significant(float(one.values[2])) for one in (first, last))
            raise MeasurementError(
                f'{name} lies more than {MOST_TILT_DEG:g} degrees off the vertical of the image,'
                f' its ends are {begin} and {end} m ahead; pick both ends of something upright, on'
                ' it and not on what shows beside it'
            )
        tilt = TILT_SIGMA_RAD[kind] * np.eye(3)
        directions.append(direction.with_effect(('tilt', name), tilt))
    weights = np.array([1 / np.trace(one.covariance) for one in directions])
    weights /= weights.sum()

    def mean(values: FloatArray) -> FloatArray:
        total: FloatArray = weights @ values.reshape(-1, 3)
        return total / np.linalg.norm(total)

    everything = joined(*directions)
    up = propagate(mean, everything)
    if len(ends) > 1:
        _check_agreement(list(ends), everything, mean)
    return _levelled(frame, up, None, {'rods': 'upright rods', 'plumb': 'plumb lines'}[kind])


def _check_agreement(
    names: list[str], directions: Uncertain, mean: Callable[[FloatArray], FloatArray]
) -> None:
    """Raise a MeasurementError that names the thing that is off the vertical of all most."""
    off = [
        propagate(lambda values, i=i: values.reshape(-1, 3)[i] - mean(values), directions)
        for i in range(len(names))
    ]
    sizes = [float(np.linalg.norm(one.values)) for one in off]
    sigmas = [float(np.sqrt(np.trace(one.covariance) / 2)) for one in off]
    ratios = np.array(sizes) / sigmas
    worst = int(np.argmax(ratios))
    if ratios[worst] > MOST_SIGMAS:
        raise MeasurementError(
            f'{names[worst]} is {np.degrees(sizes[worst]):.2f} degrees off the vertical of all,'
            f' {ratios[worst]:.1f} standard deviations; leave it out or pick its ends again'
        )


def _levelled(
    frame: MeasuredFrame, up: Uncertain, height: Uncertain | None, source: str
) -> SiteTie:
    vertical = up.values
    side = np.cross([0.0, 0.0, 1.0], vertical)
    side /= np.linalg.norm(side)
    R = np.stack([side, np.cross(vertical, side), vertical])
    origin = np.array([0.0, 0.0, 0.0 if height is None else float(height.values[0])])
    known = joined(up) if height is None else joined(up, height)
    # to turn a vertical that is off by (a, b) into the third axis takes (b, -a); the height of
    # the camera shifts
    linear = np.zeros((PARAMETERS, len(known.values)))
    linear[0, :3], linear[1, :3] = R[1], -R[0]
    if height is not None:
        linear[5, 3] = 1.0
    rest = Uncertain(known.values, {s: e for s, e in known.effects.items() if s != CALIBRATION})
    by_calibration = np.empty((PARAMETERS, 0))
    if CALIBRATION in known.effects and frame.rig.covariance is not None:
        # from the effects of the roots of the covariance back to those of the parameters
        inverse = np.linalg.pinv(frame.calibration_root)
        by_calibration = linear @ known.effects[CALIBRATION] @ inverse
    covariance = linear @ rest.covariance @ linear.T
    tilt = np.degrees(np.sqrt(np.linalg.eigvalsh(propagate(lambda v: R @ v, up).covariance)[-1]))
    facts = {'level_by': source, 'tilt_sigma_deg': float(tilt)}
    return SiteTie(R, 1.0, np.zeros(3), origin, covariance, by_calibration, facts=facts)


def _upwards(ends: FloatArray) -> FloatArray:
    """Return the unit vector along two points (6,), upwards in the image."""
    along = ends[:3] - ends[3:]
    along = along / np.linalg.norm(along)
    return along if along[1] < 0 else -along
