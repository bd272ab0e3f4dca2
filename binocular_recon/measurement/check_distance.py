# SPDX-License-Identifier: Apache-2.0
"""Check distances: a rod of known length anywhere in the scene, against a calibration.

A length of a metre or two at working distance tells in one number whether the calibration still
measures right; its standard deviation tells how sharp that test is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from binocular_recon.calibration.holding import MOST_SIGMAS
from binocular_recon.calibration.target.capture import Capture
from binocular_recon.calibration.target.rods import RodBoard
from binocular_recon.calibration.target.target import Target, seen_scale
from binocular_recon.camera import FloatArray, StereoRig
from binocular_recon.errors import CalibrationError
from binocular_recon.measurement.lengths import Length
from binocular_recon.measurement.uncertain import (
    CALIBRATION,
    Uncertain,
    joined,
    propagate,
    root_of,
)
from binocular_recon.number_text import significant
from binocular_recon.stereo.point_covariance import calibration_derivatives
from binocular_recon.stereo.rectification import rectified_points

# One standard deviation of marks in raw images on each axis, px: of detected ones, and of picks.
DETECTED_SIGMA_PX, PICKED_SIGMA_PX = 0.12, 0.3
# How exactly known lengths are known: a share of them (tapes), and m (edges).
KNOWN_SHARE, KNOWN_SIGMA_M = 0.0005, 0.0005


@dataclass(frozen=True)
class CheckDistance:
    """A known length and what a calibration measures.

    Attributes
    ----------
    name : str
    measured : Length
        With the standard deviation of marks, calibration and known length together.
    known_m, depth_m : float

    """

    name: str
    measured: Length
    known_m: float
    depth_m: float

    @property
    def off_sigmas(self) -> float:
        """Measured minus known length, in standard deviations."""
        return (self.measured.length_m - self.known_m) / self.measured.sigma_m

    @property
    def passed(self) -> bool:
        """Whether they agree within 3 standard deviations."""
        return abs(self.off_sigmas) <= MOST_SIGMAS

    def to_mapping(self) -> dict[str, Any]:
        """Return the comparison for ``check.json``."""
        return {
            'name': self.name,
            'measured_m': self.measured.length_m,
            'sigma_m': self.measured.sigma_m,
            'known_m': self.known_m,
            'depth_m': self.depth_m,
            'off_sigmas': self.off_sigmas,
            'passed': self.passed,
        }

    def __str__(self) -> str:
        """Return the comparison as a report states it."""
        return (
            f'check distance {self.name}: {self.measured} at {significant(self.depth_m)} m, known'
            f' {self.known_m:.3f} m: {self.off_sigmas:+.1f} sigma,'
            f' {"passed" if self.passed else "FAILED"}'
        )


def check_distances(
    rig: StereoRig, captures: Sequence[Capture], target: RodBoard | Target
) -> list[CheckDistance]:
    """Return a check distance of each board: the longest one that both cameras see.

    Parameters
    ----------
    rig : StereoRig
        The calibration, with its covariance where that is known.
    captures : sequence of Capture
        Marks in the raw images; NaN = not found.
    target : RodBoard or Target
        Rods: the length lies between the lowest and the highest mark seen on one rod. Points:
        between the two that are farthest apart; two, the ends of a rod, are enough.

    Raises
    ------
    CalibrationError
        If no board has two such marks.

    """
    if isinstance(target, RodBoard):
        target = Target.from_rods(target)
    found = [one for capture in captures if (one := _longest(rig, capture, target)) is not None]
    if not found:
        raise CalibrationError(
            'no check distance: both cameras must see two marks of a rod, or both ends of a known'
            ' length'
        )
    return found


def _longest(rig: StereoRig, capture: Capture, target: Target) -> CheckDistance | None:
    left, right = (
        rectified_points(camera, pixels.reshape(-1, 2)).reshape(*target.shape, 2)
        for camera, pixels in ((rig.left, capture.left_px), (rig.right, capture.right_px))
    )
    known = target.nominal_m
    if not target.has_rods:  # one group of points
        left, right, known = (one.reshape(1, -1, one.shape[-1]) for one in (left, right, known))
    best: tuple[float, FloatArray, FloatArray, int] | None = None
    for rod, (here, there, places) in enumerate(zip(left, right, known, strict=True), 1):
        pixels = np.concatenate([here, there], axis=-1)
        seen = np.flatnonzero(np.isfinite(pixels).all(axis=-1))
        if len(seen) < 2:
            continue
        apart = np.linalg.norm(places[seen][:, None] - places[seen], axis=-1)
        i, j = np.unravel_index(np.argmax(apart), apart.shape)
        if best is None or apart[i, j] > best[0]:
            best = float(apart[i, j]), pixels[seen[i]], pixels[seen[j]], rod
    if best is None or not best[0] > 0:
        return None
    length, first, last, rod = best
    sigma_px = DETECTED_SIGMA_PX if target.has_rods else PICKED_SIGMA_PX
    ends = joined(*(_point(rig, px, sigma_px, f'{i}') for i, px in enumerate((first, last))))
    measured = propagate(lambda both: np.linalg.norm(both[3:] - both[:3]), ends)
    value, sigma = float(measured.values[0]), float(measured.sigma[0])
    places = ends.values.reshape(2, 3)
    value /= seen_scale(places, target.radius_m, rig.right_centre_m)
    sigma = float(np.hypot(sigma, np.hypot(KNOWN_SHARE * length, KNOWN_SIGMA_M)))
    name = f'{capture.name} rod {rod}' if target.has_rods else capture.name
    return CheckDistance(name, Length(value, sigma), length, float(places[:, 2].mean()))


def _point(rig: StereoRig, pixels: FloatArray, sigma_px: float, name: str) -> Uncertain:
    """Return the point of rectified pixels (4,) of both images, with the effects on it."""

    def triangulated(pixels: FloatArray) -> FloatArray:
        both = pixels.reshape(2, 2, 1)
        found = cv2.triangulatePoints(rig.left.P, rig.right.P, both[0], both[1])
        return np.asarray(found[:3, 0] / found[3, 0], np.float64)

    seen = Uncertain(pixels, {('pick', name): sigma_px * np.eye(4)})
    point = propagate(triangulated, seen)
    if rig.covariance is None:
        return point
    moved = calibration_derivatives(point.values[None], rig)[0]
    return point.with_effect(CALIBRATION, moved @ root_of(rig.covariance.matrix))
