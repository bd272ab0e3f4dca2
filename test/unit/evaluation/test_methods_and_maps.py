# SPDX-License-Identifier: Apache-2.0
"""Peers, robustness, error maps, timing and tables of the evaluation."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from binocular_recon.evaluation import peers, tables
from binocular_recon.evaluation.accuracy import summary
from binocular_recon.evaluation.accuracy.methods import (
    Method,
    MethodResult,
)
from binocular_recon.evaluation.accuracy.report import (
    ERROR_COLOURS,
    UNFILLED_COLOUR,
    UNKNOWN_COLOUR,
    error_map,
)
from binocular_recon.evaluation.accuracy.robustness import crop_changes, darkened, exposure_change
from binocular_recon.evaluation.accuracy.scenes import TruthScene, read_scene
from binocular_recon.evaluation.timing import interleaved
from binocular_recon.images import Image


def test_ximgproc_rows_need_ximgproc(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(peers, 'has_ximgproc', lambda: False)
    plain = ['StereoBM 15', 'StereoSGBM 5 (3WAY)', 'StereoSGBM 5 (HH)']
    assert [matcher.name for matcher in peers.opencv_matchers()] == plain
    monkeypatch.setattr(peers, 'has_ximgproc', lambda: True)
    names = [matcher.name for matcher in peers.opencv_matchers()]
    assert set(names) - set(plain) == {
        'StereoBM 15 + WLS',
        'StereoSGBM 5 (3WAY) + WLS',
        'StereoSGBM 5 (3WAY) + WLS 800',
        'StereoSGBM 5 (HH) + WLS',
    }


def test_images_for_opencv() -> None:
    deep = np.array([[0, 257, 65535, 385]], np.uint16)
    assert peers.to_bytes(deep).tolist() == [[0, 1, 255, 1]]
    assert peers.to_guide(deep).shape == (1, 4, 3)
    assert peers.padded(deep, 2).tolist() == [[0, 0, 0, 257, 65535, 385]]
    fixed = np.array([[0, 0, -16, 40]], np.int16)
    np.testing.assert_array_equal(peers.from_fixed_point(fixed, 1), [[0, np.nan, 2.5]])


def test_exposure_change(scenes: Path) -> None:
    scene = read_scene(scenes / 'park')
    dark = darkened(scene)
    assert np.array_equal(dark.right, np.rint(scene.right * 0.6 + 20).astype(np.uint8))
    assert dark.left is scene.left

    def prepare(_: Image, right: Image, __: int) -> Callable[[], MethodResult]:
        shift = 0.0 if np.array_equal(right, scene.right) else 5.0
        return lambda: MethodResult(scene.truth_px + np.float32(shift))

    change = exposure_change(scene, Method('fragile', prepare))
    assert (change.bad_percent, change.changed_bad_percent) == (0, 100)
    table = summary.exposure_table([change])
    assert '+100.0' in table


def test_crop_changes_by_depth(scenes: Path) -> None:
    scene = read_scene(scenes / 'park')

    def prepare(left: Image, _: Image, __: int) -> Callable[[], MethodResult]:
        # a method whose result near the border of the image depends on where that border is
        values = np.zeros(left.shape[:2], np.float32)
        values[:6] = 3.0
        return lambda: MethodResult(values)

    changes = {c.depth_px: c for c in crop_changes(scene, Method('global', prepare))}
    assert changes[0].largest_px == changes[4].largest_px == 3.0
    assert changes[8].largest_px == 0.0
    assert set(changes) == {0, 4, 8, 16, 32}  # deeper than that nothing is left of the crop


def test_matching_does_not_depend_on_the_cut(scenes: Path) -> None:
    from binocular_recon.evaluation.accuracy.methods import match_method

    scene: TruthScene = read_scene(scenes / 'park')
    changes = crop_changes(scene, match_method('paper'))
    inside = [change for change in changes if change.depth_px >= 8]
    assert inside
    for change in inside:
        assert change.largest_px == 0


def test_error_map_by_hand() -> None:
    truth = np.array([[10, 10, 10, np.nan, 10, 10]], np.float32)
    estimate = np.array([[10, 11, 11.5, 10, np.nan, 30]], np.float32)
    expected = [
        ERROR_COLOURS[0],
        ERROR_COLOURS[2],  # an error of 1 px is not above 1 px
        ERROR_COLOURS[3],
        UNKNOWN_COLOUR,
        UNFILLED_COLOUR,
        ERROR_COLOURS[-1],
    ]
    assert error_map(estimate, truth)[0, :, ::-1].tolist() == [list(colour) for colour in expected]


def test_interleaved_takes_turns_and_returns_medians(monkeypatch: pytest.MonkeyPatch) -> None:
    turns: list[str] = []
    clock = iter([0.0, 0.0, 1.0, 1.0, 3.0, 10.0, 15.0, 20.0, 21.0, 30.0, 32.0, 40.0, 43.0])
    monkeypatch.setattr('time.perf_counter', lambda: next(clock))
    contestants = {'a': lambda: turns.append('a'), 'b': lambda: turns.append('b')}
    assert interleaved(contestants, repeat=3, warm_up=0) == {'a': 2.0, 'b': 2.0}
    assert turns == ['a', 'b'] * 3


def test_interleaved_stops_when_time_is_up() -> None:
    turns: list[str] = []
    interleaved({'a': lambda: turns.append('a')}, repeat=50, warm_up=1, limit_s=0.0)
    assert len(turns) == 4  # the warm-up and the least number of rounds


def test_tables_are_markdown() -> None:
    table = tables.markdown_table(['name', 'x'], [['a', '1.0'], ['longer', '22.0']])
    assert table.splitlines() == [
        '| name   |    x |',
        '|--------|-----:|',
        '| a      |  1.0 |',
        '| longer | 22.0 |',
    ]
