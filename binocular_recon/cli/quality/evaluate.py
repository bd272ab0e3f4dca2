# SPDX-License-Identifier: Apache-2.0
"""``evaluate``: accuracy on scenes with ground truth, against OpenCV's and other matchers."""

from __future__ import annotations

import argparse
from dataclasses import dataclass, field
from pathlib import Path

from binocular_recon.apps.progress import ProgressBar
from binocular_recon.cli.options import (
    add_comparison_options,
    add_option_flags,
    given_options,
    names,
    positive,
    say,
    ximgproc_note,
)
from binocular_recon.errors import ConfigError
from binocular_recon.evaluation import peers
from binocular_recon.evaluation.accuracy import part_tables, report, summary
from binocular_recon.evaluation.accuracy.external import TIMEOUT_S, external_peer
from binocular_recon.evaluation.accuracy.methods import (
    Method,
    PeerError,
    match_method,
    opencv_method,
    preset_method,
)
from binocular_recon.evaluation.accuracy.robustness import (
    EXPOSURE_GAIN,
    EXPOSURE_OFFSET,
    CropChange,
    ExposureChange,
    crop_changes,
    exposure_change,
)
from binocular_recon.evaluation.accuracy.scenes import find_scenes, read_scene
from binocular_recon.evaluation.accuracy.scoring import (
    Failures,
    SceneScores,
    evaluate_scene,
)
from binocular_recon.evaluation.tables import to_plain
from binocular_recon.io.files import make_folder, write_json, write_text
from binocular_recon.machine import machine_facts

