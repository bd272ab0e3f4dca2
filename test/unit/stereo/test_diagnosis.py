# SPDX-License-Identifier: Apache-2.0
"""Why few pixels match, and by how much rows are off."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable
from pathlib import Path
from unittest.mock import Mock

import cv2
import numpy as np
import pytest

from binocular_recon.config import MatchConfig
from binocular_recon.errors import ImageError
from binocular_recon.images import FloatImage, to_grey
from binocular_recon.inputs.image_faults import image_fault, same_image
from binocular_recon.stereo.diagnosis import EXAMINE_EVERY, NOTHING, PairCheck, explain_few
from binocular_recon.stereo.matching import Match, match
from binocular_recon.stereo.row_check import matched_features, measure_rows, seen_by_both
from binocular_recon.stereo.validity import few_matched_warning

CONFIG = MatchConfig(disparity_range=32)
Change = Callable[[FloatImage], FloatImage]


def pair(shape: tuple[int, int] = (180, 260)) -> tuple[FloatImage, FloatImage]:
    """Return a slanted plane with texture in two directions, 5 to 20 px of disparity."""
    height, width = shape
    noise = np.random.default_rng(3).uniform(0, 255, (height, width + 64)).astype(np.float32)
    wide = cv2.GaussianBlur(noise, (0, 0), 1.5)
    wide = (wide - wide.mean()) * 3 + 128
    y, x = np.mgrid[:height, :width].astype(np.float32)
    left = cv2.remap(wide, x + 32 - (5 + 15 * y / height), y, cv2.INTER_CUBIC)
    return np.clip(left, 0, 255), np.clip(wide[:, 32 : 32 + width], 0, 255)


LEFT, RIGHT = pair()


def moved(image: FloatImage, matrix: list[list[float]]) -> FloatImage:
    size = image.shape[1], image.shape[0]
    return np.asarray(
        cv2.warpAffine(
            image,
            np.array(matrix, np.float32),
            size,
            flags=cv2.INTER_CUBIC,
            borderMode=cv2.BORDER_REFLECT,
        )
    )


def shifted(dy: float) -> Change:
    return lambda image: moved(image, [[1, 0, 0], [0, 1, dy]])


def examine(left: FloatImage, right: FloatImage) -> tuple[Match, PairCheck]:
    return match(left, right, CONFIG), PairCheck()


@pytest.mark.parametrize('dy', [0.0, 0.3, -0.7, 1.2, 2.0])
def test_row_offset_is_measured(dy: float) -> None:
    right = shifted(dy)(RIGHT)
    matched, check = examine(LEFT, right)
    found = check.update(LEFT, right, matched, CONFIG)
    assert found.rows.points > 100
    assert found.rows.median_px == pytest.approx(dy, abs=0.08)
    assert bool(found.warnings) == (abs(dy) > 0.5)
    if found.warnings:
        side = 'lower' if dy > 0 else 'higher'
        assert (
            f'differ by {abs(found.rows.median_px):.2f} px: the right image is {side}'
            in (found.warnings[0])
        )


def test_a_turned_camera_is_told_from_a_displaced_one() -> None:
    height, width = RIGHT.shape
    right = moved(RIGHT, cv2.getRotationMatrix2D((width / 2, height / 2), 0.8, 1).tolist())
    matched, check = examine(LEFT, right)
    (text,) = check.update(LEFT, right, matched, CONFIG).warnings
    assert 'up in one part of the image and down in another: a camera has turned' in text


def test_without_corners_nothing_is_said() -> None:
    stripes = np.tile(np.sin(np.arange(260) / 2) * 90 + 128, (180, 1)).astype(np.float32)
    nothing = measure_rows(stripes, stripes, np.zeros_like(stripes))
    assert np.isnan(nothing.median_px) and nothing.warning == ''
    none = np.full_like(LEFT, np.nan)
    assert measure_rows(LEFT, RIGHT, none).points == 0
    assert measure_rows(none, none, none).warning == ''


def every_second_row_moved(image: FloatImage) -> FloatImage:
    fields = image.copy()
    fields[1::2] = np.roll(image, 9, axis=1)[1::2]
    return fields


def rotated(degrees: float, scale: float = 1.0) -> Change:
    """Turn an image counter-clockwise about its middle, and enlarge it."""
    matrix = cv2.getRotationMatrix2D((129.5, 89.5), degrees, scale)
    return lambda image: moved(image, matrix.tolist())


def dim_noise(image: FloatImage) -> FloatImage:
    noise = np.random.default_rng(4).normal(3, 1, image.shape)
    return np.rint(np.abs(noise)).astype(np.float32)


def other_scene(image: FloatImage) -> FloatImage:
    noise = np.random.default_rng(9).uniform(0, 255, image.shape).astype(np.float32)
    return np.asarray((cv2.GaussianBlur(noise, (0, 0), 1.5) - 128) * 3 + 128, np.float32)


CAUSES: dict[str, tuple[Change, str]] = {
    'turned': (
        lambda image: image[::-1, ::-1],
        'image is upside down .*: [01]% of the .* and [89]',
    ),
    'flipped': (lambda image: image[::-1], 'one of the images is flipped top to bottom'),
    'mirrored': (lambda image: image[:, ::-1], 'image is mirrored left to right'),
    'rows': (shifted(12), 'rows of left and right differ by about 12.0 px: the {} image is lower'),
    'far rows': (
        shifted(-35),
        'rows of left and right differ by about 3[45].. px: the {} image is higher',
    ),
    'covered': (dim_noise, 'the {} image is dark: 99 % of its grey levels are .* the lens cap'),
    'black': (lambda image: 0 * image, r'the {} image is uniform \(grey level 0\)'),
    'white': (lambda image: 0 * image + 255, r'the {} image is uniform \(grey level 255\)'),
    'saturated': (
        lambda image: np.minimum(image * 4, 255),
        'the {} image is saturated in .. % of its pixels; shorten the exposure',
    ),
    'defocused': (
        lambda image: np.asarray(cv2.GaussianBlur(image, (0, 0), 9), np.float32),
        'the {} image is less sharp than the .* one, 0.1. times; focus',
    ),
    'faint': (
        lambda image: np.asarray(image / 8 + 100, np.float32),
        'the {} image has less contrast than the .* one, 0.1. times; set its exposure',
    ),
    'dim': (
        lambda image: np.asarray(image / 10 + dim_noise(image), np.float32),
        'the {} image has less contrast than the .* one, 0.1. times; set its exposure',
    ),
    'noise': (
        lambda image: np.asarray(40 + 9 * dim_noise(image), np.float32),
        'the {} image is noise: neighbours differ by 1... times its contrast, .* by 0.[34].; chec',
    ),
    'hooded': (
        lambda image: np.where(np.arange(260) < 150, 5, image).astype(np.float32),
        'the {} image is dark and even in 5.% of its area, the .* one in 0%: something covers',
    ),
    'leaning': (
        rotated(-7),
        'the right image is turned by about 7.. degrees {}clockwise',
    ),
    'enlarged': (rotated(0, 1.2), 'the right image shows everything {} times as large'),
    'negative': (
        lambda image: 255 - image,
        'images is a negative of the other one: [01]% .* and [89].% .*; set both cameras to',
    ),
    'another scene': (
        other_scene,
        'left and right show different things: .% of ... features .* by chance; check that both',
    ),
    'fields': (every_second_row_moved, 'the {} image is interlaced: rows next to each other'),
}


@pytest.mark.parametrize('side', ['left', 'right'])
@pytest.mark.parametrize('cause', CAUSES)
def test_the_cause_of_few_matches_is_said(cause: str, side: str) -> None:
    change, text = CAUSES[cause]
    images = {'left': LEFT, 'right': RIGHT}
    images[side] = np.ascontiguousarray(change(images[side]), np.float32)
    matched, check = examine(images['left'], images['right'])
    few = dataclasses.replace(matched, disparity_px=np.full_like(LEFT, np.nan))
    found = check.update(images['left'], images['right'], few, CONFIG).cause
    named = side
    if cause in {'rows', 'far rows'} and side == 'left':
        named, text = (
            'right',
            text.rpartition(' ')[0] + (' higher' if text.endswith('lower') else ' lower'),
        )
    if cause == 'leaning':
        named = '' if side == 'right' else 'counter-'
    if cause == 'enlarged':
        named = r'1\.20' if side == 'right' else r'0\.8[34]'
    assert re.search(text.format(named), found), found
    if cause in {'turned', 'mirrored'}:
        assert f'the {side} image' in found


def test_one_image_twice_is_said() -> None:
    """Of the camera that is wired to both topics; rectified by two maps it may match well."""
    around = MatchConfig(min_disparity=-16, disparity_range=32)
    matched = match(LEFT, LEFT, around)
    (text,) = PairCheck().update(LEFT, LEFT, matched, around).warnings
    assert matched.matched_share > 0.9
    assert text.startswith('left and right are the same image, so nothing can be measured; give')
    assert explain_few(LEFT, LEFT, CONFIG) == text
    for other in (RIGHT, LEFT[:90], LEFT.astype(np.uint8)):
        assert same_image(LEFT, other) == ''
    black = np.zeros_like(LEFT)
    assert same_image(black, black) == ''  # a lens cap says more
    assert NOTHING.preceded('') is NOTHING
    assert NOTHING.preceded(text).warnings == (text,) == (NOTHING.preceded(text).cause,)


def test_pairs_on_other_rows_and_of_other_scenes(shared_data: Path) -> None:
    """Of eight real pairs 60 to 86 % of the features fit two cameras, of other scenes 7 %."""

    def images(scene: str) -> tuple[FloatImage, FloatImage]:
        folder = shared_data / 'stereo' / scene
        left, right = (to_grey(cv2.imread(str(folder / f'{s}.png'))) for s in ('left', 'right'))
        return left, right

    def said(left: FloatImage, right: FloatImage) -> str:
        return seen_by_both(matched_features(left, right))

    (cones, cones_right), (_, teddy) = images('cones'), images('teddy')
    assert 'left and right show different things' in said(cones, teddy)
    assert said(cones, cones_right) == said(cones[:40, :40], teddy) == ''
    cameras = (min((shared_data / 'raw_stereo' / f'cam{c}').rglob('*.png')) for c in '01')
    left, right = (to_grey(cv2.imread(str(path))) for path in cameras)
    text = said(left, right)
    assert re.search(r'the same, but not on the same rows: \d\d% .* differ by 1[12]\.\d px', text)


def test_a_good_pair_has_no_cause() -> None:
    assert explain_few(LEFT, RIGHT, CONFIG) == ''
    matched, check = examine(LEFT, RIGHT)
    found = check.update(LEFT, RIGHT, matched, CONFIG)
    assert found.warnings == () and found.cause == ''


@pytest.mark.parametrize(
    ('change', 'text'),
    [
        (lambda image: cv2.GaussianBlur(image, (0, 0), 2.5), 'the right image is less sharp than'),
        (every_second_row_moved, 'the right image is interlaced'),
        (lambda image: image / 20 + dim_noise(image), 'the right image has less contrast than'),
    ],
)
def test_what_matches_worse_is_said_though_enough_matches(change: Change, text: str) -> None:
    right = change(RIGHT)
    matched, check = examine(LEFT, right)
    assert matched.matched_share > 0.3
    assert any(text in warning for warning in check.update(LEFT, right, matched, CONFIG).warnings)


def test_a_stream_is_examined_at_intervals(monkeypatch: pytest.MonkeyPatch) -> None:
    from binocular_recon.stereo import diagnosis

    counted = Mock(side_effect=measure_rows)
    monkeypatch.setattr(diagnosis, 'measure_rows', counted)
    matched, check = examine(LEFT, shifted(1.0)(RIGHT))
    warnings = {
        check.update(LEFT, shifted(1.0)(RIGHT), matched, CONFIG).warnings
        for _ in range(2 * EXAMINE_EVERY)
    }
    assert counted.call_count == 2
    assert len(warnings) == 1


def test_exchanged_images_are_refused() -> None:
    matched, check = examine(RIGHT, LEFT)
    with pytest.raises(ImageError, match='left and right are exchanged'):
        check.update(RIGHT, LEFT, matched, CONFIG)


def test_the_warning_names_the_cause() -> None:
    assert few_matched_warning(0.5, 'x') == ''
    assert few_matched_warning(0.1, 'x').endswith('could be matched; x')
    assert 'check that left and right' in few_matched_warning(0.1)
    assert image_fault(LEFT) == ''
    assert image_fault(LEFT * np.nan) == 'has no data (NaN) in all its pixels'


def test_real_pairs_are_not_doubted(shared_data: Path) -> None:
    for scene in ('motorcycle', 'cones', 'kitti12_000027', 'playground'):
        folder = shared_data / 'stereo' / scene
        left, right = (to_grey(cv2.imread(str(folder / f'{s}.png'))) for s in ('left', 'right'))
        config = MatchConfig(disparity_range=256)
        matched = match(left, right, config)
        found = PairCheck().update(left, right, matched, config)
        assert found.warnings == () and found.rows.spread_px < 0.35, scene
    sequence = shared_data / 'outdoor_sequence'
    left, right = (
        to_grey(cv2.imread(str(sequence / f'{s}_000004.png'))) for s in ('left', 'right')
    )
    found = PairCheck().update(left, right, match(left, right, CONFIG), CONFIG)
    assert found.warnings == () and found.rows.points > 100
