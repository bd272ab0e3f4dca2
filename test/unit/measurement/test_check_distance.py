# SPDX-License-Identifier: Apache-2.0
"""A rod of known length against a calibration."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from binocular_recon.calibration.target.capture import Capture
from binocular_recon.calibration.target.target import Target
from binocular_recon.camera import StereoRig
from binocular_recon.errors import CalibrationError
from binocular_recon.measurement.check_distance import check_distances
from binocular_recon.simulation.rig import survey_rig
from test.unit.measurement.measured_site import calibration

LENGTH_M = 1.5


def captures(count: int, scale: float = 1.0) -> list[Capture]:
    """Return the ends of a rod at 6 to 14 m as both raw cameras see them, with noise."""
    rng, rig = np.random.default_rng(4), survey_rig(0.15)
    found = []
    for index in range(count):
        foot = np.array([rng.uniform(-1, 1), 0.8, rng.uniform(6, 14)])
        direction = np.array([0.1, -1.0, 0.1]) / np.linalg.norm([0.1, -1.0, 0.1])
        ends = np.stack([foot, foot + scale * LENGTH_M * direction])
        seen = [view.project(ends) + rng.normal(0, 0.02, (2, 2)) for view in rig.views()]
        found.append(Capture(f'{index}', *(pixels.reshape(2, 1, 2) for pixels in seen)))
    return found


def rod() -> Target:
    return Target.from_points(np.array([[0.0, 0, 0], [LENGTH_M, 0, 0]]))


def test_a_known_length_passes_and_one_that_is_off_fails() -> None:
    rig, _ = calibration()
    found = check_distances(rig, captures(6), rod())
    assert len(found) == 6 and all(one.passed for one in found)
    assert all(abs(one.measured.length_m - LENGTH_M) < 4 * one.measured.sigma_m for one in found)
    assert 'known 1.500 m' in str(found[0]) and 'passed' in str(found[0])
    wrong = check_distances(rig, captures(6, 1.2), rod())
    assert not any(one.passed for one in wrong) and 'FAILED' in str(wrong[0])
    # without the covariance of the calibration, sigma is that of the marks
    bare = check_distances(StereoRig(rig.left, rig.right), captures(6), rod())
    assert bare[0].measured.sigma_m < found[0].measured.sigma_m


def test_marks_of_rods_are_on_their_surface() -> None:
    rig, _ = calibration()
    points = check_distances(rig, captures(1), rod())[0]
    rods = Target(np.zeros((1, 3)), np.array([0.0, LENGTH_M]), np.zeros(5), radius_m=0.02)
    (one,) = (
        dataclasses.replace(
            c, left_px=c.left_px.reshape(1, 2, 2), right_px=c.right_px.reshape(1, 2, 2)
        )
        for c in captures(1)
    )
    found = check_distances(rig, [one], rods)[0]
    assert found.name == '0 rod 1'
    near = 1 - 0.02 / points.depth_m
    assert found.measured.length_m == pytest.approx(points.measured.length_m * near, rel=2e-4)


def test_a_length_of_which_one_end_is_seen_is_no_check() -> None:
    rig, _ = calibration()
    (one,) = captures(1)
    hidden = one.left_px.copy()
    hidden[0] = np.nan
    with pytest.raises(CalibrationError, match='no check distance'):
        check_distances(rig, [Capture('a', hidden, one.right_px)], rod())
