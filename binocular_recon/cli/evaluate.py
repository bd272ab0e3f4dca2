# SPDX-License-Identifier: Apache-2.0
"""Accuracy on scenes with ground truth, against OpenCV's matchers in the same run."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from binocular_recon.cli.options import add_option_flags, given_options, positive, preset_names
from binocular_recon.cli.progress import ProgressBar
from binocular_recon.config import PRESETS, OptionValue
from binocular_recon.errors import ConfigError
from binocular_recon.evaluation import peers, report, robustness, summary
from binocular_recon.evaluation.evaluate import (
    Failures,
    SceneResult,
    SceneScores,
    evaluate_scene,
)
from binocular_recon.evaluation.methods import Method, match_method, opencv_method, preset_method
from binocular_recon.evaluation.scenes import find_scenes, read_scene
from binocular_recon.evaluation.timing import machine_facts
from binocular_recon.io.files import complete_file, make_folder, write_json

HOW_MEASURED = (
    'A pixel is bad if its error exceeds the limit or if it is unfilled; in the mean error an'
    ' unfilled pixel counts as disparity 0. Times are medians of runs that took turns.'
)
PADDED = 'OpenCV gets pictures padded on the left so that it too can fill every pixel.'
NO_XIMGPROC = (
    "This OpenCV has no ximgproc: the rows with ximgproc's WLS filter are absent. It is part of"
    ' opencv-contrib-python-headless; `make evaluate` sets up an environment with it.'
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument(
        'dir',
        type=Path,
        metavar='DIR',
        help='folder of scene folders (left.png, right.png, disparity.pfm, scene.yaml), or one',
    )
    parser.add_argument(
        '--output', type=Path, default=Path('out'), help='folder for the results (%(default)s)'
    )
    parser.add_argument(
        '--presets',
        type=preset_names,
        default=list(PRESETS),
        metavar='NAME,...',
        help=f'presets to evaluate (all: {",".join(PRESETS)})',
    )
    parser.add_argument(
        '--scenes', type=_names, metavar='NAME,...', help='scenes to evaluate (all)'
    )
    parser.add_argument('--no-peers', action='store_true', help="leave OpenCV's matchers out")
    parser.add_argument(
        '--match-only', action='store_true', help='show the matching before the filter too'
    )
    parser.add_argument(
        '--repeat', type=positive(int), default=3, help='timed runs of each method (%(default)s)'
    )
    parser.add_argument(
        '--exposure',
        action='store_true',
        help='also evaluate with the right picture made darker (times'
        f' {robustness.EXPOSURE_GAIN:g}, plus {robustness.EXPOSURE_OFFSET:g} grey levels)',
    )
    parser.add_argument(
        '--crop', action='store_true', help='also measure what cutting the pictures changes'
    )
    add_option_flags(
        parser, exclude=('min_disparity', 'disparity_range', 'min_depth', 'max_depth')
    )


def run(args: argparse.Namespace) -> None:
    """Evaluate; print the tables, write evaluation.json and evaluation.html.

    Raises
    ------
    BinocularReconError
        If the scenes cannot be found, an option is wrong, or, at the end, if scenes failed.

    """
    overrides = given_options(args)
    methods = _methods(args, overrides)
    folders = find_scenes(args.dir, args.scenes)
    make_folder(args.output)
    failures = Failures()
    scenes: list[SceneScores] = []
    sections: list[str] = []
    extra: dict[str, list[Any]] = {'exposure': [], 'crop': []}
    with ProgressBar(len(folders), 'scenes') as bar:
        for folder in folders:
            bar.show(len(scenes) + len(failures.errors), folder.name)
            with failures.of(folder.name):
                result = evaluate_scene(read_scene(folder), methods, args.repeat)
                _test_robustness(result, methods, args, extra)
                scenes.append(result.scores)
                sections.append(report.scene_section(result))
    if scenes:
        notes, tables = _notes(scenes, failures, len(folders)), _tables(scenes, extra)
        print('\n\n'.join([*tables, *notes]))
        _write(args, overrides, scenes, extra, failures)
        text = report.page('Evaluation', notes, tables, sections)
        with complete_file(args.output / 'evaluation.html') as file:
            file.write(text.encode())
    failures.raise_if_any(len(folders))


def _methods(args: argparse.Namespace, overrides: dict[str, OptionValue]) -> list[Method]:
    methods = [] if args.no_peers else [opencv_method(peer) for peer in peers.opencv_matchers()]
    for preset in args.presets:
        if args.match_only:
            methods.append(match_method(preset, **overrides))
        methods.append(preset_method(preset, **overrides))
    if not methods:
        raise ConfigError('nothing to evaluate: name a preset or leave out --no-peers')
    return methods


def _test_robustness(
    result: SceneResult,
    methods: list[Method],
    args: argparse.Namespace,
    extra: dict[str, list[Any]],
) -> None:
    for method, estimate in zip(methods, result.estimates, strict=True):
        disparity_px = estimate.disparity_px
        if args.exposure:
            extra['exposure'].append(
                robustness.exposure_change(result.scene, method, disparity_px)
            )
        if args.crop and method.ours:
            extra['crop'] += robustness.crop_changes(result.scene, method, disparity_px)


def _tables(scenes: list[SceneScores], extra: dict[str, list[Any]]) -> list[str]:
    means = summary.mean_over_scenes(scenes)
    tables = [
        summary.overview(means),
        summary.visibility(means),
        summary.by_scene(scenes),
        summary.depth_by_band(scenes),
        summary.sigma_honesty(scenes),
        *summary.sigma_by_bin(scenes),
        summary.exposure_table(extra['exposure']),
        summary.crop_table(extra['crop']),
    ]
    return [table for table in tables if table]


def _notes(scenes: list[SceneScores], failures: Failures, asked: int) -> list[str]:
    derived = [scene.scene for scene in scenes if scene.visible_source == 'ground truth']
    unknown = [scene.scene for scene in scenes if not scene.visible_source]
    notes = [HOW_MEASURED]
    if not all(score.ours for score in scenes[0].scores):
        notes += [PADDED] if peers.has_ximgproc() else [PADDED, NO_XIMGPROC]
    if derived:
        notes.append(
            f'Visible and occluded are derived from the ground truth in {", ".join(derived)}.'
        )
    if unknown:
        notes.append(f'Visible and occluded are not known in {", ".join(unknown)}.')
    if failures.errors:
        notes.append(
            f'Not evaluated ({len(failures.errors)} of {asked}): {", ".join(failures.errors)}.'
        )
    return notes


def _write(
    args: argparse.Namespace,
    overrides: dict[str, OptionValue],
    scenes: list[SceneScores],
    extra: dict[str, list[Any]],
    failures: Failures,
) -> None:
    facts = {
        'machine': machine_facts(),
        'presets': args.presets,
        'options': overrides,
        'repeat': args.repeat,
        'mean': summary.mean_over_scenes(scenes),
        'scenes': scenes,
        **{key: values for key, values in extra.items() if values},
        'failures': {name: str(error) for name, error in failures.errors.items()},
    }
    write_json(args.output / 'evaluation.json', summary.to_plain(facts))


def _names(text: str) -> list[str]:
    return [name.strip() for name in text.split(',') if name.strip()]
