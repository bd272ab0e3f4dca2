# SPDX-License-Identifier: Apache-2.0
"""The evaluation on scenes made here, with figures known beforehand."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from binocular_recon.cli.main import main
from binocular_recon.errors import FileError, ImageError
from binocular_recon.evaluation import peers
from binocular_recon.evaluation.accuracy import summary
from binocular_recon.evaluation.accuracy.methods import (
    MethodResult,
    opencv_method,
    preset_method,
)
from binocular_recon.evaluation.accuracy.scenes import TruthScene, find_scenes, read_scene
from binocular_recon.evaluation.accuracy.scoring import Failures, evaluate_scene
from binocular_recon.evaluation.speed.synthetic import SyntheticPair, synthetic_pair
from binocular_recon.io.pfm import write_pfm
from test.unit.evaluation.scene_folder import (
    FACTS,
    HEIGHT,
    METRIC,
    RANGE,
    WIDTH,
    answering,
    write_scene,
)


def test_synthetic_pair_is_what_it_says(pair: SyntheticPair) -> None:
    x, y = np.meshgrid(np.arange(WIDTH, dtype=np.float32), np.arange(HEIGHT, dtype=np.float32))
    seen = cv2.remap(pair.right, x - pair.disparity_px, y, cv2.INTER_LINEAR)
    difference = np.abs(seen.astype(float) - pair.left).mean(axis=2)
    # both images have 1.5 grey levels of noise; the wrong sign or a pixel's shift gives over 15
    assert np.median(difference[pair.visible]) < 4
    assert np.median(difference[~pair.visible]) > 10
    assert 0 <= pair.disparity_px.min() < pair.disparity_px.max() <= RANGE - 1
    again = synthetic_pair(WIDTH, HEIGHT, RANGE, seed=5)
    assert np.array_equal(again.right, pair.right)


def test_scores_of_known_estimates(scenes: Path) -> None:
    scene = read_scene(scenes / 'park')
    truth, visible = scene.truth_px, scene.visible
    assert visible is not None
    off_by_one_and_a_half = MethodResult(truth + np.float32(1.5), np.full_like(truth, 0.1))
    visible_only = MethodResult(np.where(visible, truth, np.nan).astype(np.float32))
    half = MethodResult(truth + np.float32(0.5), np.full_like(truth, 0.25))
    methods = [
        answering('off', lambda: off_by_one_and_a_half, ours=True),
        answering('StereoSGBM 5 (3WAY)', lambda: visible_only),
        answering('half', lambda: half, ours=True),
    ]
    result = evaluate_scene(scene, methods, repeat=2)
    off, sparse, half_off = result.scores.scores
    assert list(off.everywhere.bad_percent) == [100, 0, 0]
    assert off.everywhere.mean_error_px == pytest.approx(1.5, abs=1e-5)
    assert off.sigma_rms is not None and np.isnan(off.sigma_rms)  # all are mismatches
    assert sparse.visible is not None and sparse.occluded is not None
    assert list(sparse.visible.bad_percent) == [0, 0, 0]
    assert list(sparse.occluded.bad_percent) == [100, 100, 100]
    assert sparse.everywhere.density_percent == pytest.approx(100 * visible.mean())
    assert sparse.sigma_rms is None
    assert half_off.sigma_rms == pytest.approx(2, abs=1e-4)
    # f B = 50, o = -2: the bias of 0.5 px brings everything nearer
    true_m = 50 / (truth + 2)
    band = (true_m >= 0) & (true_m < 5)
    expected = np.quantile((true_m - 50 / (truth + 2.5))[band], 0.5, method='higher')
    assert half_off.depth[0].pixels == band.sum() > 1000
    assert half_off.depth[0].median_m == pytest.approx(expected, rel=1e-3)
    assert half_off.depth[0].bias_m < 0
    mean = summary.mean_over_scenes([result.scores])
    assert mean[1].relative_time == 1
    assert mean[2].regions['visible'].mean_error_px == pytest.approx(0.5, abs=1e-5)


def test_mean_over_scenes_weighs_scenes_alike(scenes: Path) -> None:
    scene = read_scene(scenes / 'park')
    upper = dataclasses.replace(scene, truth_px=np.full_like(scene.truth_px, np.nan))
    upper.truth_px[:10] = scene.truth_px[:10]
    good = evaluate_scene(scene, [answering('x', lambda: MethodResult(scene.truth_px))], 1)
    bad = evaluate_scene(upper, [answering('x', lambda: MethodResult(scene.truth_px + 4))], 1)
    (mean,) = summary.mean_over_scenes([good.scores, bad.scores])
    assert list(mean.regions['everywhere'].bad_percent) == [50, 50, 50]
    assert np.isnan(mean.relative_time)


def test_presets_and_opencv_match_the_synthetic_scene(scenes: Path) -> None:
    scene = read_scene(scenes / 'park')
    methods = [opencv_method(peers.OpenCvMatcher('sgbm_3way')), preset_method('default')]
    theirs, ours = evaluate_scene(scene, methods, repeat=1).scores.scores
    assert theirs.visible is not None and ours.visible is not None
    assert theirs.visible.bad_percent[1] < 10
    assert ours.visible.bad_percent[1] < 10
    assert ours.everywhere.density_percent == 100
    # padded, StereoSGBM fills the left margin as well
    padded = opencv_method(peers.OpenCvMatcher('sgbm_3way')).estimate(scene)
    assert np.isfinite(padded.disparity_px[:, :RANGE]).mean() > 0.3
    assert padded.disparity_px.shape == (HEIGHT, WIDTH)


def test_command_writes_table_json_and_page(
    scenes: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / 'made' / 'out'
    arguments = ['evaluate', str(scenes), '--output', str(output), '--presets', 'default']
    options = ['--repeat', '1', '--match-only', '--exposure', '--crop', '--wls-lambda', '0.03']
    assert main([*arguments, *options]) == 0
    printed = capsys.readouterr().out
    facts = json.loads((output / 'evaluation.json').read_text())
    (scene,) = facts['scenes']
    names = [score['method'] for score in scene['scores']]
    expected = [matcher.name for matcher in peers.opencv_matchers()]
    assert names == [*expected, 'default, match only', 'default']
    assert facts['options'] == {'wls_lambda': 0.03}
    assert facts['machine']['versions']['opencv'] == cv2.__version__
    assert scene['visible_source'] == 'visible.png'
    mean = facts['mean'][-1]['regions']['everywhere']
    row = next(line for line in printed.splitlines() if line.startswith('| default '))
    assert [float(cell) for cell in row.split('|')[2:5]] == pytest.approx(
        mean['bad_percent'], abs=0.051
    )
    assert ('no ximgproc' in printed) == (not peers.has_ximgproc())
    assert {entry['method'] for entry in facts['exposure']} == set(names)
    assert {entry['depth_px'] for entry in facts['crop']} >= {0, 4, 8}
    for header in (
        '| of filled pixels px |',
        '| right image darker ',
        '| bad-2.0 % before | after |',
        '| effect of cropping: max px / p99 px / changed fill % |',
    ):
        assert header in printed
    assert '\n| 1 or more ' in printed and 'inf' not in printed
    page = (output / 'evaluation.html').read_text(encoding='utf-8')
    # image, ground truth, an error map each and a disparity map for each of ours
    assert page.count('<img') == page.count('data:image/') == 2 + len(names) + 2
    assert 'http://' not in page and 'https://' not in page


def test_a_broken_scene_does_not_stop_the_others(
    scenes: Path, pair: SyntheticPair, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_scene(scenes / 'broken', pair, FACTS)
    (scenes / 'broken' / 'disparity.pfm').write_bytes(b'Pf\n200 120\n-1\nshort')
    output = tmp_path / 'out'
    arguments = ['evaluate', str(scenes), '--output', str(output), '--presets', 'default']
    assert main([*arguments, '--no-peers', '--repeat', '1']) == 1
    captured = capsys.readouterr()
    assert 'broken/disparity.pfm is damaged' in captured.err
    assert 'Not evaluated (1 of 2): broken.' in captured.out
    facts = json.loads((output / 'evaluation.json').read_text())
    assert [scene['scene'] for scene in facts['scenes']] == ['park']
    assert list(facts['failures']) == ['broken']


def test_interrupted_evaluation_reports_what_is_finished(
    scenes: Path,
    pair: SyntheticPair,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    write_scene(scenes / 'square', pair, FACTS)

    def read_until_square(folder: Path) -> TruthScene:
        if folder.name == 'square':
            raise KeyboardInterrupt
        return read_scene(folder)

    monkeypatch.setattr('binocular_recon.cli.quality.evaluate.read_scene', read_until_square)
    output = tmp_path / 'out'
    arguments = ['evaluate', str(scenes), '--output', str(output), '--presets', 'default']
    assert main([*arguments, '--no-peers', '--repeat', '1']) == 130
    assert f'interrupted; 1 of 2 scenes are in {output}' in capsys.readouterr().err
    facts = json.loads((output / 'evaluation.json').read_text())
    assert [scene['scene'] for scene in facts['scenes']] == ['park']


def test_nothing_to_evaluate_is_wrong_usage(
    scenes: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(['evaluate', str(scenes), '--no-peers', '--presets', '']) == 2
    assert 'nothing to evaluate: name a preset' in capsys.readouterr().err


def test_several_broken_scenes_are_all_named() -> None:
    failures = Failures()
    for name in ('one', 'two'):
        with failures.of(name):
            raise FileError(f'{name}/scene.yaml is missing')
    with pytest.raises(FileError, match=r'2 of 5 scenes .*one/scene.yaml is.*two/scene.yaml'):
        failures.raise_if_any(5)


def test_scene_folders_are_found(scenes: Path, tmp_path: Path) -> None:
    assert [path.name for path in find_scenes(scenes)] == ['park']
    assert find_scenes(scenes / 'park') == [scenes / 'park']
    assert find_scenes(scenes, ['park']) == [scenes / 'park']
    with pytest.raises(FileError, match=r'has no scene lake; it has park'):
        find_scenes(scenes, ['lake'])
    with pytest.raises(FileError, match=r'holds no scene folder; a scene has left\.png'):
        find_scenes(tmp_path)
    with pytest.raises(FileError, match='is not a folder'):
        find_scenes(tmp_path / 'absent')


@pytest.mark.parametrize(
    ('facts', 'message'),
    [
        ({'source': 'x'}, r'park/scene\.yaml lacks max_disparity_px'),
        ({'max_disparity_px': 'many'}, r"max_disparity_px must be a finite number, got 'many'"),
        ({'max_disparity_px': 0}, 'max_disparity_px must be positive, got 0'),
        ({**METRIC, 'baseline_m': -0.5}, r'baseline_m must be positive, got -0\.5'),
        ({**METRIC, 'focal_px': float('nan')}, 'focal_px must be a finite number, got nan'),
    ],
)
def test_bad_facts_are_named(scenes: Path, facts: dict[str, object], message: str) -> None:
    (scenes / 'park' / 'scene.yaml').write_text(yaml.safe_dump(facts), encoding='utf-8')
    with pytest.raises(FileError, match=message):
        read_scene(scenes / 'park')


def test_damaged_and_missing_files_are_named(scenes: Path) -> None:
    (scenes / 'park' / 'scene.yaml').write_text('a: [', encoding='utf-8')
    with pytest.raises(FileError, match=r'scene\.yaml is not valid YAML'):
        read_scene(scenes / 'park')
    (scenes / 'park' / 'scene.yaml').unlink()
    with pytest.raises(FileError, match=r'scene\.yaml cannot be read: No such file'):
        read_scene(scenes / 'park')


@pytest.mark.parametrize('name', ['right.png', 'visible.png'])
def test_sizes_that_differ_are_named(scenes: Path, pair: SyntheticPair, name: str) -> None:
    cv2.imwrite(str(scenes / 'park' / name), pair.left[:-2])
    with pytest.raises(ImageError, match=f'park/{name} is 200x118 px, left.png is 200x120 px'):
        read_scene(scenes / 'park')


def test_a_method_that_refuses_a_scene_is_named(scenes: Path) -> None:
    def refuse() -> MethodResult:
        raise ImageError('too small')

    with pytest.raises(ImageError, match='scene park, picky: too small'):
        evaluate_scene(read_scene(scenes / 'park'), [answering('picky', refuse)], 1)


def test_visibility_is_derived_from_dense_truth_only(scenes: Path, pair: SyntheticPair) -> None:
    (scenes / 'park' / 'visible.png').unlink()
    scene = read_scene(scenes / 'park')
    assert scene.visible_source == 'ground truth'
    assert scene.visible is not None
    assert np.mean(scene.visible == pair.visible) > 0.97
    sparse = np.where(np.arange(WIDTH) % 3 == 0, pair.disparity_px, np.nan).astype(np.float32)
    write_pfm(scenes / 'park' / 'disparity.pfm', sparse)
    scene = read_scene(scenes / 'park')
    assert scene.visible is None
    result = evaluate_scene(
        scene, [answering('truth', lambda: MethodResult(pair.disparity_px))], 1
    )
    assert result.scores.scores[0].occluded is None
