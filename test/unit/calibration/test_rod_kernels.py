# SPDX-License-Identifier: Apache-2.0
"""Kernels of rod detection against images drawn and plane geometry worked out another way."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from binocular_recon.calibration.detection._edge_fit import fit_edge
from binocular_recon.calibration.detection._guided_search import Averaged
from binocular_recon.calibration.detection._layout_kernels import predict_rod
from binocular_recon.calibration.detection._rod_sides import fit_rods
from binocular_recon.calibration.detection._search_kernels import OUTSIDE, centre_rod, search_line
from binocular_recon.calibration.target.mark_types import BAND_EDGE
from binocular_recon.camera import FloatArray

pytestmark = pytest.mark.kernel

HEIGHT, WIDTH = 72, 60
# between two samples
MARKS_Y = np.array([60.25, 42.625, 24.125])
# Pixels are averaged from so many by so many samples.
FINE = 8


def drawn(
    middle: float, slope: float, width: float, flat: bool = False
) -> npt.NDArray[np.float32]:
    """Return a rod with three edges, sampled finely and blurred by 0.8 px."""
    y, x = (np.mgrid[: HEIGHT * FINE, : WIDTH * FINE] + 0.5) / FINE - 0.5
    light = (y < MARKS_Y[0]) & (y > MARKS_Y[1]) | (y < MARKS_Y[2])
    across = np.abs(x - middle - slope * (y - MARKS_Y[1])) < width / 2
    image = np.where(across, np.where(light, 200.0, 30.0), 90.0 if flat else 60 + x)
    blurred = cv2.GaussianBlur(image, (0, 0), 0.75 * FINE)
    small = cv2.resize(blurred, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA)
    return np.asarray(small, np.float32)


def marks_at(middle: float, slope: float) -> FloatArray:
    return np.column_stack([middle + slope * (MARKS_Y - MARKS_Y[1]), MARKS_Y])


@pytest.mark.parametrize('width', [4.0, 9.0])
def test_sides_and_edges_are_found_to_hundredths(width: float) -> None:
    image = drawn(28.37, 0.06, width)
    rough = marks_at(28.37, 0.06) + np.array([[1.0, 1.0], [-0.5, -1.0], [0.8, 0.6]])
    widths, light = np.full((1, 3), 1.03 * width), BAND_EDGE.light_bands(3)
    (rod,) = fit_rods(image, [rough], rough[None, :, 1], widths, light)
    assert rod is not None
    for mark in marks_at(28.37, 0.06):
        middle, _, half = rod.place(mark[1])
        assert abs(middle[0] - mark[0]) < 0.04
        assert abs(half - width / 2) < 0.1
        edge = fit_edge(image, rod, mark[1] + 0.7, (5.0, 5.0), None)
        assert edge is not None
        assert abs(edge.point_px[1] - mark[1]) < 0.03


def test_a_wide_rod_is_centred() -> None:
    image = drawn(30.0, 0.1, 20.0, flat=True)
    y = np.arange(6.0, 66.0)
    rows = np.column_stack([y, (y - 36) / 30])
    line = np.array([32.0, 1.0])
    centre_rod(image, rows, line, np.array([10.0, 0.0]), 60.0)
    z = np.array([-1.0, 1.0])
    truth = 30.0 + 0.1 * (36 + 30 * z - MARKS_Y[1])
    np.testing.assert_allclose(line[0] + line[1] * z, truth, atol=1.0)


def test_rods_are_predicted_as_a_plane_maps() -> None:
    """Three rods of a plane under perspective: the third from the other two."""
    matrix = np.array([[300.0, 20.0, 100.0], [15.0, -280.0, 700.0], [0.08, 0.02, 1.0]])
    heights, ends = np.array([0.2, 1.4]), np.empty((3, 5))
    for i, x in enumerate((0.0, 0.7, 1.9)):
        homogeneous = np.stack([np.full(2, x), heights, np.ones(2)], -1) @ matrix.T
        ends[i, :4] = (homogeneous[:, :2] / homogeneous[:, 2:]).ravel()
        # scale of the whole plane at the rod's bottom: the inverse of its depth
        ends[i, 4] = 1 / homogeneous[0, 2]
    predicted, nothing = np.empty(4), (0.0, 0.0, 0.0)
    assert predict_rod(ends[:2], (1.9 / 0.7, 0.0), nothing, predicted)
    np.testing.assert_allclose(predicted[:2], ends[2, :2], atol=1e-9)
    assert not predict_rod(ends[:2], (-20.0 / 0.7, 0.0), nothing, predicted)


def test_marks_are_searched_along_the_line() -> None:
    image = drawn(28.0, 0.0, 6.0)
    averaged = Averaged.of(image, 6.0)
    predicted = np.vstack([marks_at(28.0, 0.0) + np.array([2.0, -1.5]), [30.0, -12.0]])
    points, agreement = np.full((4, 2), np.nan), np.zeros(4)
    search_line(
        averaged.middle, averaged.near, predicted, BAND_EDGE.dark_below(4),
        np.array([4.0, 3.0, 1.0, 1.0]),
        np.array([30.0, 200.0]), averaged.rises_px, points, agreement,
    )  # fmt: skip
    assert (agreement[:3] > 0.8).all() and agreement[3] == OUTSIDE
    np.testing.assert_allclose(points[:3], marks_at(28.0, 0.0), atol=1.2)
