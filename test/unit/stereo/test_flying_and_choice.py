# SPDX-License-Identifier: Apache-2.0
"""Flying pixels, and holes that follow the image."""

from __future__ import annotations

import math

import numpy as np
import pytest

from binocular_recon._jit import limit_threads
from binocular_recon._simd import LANES
from binocular_recon.config import MatchConfig
from binocular_recon.images import FloatImage
from binocular_recon.stereo.confidence import SIGMA_UNIT_PX, confidence_from_sigma
from binocular_recon.stereo.holes._choice_kernels import (
    DISTANCE,
    EDGE,
    LEVEL,
    SAME_SURFACE_PX,
    Costs,
    compare_ends_of_columns,
    compare_ends_of_rows,
)
from binocular_recon.stereo.holes.choice import follow_image
from binocular_recon.stereo.holes.completion import complete
from binocular_recon.stereo.matching._finishing_kernels import finish_strip
from binocular_recon.stereo.matching.refinement import drop_flying
from binocular_recon.stereo.matching.refinement.rejection import ALIKE_PX, EDGE_PX, WINDOW_PX
from binocular_recon.stereo.validity import Validity

pytestmark = pytest.mark.kernel
CONFIG = MatchConfig(disparity_range=64)


def patches(rng: np.random.Generator, rows: int, columns: int) -> FloatImage:
    """Return disparities of surfaces a few pixels wide, some without a match."""
    coarse = rng.uniform(5, 30, (rows // 6 + 1, columns // 6 + 1))
    values = coarse.repeat(6, axis=0).repeat(6, axis=1)[:rows, :columns]
    values += rng.normal(0, 0.7, values.shape)
    values[rng.uniform(size=values.shape) < 0.3] = np.nan
    return values.astype(np.float32)


def is_flying(disparity: FloatImage, y: int, x: int) -> bool:
    """Decide for one pixel, as slow and obvious as possible."""
    rows = slice(max(y - WINDOW_PX, 0), y + WINDOW_PX + 1)
    columns = slice(max(x - WINDOW_PX, 0), x + WINDOW_PX + 1)
    differences = disparity[rows, columns] - disparity[y, x]
    on_edge = np.nanmax(np.abs(differences)) > EDGE_PX
    alike = np.count_nonzero(np.abs(differences) <= np.float32(ALIKE_PX))
    share = differences.size / (2 * WINDOW_PX + 1) ** 2
    return bool(on_edge and alike < CONFIG.edge_support * share)


def test_flying_pixels_equal_the_naive_twin() -> None:
    disparity = patches(np.random.default_rng(0), 70, 41)
    disparity[20:60, 10:] = 12  # a large surface keeps its pixels
    expected = disparity.copy()
    for y, x in np.argwhere(~np.isnan(disparity)):
        if is_flying(disparity, y, x):
            expected[y, x] = np.nan
    sigma = np.where(np.isnan(disparity), np.float32(np.nan), np.float32(0.2))
    found = []
    for threads in (1, 3):
        limit_threads(threads)
        disparities, sigmas = disparity.copy(), sigma.copy()
        drop_flying(disparities, sigmas, CONFIG)
        np.testing.assert_array_equal(disparities, expected)
        np.testing.assert_array_equal(np.isnan(sigmas), np.isnan(expected))
        found.append(disparities)
    limit_threads(0)
    assert np.isnan(expected).mean() > np.isnan(disparity).mean() + 0.1
    off = disparity.copy()
    drop_flying(off, sigma, MatchConfig(disparity_range=64, edge_support=0))
    np.testing.assert_array_equal(off, disparity)


def test_slanted_surfaces_and_the_edges_of_large_ones_do_not_fly() -> None:
    rows, columns = np.mgrid[:60, :80].astype(np.float32)
    disparity = 10 + 0.25 * rows + 0.1 * columns
    disparity[:, 40:] += 12
    before = disparity.copy()
    drop_flying(disparity, np.ones_like(disparity), CONFIG)
    np.testing.assert_array_equal(disparity, before)
    disparity[:, 40] -= 6  # a column between the two
    drop_flying(disparity, np.ones_like(disparity), CONFIG)
    assert np.isnan(disparity[:, 40]).all()
    assert not np.isnan(np.delete(disparity, 40, axis=1)).any()


def candidates(
    measured: FloatImage, guide: FloatImage, y: int, x: int
) -> list[tuple[float, float]]:
    """Return cost and disparity of the nearest measured pixel in each of four directions."""
    height, width = measured.shape
    found = []
    for dy, dx in ((0, -1), (0, 1), (-1, 0), (1, 0)):
        levels, j, i = [float(guide[y, x])], y, x
        while 0 <= j + dy < height and 0 <= i + dx < width and np.isnan(measured[j, i]):
            j, i = j + dy, i + dx
            levels.append(float(guide[j, i]))
        if np.isnan(measured[j, i]):
            continue
        edge = max(abs(one - other) for one, other in zip(levels[1:], levels, strict=False))
        cost = DISTANCE * (len(levels) - 1) + LEVEL * abs(levels[0] - levels[-1]) + EDGE * edge
        found.append((float(cost), float(measured[j, i])))
    return found


def test_costs_of_candidates_equal_the_naive_twin() -> None:
    rng = np.random.default_rng(1)
    measured = patches(rng, 40, 150)
    measured[5:20, 10:40] = np.nan
    measured[:, 140:] = np.nan
    guide = rng.uniform(0, 255, measured.shape).astype(np.float32)
    measured[:, 60:90] = 15 + SAME_SURFACE_PX  # another surface, by no more than that
    measured[10:30, 70:80] = np.nan
    filled = np.where(np.isnan(measured), np.float32(15), measured)
    height, width = measured.shape
    costs = Costs(*np.zeros((3, height, width + LANES), np.float32))
    compare_ends_of_rows(measured, filled, guide, costs, 0, height)
    wide = ((0, 0), (0, LANES))
    images = np.pad(measured, wide), np.pad(filled, wide), np.pad(guide, wide)
    for start in (0, 128):
        compare_ends_of_columns(*images, costs, start, min(start + 128, width))
    for y, x in np.argwhere(np.isnan(measured)):
        found = candidates(measured, guide, y, x)
        near = [cost for cost, value in found if abs(value - filled[y, x]) < SAME_SURFACE_PX]
        assert costs.own[y, x] == pytest.approx(min(near, default=math.inf), rel=1e-5)
        assert costs.least[y, x] == pytest.approx(min(found)[0], rel=1e-5)
        assert costs.value[y, x] == min(found)[1]


def test_weak_texture_on_a_near_object_is_not_replaced_by_the_background() -> None:
    """A plain panel in front of a wall, of which only the upper part is matched."""
    left = np.full((80, 120), 60, np.float32)
    left[20:72, 40:90] = 150
    truth = np.where(left == 150, np.float32(30), np.float32(20))
    measured = truth.copy()
    measured[24:72, 38:92] = np.nan
    confidence = np.where(np.isnan(measured), 0, 1).astype(np.float32)
    plain, _ = complete(measured, confidence)
    assert (plain[40:70, 44:86] == 20).all()
    results = []
    for gain, threads in ((1.0, 1), (0.3, 3)):  # whatever the exposure
        limit_threads(threads)
        results.append(complete(measured, confidence, gain * left + 10)[0])
    limit_threads(0)
    assert (results[0][40:70, 44:86] == 30).all()
    assert (results[0][:, :36] == 20).all()
    np.testing.assert_array_equal(results[0], results[1])


def test_pixels_without_data_in_the_guide_change_nothing() -> None:
    measured = np.full((20, 30), 9, np.float32)
    measured[5:15, 10:20] = np.nan
    filled = np.where(np.isnan(measured), np.float32(4), measured)
    follow_image(measured, filled, np.full_like(measured, np.nan), np.isnan(measured))
    assert np.isfinite(filled).all()


def test_finishing_equals_its_naive_twin() -> None:
    rng = np.random.default_rng(4)
    disparity = rng.uniform(-1, 9, (7, 45)).astype(np.float32)
    sigma = rng.uniform(0, 2, disparity.shape).astype(np.float32)
    disparity[rng.random(disparity.shape) < 0.2] = np.nan
    sigma[rng.random(disparity.shape) < 0.1] = np.nan
    validity = rng.choice([Validity.MEASURED, Validity.AT_LIMIT], disparity.shape).astype(np.uint8)
    expected = np.rint(disparity * 64) / 64
    expected[(expected < 0) | (expected > 8)] = np.nan
    kept = np.isfinite(expected)
    reasons = np.where(validity == Validity.MEASURED, Validity.AMBIGUOUS, validity)
    found, why, confidence = disparity.copy(), validity.copy(), np.empty_like(disparity)
    finish_strip((found, sigma, why), 1 / 64, SIGMA_UNIT_PX, (0, 8), confidence, 0, 7)
    np.testing.assert_array_equal(found, expected)
    np.testing.assert_array_equal(why, np.where(kept, Validity.MEASURED, reasons))
    np.testing.assert_allclose(
        confidence, np.where(kept, confidence_from_sigma(sigma), 0), rtol=1e-6
    )