HOW_MEASURED = (
    'A pixel is bad if its error exceeds the limit or if it has no disparity; in the mean error,'
    ' a pixel without disparity counts as disparity 0. Times are medians of interleaved runs.'
)
# Smaller steps of a ground truth add less than 0.03 px to sigma.
LEAST_NAMED_STEP_PX = 0.1
PADDED = 'Images for OpenCV are padded on the left, so that it too can fill every pixel.'
NO_XIMGPROC = ximgproc_note('the rows with its WLS filter are missing', 'evaluate')


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``evaluate``."""
    parser.add_argument(
        'dir',
        type=Path,
        metavar='DIR',
        help='scene folder (left.png, right.png, disparity.pfm, scene.yaml), or a folder of these',
    )
    add_comparison_options(parser, repeat=3)
    parser.add_argument(
        '--scenes', type=names, metavar='NAME,...', help='scenes to evaluate (all)'
    )
    parser.add_argument('--no-peers', action='store_true', help="leave out OpenCV's matchers")
    parser.add_argument(
        '--peer',
        action='append',
        default=[],
        metavar='NAME=COMMAND',
        help='also evaluate another program, such as "SPS=./spsstereo {left} {right} {output}";'
        ' {left} and {right} are PNG files, {range} is the number of disparities, {output} the'
        ' disparity file to write: PFM, or with an ending such as {output}.png PNG of 16 bit, TIFF'
        ' or npy; can be repeated',
    )
    parser.add_argument(
        '--peer-timeout',
        type=positive(float),
        default=TIMEOUT_S,
        metavar='S',
        help='stop a run of another program after this time (%(default)g)',
    )
    parser.add_argument(
        '--match-only', action='store_true', help='also evaluate the matches before the filter'
    )
    parser.add_argument(
        '--exposure',
        action='store_true',
        help=f'also evaluate with the right image darkened: times {EXPOSURE_GAIN:g}, plus'
        f' {EXPOSURE_OFFSET:g} grey levels',
    )
    parser.add_argument(
        '--crop', action='store_true', help='also measure the effect of cropping the images'
    )
    add_option_flags(
        parser, exclude=('min_disparity', 'disparity_range', 'min_depth', 'max_depth')
    )


@dataclass
class Evaluated:
    """Results of the scenes that are finished.

    Attributes
    ----------
    scenes : list of SceneScores
        Figures of each scene.
    sections : list of str
        Section of the page of each scene.
    exposure : list of ExposureChange
    crop : list of CropChange
    failures : Failures
        Scenes that could not be evaluated.

    """

    scenes: list[SceneScores] = field(default_factory=list)
    sections: list[str] = field(default_factory=list)
    exposure: list[ExposureChange] = field(default_factory=list)
    crop: list[CropChange] = field(default_factory=list)
    failures: Failures = field(default_factory=Failures)


def run(args: argparse.Namespace) -> None:
    """Evaluate, print the tables, write ``evaluation.json`` and ``evaluation.html``.

    Raises
    ------
    BinocularReconError
        If there are no scenes or an option is wrong; or, at the end, if scenes failed.
    KeyboardInterrupt
        After an interruption, when the finished scenes have been reported.

    """
    methods = _methods(args)
    folders = find_scenes(args.dir, args.scenes)
    make_folder(args.output)
    evaluated, interrupted = Evaluated(), False
    try:
        with ProgressBar(len(folders), 'scenes') as bar:
            for done, folder in enumerate(folders):
                bar.show(done, folder.name)
                with evaluated.failures.of(folder.name):
                    _evaluate(folder, methods, args, evaluated)
    except KeyboardInterrupt:
        interrupted = True
    if evaluated.scenes:
        _report(args, evaluated, len(folders))
    if interrupted:
        done = len(evaluated.scenes)
        raise KeyboardInterrupt(f'{done} of {len(folders)} scenes are in {args.output}')
    evaluated.failures.raise_if_any(len(folders))


def _evaluate(
    folder: Path, methods: list[Method], args: argparse.Namespace, evaluated: Evaluated
) -> None:
    result = evaluate_scene(read_scene(folder), methods, args.repeat)
    for method, estimate in zip(methods, result.estimates, strict=True):
        disparity_px = estimate.disparity_px
        if args.exposure and method.name not in result.scores.failures:
            try:
                change = exposure_change(result.scene, method, disparity_px)
            except PeerError as error:
                result.scores.failures[f'{method.name}, right image darker'] = str(error)
            else:
                evaluated.exposure.append(change)
        if args.crop and method.ours:
            evaluated.crop += crop_changes(result.scene, method, disparity_px)
    evaluated.sections.append(report.scene_section(result))
    evaluated.scenes.append(result.scores)


def _report(args: argparse.Namespace, evaluated: Evaluated, scene_count: int) -> None:
    notes, tables = _notes(evaluated, scene_count), _tables(evaluated)
    say('\n\n'.join([*tables, *notes]))
    failures = {name: str(error) for name, error in evaluated.failures.errors.items()}
    facts = {
        'machine': machine_facts(),
        'presets': args.presets,
        'options': given_options(args),
        'repeat': args.repeat,
        'mean': summary.mean_over_scenes(evaluated.scenes),
        'scenes': evaluated.scenes,
        'exposure': evaluated.exposure,
        'crop': evaluated.crop,
        'failures': failures,
    }
    write_json(args.output / 'evaluation.json', to_plain(facts))
    ours = [score.method for score in evaluated.scenes[0].scores if score.ours]
    page = report.page('Evaluation', notes, tables, evaluated.sections, ours)
    write_text(args.output / 'evaluation.html', page)


def _methods(args: argparse.Namespace) -> list[Method]:
    overrides = given_options(args)
    methods = [] if args.no_peers else [opencv_method(peer) for peer in peers.opencv_matchers()]
    methods += [external_peer(text, args.peer_timeout).method() for text in args.peer]
    for preset in args.presets:
        if args.match_only:
            methods.append(match_method(preset, **overrides))
        methods.append(preset_method(preset, **overrides))
    if not methods:
        raise ConfigError('nothing to evaluate: name a preset or omit --no-peers')
    given = [method.name for method in methods]
    for name in given:
        if given.count(name) > 1:
            raise ConfigError(f'two methods are called {name!r}; give each --peer its own name')
    return methods


def _tables(evaluated: Evaluated) -> list[str]:
    scenes = evaluated.scenes
    means = summary.mean_over_scenes(scenes)
    tables = [
        summary.overview(means),
        summary.visibility(means),
        summary.by_scene(scenes),
        part_tables.part_table(scenes),
        part_tables.class_table(scenes),
        summary.depth_by_band(scenes),
        summary.sigma_calibration(scenes),
        *summary.sigma_by_bin(scenes),
        summary.exposure_table(evaluated.exposure),
        summary.crop_table(evaluated.crop),
    ]
    return [table for table in tables if table]


def _notes(evaluated: Evaluated, scene_count: int) -> list[str]:
    scenes = evaluated.scenes
    notes = [HOW_MEASURED]
    opencv = {matcher.name for matcher in peers.opencv_matchers()}
    if opencv & {score.method for score in scenes[0].scores}:
        notes += [PADDED] if peers.has_ximgproc() else [PADDED, NO_XIMGPROC]
    derived = [scene.scene for scene in scenes if scene.visible_source == 'ground truth']
    unknown = [scene.scene for scene in scenes if not scene.visible_source]
    metric = [scene.scene for scene in scenes if scene.scores[0].depth]
    steps = [
        f'{scene.truth_step_px:g} px ({scene.scene})'
        for scene in scenes
        if scene.truth_step_px >= LEAST_NAMED_STEP_PX
    ]
    failed = list(evaluated.failures.errors)
    for scene_names, text in (
        (derived, 'Occlusions are derived from the ground truth in {}.'),
        (unknown, 'Occlusions are not known in {}.'),
        (metric, 'Depth errors are means over {}.'),
        (steps, 'Sigma holds the rounding of the ground truth, to steps of {}.'),
        (failed, f'Not evaluated ({len(failed)} of {scene_count}): {{}}.'),
    ):
        if scene_names:
            notes.append(text.format(', '.join(scene_names)))
    notes += [
        f'{name} gave no result for {scene.scene}: {reason}.'
        for scene in scenes
        for name, reason in scene.failures.items()
    ]
    return notes
