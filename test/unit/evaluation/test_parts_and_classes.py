# SPDX-License-Identifier: Apache-2.0
"""Errors by part and by class, on images whose parts and classes are known."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from binocular_recon.errors import ImageError
from binocular_recon.evaluation.accuracy import part_tables
from binocular_recon.evaluation.accuracy.error_classes import CLASSES, class_errors, classify
from binocular_recon.evaluation.accuracy.methods import MethodResult, preset_method
from binocular_recon.evaluation.accuracy.parts import flying_pixels, parts
from binocular_recon.evaluation.accuracy.scenes import TruthScene, read_scene
from binocular_recon.evaluation.accuracy.scoring import evaluate_scene
from binocular_recon.images import FloatImage
from binocular_recon.io.pfm import write_pfm
from test.unit.evaluation.scene_folder import answering

ROWS, COLUMNS = 60, 200


def wall_with_bar() -> FloatImage:
    """Return disparities of 4 px with a bar of 20 px in columns 90..109."""
    truth = np.full((ROWS, COLUMNS), 4, np.float32)
    truth[:, 90:110] = 20
    return truth


def test_pixels_fall_into_their_classes() -> None:
    truth = wall_with_bar()
    truth[40:, 150:] = 4 + np.float32(0.3) * np.arange(20)[:, None]  # a ground, slanted
    truth[0, 199] = np.nan
    random = np.random.default_rng(3)
    left = random.integers(0, 256, truth.shape).astype(np.uint8)
    left[:, 20:60] = 128  # blank
    left[:30, 120:180] = np.tile(random.integers(0, 256, (30, 10)), 6)  # repeats every 10 px
    visible = np.ones(truth.shape, bool)
    visible[:, 74:90] = False
    scene = TruthScene('x', 'x', left, left, truth, visible, 'visible.png', 32)
    classes = classify(scene)
    assert classes is not None
    assert classes[0, 199] == -1
    for name, rows, columns in (
        ('out of view', slice(0, 60), slice(0, 3)),
        ('occluded', slice(0, 60), slice(74, 90)),
        ('depth edge', slice(0, 60), slice(91, 94)),
        ('weak texture', slice(0, 60), slice(24, 56)),
        ('repetitive', slice(6, 24), slice(128, 172)),
        ('slanted', slice(46, 56), slice(158, 190)),
        ('other', slice(0, 60), slice(97, 102)),
    ):
        assert {CLASSES[i] for i in np.unique(classes[rows, columns])} == {name}
    estimate = truth.copy()
    estimate[:, 24:56] += 3
    estimate[:, 80] = np.nan
    found = {one.name: one for one in class_errors(classes, estimate, truth)}
    assert found['occluded'].bad_points == pytest.approx(100 * ROWS / (truth.size - 1))
    assert found['weak texture'].bad_points == pytest.approx(100 * ROWS * 32 / (truth.size - 1))
    assert sum(one.pixels_percent for one in found.values()) == pytest.approx(100)
    assert classify(dataclasses.replace(scene, visible=None)) is None
    assert class_errors(np.full_like(classes, -1), estimate, truth) == ()


def test_flying_pixels_hang_between_two_surfaces() -> None:
    truth, estimate = wall_with_bar(), wall_with_bar()
    truth[:, :10] = np.nan
    estimate[10, 88] = 12  # between wall and bar
    estimate[11, 88] = 4.9  # as good as on the wall
    estimate[12, 88] = 19.1
    estimate[13, 50] = 12  # wrong, but no other surface is near
    estimate[14, 88] = 26  # before both: wrong, not flying
    estimate[15, 88] = np.nan
    near, flying = flying_pixels(estimate, truth)
    assert np.argwhere(flying).tolist() == [[10, 88]]
    assert near[:, :7].sum() == 0
    assert near[:, 7:].sum() == ROWS * (COLUMNS - 7) - 1


def test_measured_and_filled_pixels_are_apart_and_sigma_covers() -> None:
    truth = np.full((10, 100), 8, np.float32)
    estimate, measured = truth.copy(), np.zeros(truth.shape, bool)
    measured[:5] = True
    sigma = np.full(truth.shape, 0.5, np.float32)
    estimate[:5, :50] += 0.6  # 1.2 sigma
    estimate[5:] += 3  # 6 sigma
    estimate[9, :50] = np.nan
    found = parts(estimate, sigma, measured, truth)
    assert list(found) == ['all', 'measured', 'filled']
    assert found['measured'].accuracy.pixels == 500 and found['filled'].accuracy.pixels == 450
    assert list(found['measured'].within_percent) == [50, 100, 100]
    assert list(found['filled'].within_percent) == [0, 0, 0]
    assert found['filled'].accuracy.bad_percent[1] == 100
    assert found['all'].within_percent[2] == pytest.approx(100 * 500 / 950)
    alone = parts(estimate, None, None, truth)
    assert list(alone) == ['all'] and np.isnan(alone['all'].within_percent).all()


def test_tables_add_up(scenes: Path) -> None:
    scene = read_scene(scenes / 'park')
    nothing = MethodResult(np.full_like(scene.truth_px, np.nan))
    methods = [preset_method('fast'), answering('blind', lambda: nothing)]
    result = evaluate_scene(scene, methods, 1)
    rows = [
        [cell.strip() for cell in line.split('|')[1:-1]]
        for line in part_tables.part_table([result.scores]).splitlines()
    ]
    assert [row[:2] for row in rows[2:]] == [
        ['fast', 'all'],
        ['fast', 'measured'],
        ['fast', 'filled'],
        ['blind', 'all'],
    ]
    shares = [float(row[2]) for row in rows[3:5]]
    assert sum(shares) == pytest.approx(100, abs=0.11)
    assert rows[5][3:] == ['100.0', '100.0', '-', '-', '-', '-', '-']
    table = part_tables.class_table([result.scores]).splitlines()
    ours = [float(cell) for cell in table[3].split('|')[2:-1]]
    bad = result.scores.scores[0].everywhere.bad_percent[1]
    assert sum(ours[:-1]) == pytest.approx(bad, abs=0.04)
    assert ours[-1] == pytest.approx(bad, abs=0.006)
    assert float(table[4].split('|')[-2]) == 100


def test_the_truth_of_both_images_tells_what_is_occluded(scenes: Path) -> None:
    folder = scenes / 'park'
    (folder / 'visible.png').unlink()
    truth = read_scene(folder).truth_px
    expected = read_scene(folder).visible
    assert expected is not None
    right = np.full_like(truth, -np.inf)
    for row, column in np.argwhere(np.isfinite(truth)):
        landed = round(float(column - truth[row, column]))
        if landed >= 0:
            right[row, landed] = max(right[row, landed], truth[row, column])
    write_pfm(folder / 'disparity_right.pfm', right)
    scene = read_scene(folder)
    assert scene.visible_source == 'both ground truths' and scene.visible is not None
    assert np.mean(scene.visible == expected) > 0.97
    write_pfm(folder / 'disparity_right.pfm', right[1:])
    with pytest.raises(ImageError, match=r'disparity_right\.pfm is 200x119 px'):
        read_scene(folder)
