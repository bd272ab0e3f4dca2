# SPDX-License-Identifier: Apache-2.0
"""The benchmark at a size that takes seconds."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from binocular_recon.cli.main import main
from binocular_recon.config import FilterConfig
from binocular_recon.evaluation import peers
from binocular_recon.evaluation.speed import direct_solver as direct
from binocular_recon.evaluation.speed import probe, stages
from binocular_recon.evaluation.speed.benchmark import (
    BY_CONTENT,
    STAGES,
    Timing,
    growth,
    time_stage,
)
from binocular_recon.evaluation.speed.content import Content, Size, shipped, site, synthetic
from binocular_recon.evaluation.speed.stages import Bench
from binocular_recon.evaluation.speed.synthetic import synthetic_pair
from binocular_recon.stereo.filtering._equations import normal_equations
from binocular_recon.stereo.pipeline import Chain
from test import naive_wls

SMALL = Size(128, 96, 16)

pytestmark = pytest.mark.long


@pytest.fixture(scope='module')
def bench() -> Bench:
    return Bench(synthetic(SMALL), ['default'])


@pytest.mark.parametrize('make', [lambda: shipped(Size(150, 90, 16)), lambda: site(0.08)])
def test_real_content_has_its_disparities(make: Callable[[], Content]) -> None:
    content = make()
    bench = Bench(content, ['default'])
    (match,) = bench.matches.values()
    assert bench.pair[0].shape == (content.size.height, content.size.width, 3)
    assert match.matched_share > 0.5
    assert bench.iterations['default'] >= 1


def test_the_contestants_do_the_same_work(bench: Bench) -> None:
    rectify = stages.rectifying(bench)
    theirs, ours = (contestant() for contestant in rectify.values())
    # their maps are rounded to 1/32 px
    np.testing.assert_allclose(np.asarray(theirs), np.asarray(ours), atol=4)
    cloud = stages.triangulating(bench)
    points = np.asarray(cloud['cv2.reprojectImageTo3D']())
    our_cloud = cloud['triangulate']()
    np.testing.assert_allclose(our_cloud.points_xyz, points, rtol=1e-4, atol=1e-4)  # type: ignore[attr-defined]


def test_every_stage_has_its_peers_first(bench: Bench) -> None:
    names = {stage: list(contestants(bench)) for stage, contestants in STAGES.items()}
    assert names['match'] == [
        'StereoSGBM 5 (3WAY)',
        'StereoBM 15',
        'StereoSGBM 5',
        'default',
    ]
    assert names['exact WLS'][-2:] == ['default', 'default, warm']
    assert ('ximgproc DisparityWLSFilter' in names['exact WLS']) == peers.has_ximgproc()
    assert names['rectify'][0] == 'cv2.remap'
    assert names['cloud'][0] == 'cv2.reprojectImageTo3D'


def test_recorded_images_are_those_that_the_chain_reconstructs() -> None:
    bench = Bench(synthetic(Size(320, 240, 32)), ['default'])
    truth_px = synthetic_pair(320, 240, 32).disparity_px
    chain = Chain(bench.rig, bench.config('default'))
    error = chain(*bench.recorded).filtered.disparity_px - truth_px
    assert np.mean(np.abs(error) > 1) < 0.1


def test_times_are_relative_to_the_first(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    medians = {'peer': 0.2, 'ours': 0.1}
    monkeypatch.setattr(
        'binocular_recon.evaluation.speed.benchmark.interleaved',
        lambda *_args, **_options: medians,
    )
    assert time_stage('match', bench, {}, 1) == [
        Timing('match', 'synthetic 128x96x16', 'peer', False, 0.2, 1.0),
        Timing('match', 'synthetic 128x96x16', 'ours', False, 0.1, 0.5),
    ]


def test_without_the_peer_nothing_is_relative(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    medians = {'default': 0.2, 'default, warm': 0.1}
    monkeypatch.setattr(
        'binocular_recon.evaluation.speed.benchmark.interleaved',
        lambda *_args, **_options: medians,
    )
    timings = time_stage('exact WLS', bench, {}, 1)
    assert all(math.isnan(timing.relative) for timing in timings)


def test_growth_is_per_pixel_and_disparity() -> None:
    contents = [synthetic(Size(10, 10, 16)), synthetic(Size(20, 10, 16))]
    timings = [
        Timing('match', 'synthetic 10x10x16', 'ours', False, 1.6e-6, 1.0),
        Timing('match', 'synthetic 20x10x16', 'ours', False, 6.4e-6, 1.0),
        Timing('chain', 'synthetic 20x10x16', 'ours', False, 1.0, 1.0),
    ]
    assert growth(timings, contents) == {'ours': pytest.approx([1.0, 2.0])}


def test_direct_solver_minimises_eq_11() -> None:
    random = np.random.default_rng(2)
    data = random.uniform(0, 10, (5, 7)).astype(np.float32)
    weight = np.where(random.random((5, 7)) < 0.4, 0, random.random((5, 7))).astype(np.float32)
    data[weight == 0] = np.nan
    guide = random.uniform(0, 255, (5, 7)).astype(np.float32)
    config = FilterConfig(
        wls_lambda=0.3,
        wls_alpha=1.5,
        wls_epsilon=1e-3,
        wls_complete=False,
        wls_disparity_steps=0.0,
    )
    exact = naive_wls.minimiser(
        data.astype(float),
        weight.astype(float),
        naive_wls.log_luminance(guide),
        0.3,
        1.5,
        1e-3,
    )
    solution = direct.solve_direct(normal_equations(data, weight, guide, config))
    np.testing.assert_allclose(solution, exact, atol=1e-4)


@pytest.mark.parametrize('preset', ['default', 'paper'])
def test_our_filter_is_held_against_the_direct_solver(preset: str) -> None:
    result = direct.compare(Bench(synthetic(SMALL), [preset]), preset)
    assert result['largest_error_px'] < FilterConfig().wls_tolerance_px * 2
    assert result['direct_s'] > 0 and result['filter_s'] > 0


def test_peak_memory_counts_what_the_match_allocates() -> None:
    size = (640, 480, 16)
    result = probe.peak_memory('default', *size)
    # at least its two results of 4 bytes per pixel; far less than a volume of float64 would be
    assert 640 * 480 * 8 / 1e6 < result['peak_mb'] < 100
    assert result['bytes_per_score'] == pytest.approx(result['peak_mb'] * 1e6 / np.prod(size))


def test_first_call_is_measured_in_a_process_of_its_own() -> None:
    result = probe._in_process('first-call', 'default', *SMALL.numbers)
    assert 0 < result['second_s'] <= result['first_s'] * 1.5
    assert 0 < result['import_s'] < 60


def test_a_measurement_that_fails_says_why() -> None:
    with pytest.raises(probe.ProbeError, match=r'memory of preset best failed: .*best'):
        probe.peak_memory('best', *SMALL.numbers)


def test_command_prints_tables_and_writes_json(
    scenes: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr('binocular_recon.evaluation.speed.content._SITE_SCALE', 0.1)
    calls = {'import_s': 1.0, 'first_s': 2.0, 'second_s': 0.5}
    # a cold cache means to compile everything: too slow here, and tested above with a warm one
    monkeypatch.setattr(probe, 'first_call', lambda *_args: {'cold': calls, 'warm': calls})
    output = tmp_path / 'out'
    arguments = ['benchmark', '--sizes', '128x96x16', '160x96x32', '--presets', 'default']
    arguments += ['--repeat', '1', '--scenes', str(scenes), '--output', str(output)]
    assert main(arguments) == 0
    printed = capsys.readouterr().out
    facts = json.loads((output / 'benchmark.json').read_text())
    assert facts['machine']['cores'] >= 1
    sizes = '128x96x16', '160x96x32'
    real = ['park 200x120x32', *(f'motorcycle {size}' for size in sizes), 'site 192x120x48']
    contents = [*real, 'synthetic 160x96x32']
    seen = {(timing['stage'], timing['content']) for timing in facts['results']['timings']}
    assert seen == {
        *((stage, content) for stage in BY_CONTENT for content in contents),
        *((stage, f'synthetic {size}') for stage in ('rectify', 'cloud') for size in sizes),
    }
    assert {one['content'] for one in facts['results']['timings'] if one['real']} == set(real)
    assert list(facts['results']['iterations']) == contents
    assert all(timing['seconds'] > 0 for timing in facts['results']['timings'])
    for title in (*STAGES, 'mean of real content', 'chain, pairs', 'peak memory', 'first call'):
        assert f'\n| {title}' in '\n' + printed
    assert '| default, cold cache' in printed
    assert ('no ximgproc' in printed) == (not peers.has_ximgproc())


@pytest.mark.parametrize(
    ('size', 'message'),
    [
        ('640x480', "'640x480' is not WIDTHxHEIGHTxDISPARITIES"),
        ('640x48x16', 'sides must be at least 64 px'),
        ('640x480x20', 'disparities a multiple of 16'),
        ('64x480x64', 'fewer disparities than columns'),
    ],
)
def test_sizes_that_make_no_sense(
    size: str, message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit, match='2'):
        main(['benchmark', '--sizes', size])
    assert message in capsys.readouterr().err
