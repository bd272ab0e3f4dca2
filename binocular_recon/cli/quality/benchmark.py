# SPDX-License-Identifier: Apache-2.0
"""``benchmark``: speed and memory of stages and chain against their peers, and of nodes."""

from __future__ import annotations

import argparse
import functools
import importlib.util
import itertools
import math
from collections.abc import Callable, Sequence
from pathlib import Path

from binocular_recon.apps.progress import ProgressBar
from binocular_recon.cli.options import (
    NO_ROS,
    add_comparison_options,
    positive,
    say,
    ximgproc_note,
)
from binocular_recon.errors import BinocularReconError
from binocular_recon.evaluation import peers
from binocular_recon.evaluation.speed.benchmark import (
    SIZES,
    STAGES,
    Results,
    Timing,
    benchmark,
    growth,
    step_count,
)
from binocular_recon.evaluation.speed.content import Content, Size, default_contents, scenes
from binocular_recon.evaluation.speed.live import (
    OFFLINE,
    OUTPUTS,
    LiveOptions,
    LiveResult,
    measure,
)
from binocular_recon.evaluation.tables import markdown_table, to_plain
from binocular_recon.io.files import make_folder, write_json
from binocular_recon.machine import machine_facts
from binocular_recon.number_text import fixed

NO_XIMGPROC = ximgproc_note('its WLS filter and the chain with it are missing', 'benchmark')
_MIN_SIDE_PX = 64
# Drops that are rarer are not worth a line.
_LEAST_DROPS_HZ = 0.05


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``benchmark``."""
    add_comparison_options(parser, repeat=5)
    parser.add_argument(
        '--sizes',
        type=_size,
        nargs='+',
        default=list(SIZES),
        metavar='WxHxD',
        help='sizes of the pair that ships: width x height x disparities'
        f' ({" ".join(map(str, SIZES))})',
    )
    parser.add_argument(
        '--scenes',
        type=Path,
        metavar='DIR',
        help='also time match, filter and chain on each scene of a folder, as evaluate takes them',
    )
    live = parser.add_argument_group('running nodes')
    live.add_argument(
        '--live',
        action='store_true',
        help='measure running nodes instead, composed and separate, by turns with the chain alone',
    )
    live.add_argument(
        '--rate',
        type=positive(float),
        default=LiveOptions.rate_hz,
        metavar='HZ',
        help='pairs a second that the cameras produce (%(default)g)',
    )
    live.add_argument(
        '--seconds',
        type=positive(float),
        default=LiveOptions.seconds,
        metavar='S',
        help='length of a measurement (%(default)g); there are --repeat of each',
    )
    live.add_argument(
        '--listen',
        nargs='+',
        choices=list(OUTPUTS),
        default=[],
        metavar='TOPIC',
        help=f'outputs to subscribe to besides points2 (of {", ".join(OUTPUTS)})',
    )


def run(args: argparse.Namespace) -> None:
    """Measure, print the tables and write ``benchmark.json``, with ``--live`` ``live.json``.

    Raises
    ------
    BinocularReconError
        If an option is out of range, the folder cannot be written or a process fails.

    """
    make_folder(args.output)
    sizes = sorted(args.sizes, key=lambda size: size.scores)
    if args.live:
        _run_live(args, sizes)
        return
    contents = default_contents(sizes)
    if args.scenes:
        contents = [*scenes(args.scenes), *contents]
    with ProgressBar(step_count(contents, sizes, args.presets), 'steps') as bar:
        results = benchmark(contents, sizes, args.presets, args.repeat, bar.show)
    tables = [*_stage_tables(results), *_other_tables(results, contents, sizes)]
    notes = [] if peers.has_ximgproc() else [NO_XIMGPROC]
    say('\n\n'.join([*tables, *notes]))
    facts = {'machine': machine_facts(), 'repeat': args.repeat, 'presets': args.presets}
    write_json(args.output / 'benchmark.json', to_plain({**facts, 'results': results}))


def _run_live(args: argparse.Namespace, sizes: Sequence[Size]) -> None:
    if importlib.util.find_spec('rclpy') is None:
        raise BinocularReconError(NO_ROS)
    results: list[LiveResult] = []
    count = len(sizes) * len(args.presets)
    with ProgressBar(count, 'sizes') as bar:
        for number, (preset, size) in enumerate(itertools.product(args.presets, sizes)):
            options = LiveOptions(
                preset=preset,
                rate_hz=args.rate,
                seconds=args.seconds,
                rounds=args.repeat,
                outputs=list(dict.fromkeys(['points2', *args.listen])),
            )
            found = measure(size, options, functools.partial(bar.show, number))
            results += found
            say('\n\n'.join(_live_tables(found)) + '\n')
            facts = {'machine': machine_facts(), 'rate_hz': args.rate, 'seconds': args.seconds}
            write_json(args.output / 'live.json', to_plain({**facts, 'results': results}))


def _live_tables(results: Sequence[LiveResult]) -> list[str]:
    header = [
        '',
        'clouds/s',
        'relative',
        'latency s',
        '95 % s',
        'CPU s/cloud',
        'relative',
        'memory MB',
    ]
    tables = []
    for title in dict.fromkeys((one.preset, one.size) for one in results):
        rows, drops = [], []
        for one in (one for one in results if (one.preset, one.size) == title):
            values = [fixed(one.clouds_per_s, 2), fixed(one.relative, 2)]
            if one.name == OFFLINE:
                values += ['', '', fixed(one.cpu_s_per_cloud, 3), fixed(one.cpu_relative, 2), '']
            else:
                values += [fixed(one.latency_s, 3), fixed(one.latency_95_s, 3)]
                values += [fixed(one.cpu_s_per_cloud, 3), fixed(one.cpu_relative, 2)]
                values += [fixed(one.memory_mb, 0)]
            rows.append([one.name, *values])
            drops += [
                f'- {one.name}, {reason}: {fixed(rate)} per second'
                for reason, rate in one.dropped.items()
                if rate >= _LEAST_DROPS_HZ
            ]
        tables.append(markdown_table([f'{title[0]}, {title[1]}', *header[1:]], rows))
        tables += ['\n'.join(['Dropped:', *drops])] if drops else []
    return tables


def _stage_tables(results: Results) -> list[str]:
    tables = []
    for stage in STAGES:
        timings = [timing for timing in results.timings if timing.stage == stage]
        tables.append(_stage_table(stage, timings))
        if stage == 'chain':
            rows = _by_content(timings, lambda one: fixed(1 / one.seconds))
            tables.append(markdown_table(['chain, pairs per second', *_names(timings)], rows))
        if stage == 'exact WLS':
            presets = list(next(iter(results.iterations.values())))
            counts = results.iterations.items()
            rows = [[content, *(str(of[one]) for one in presets)] for content, of in counts]
            tables.append(markdown_table(['exact WLS, iterations', *presets], rows))
    return tables


def _stage_table(stage: str, timings: Sequence[Timing]) -> str:
    """Return a row for each content: time of the reference, the others' relative to it."""
    first, *others = _names(timings)
    if math.isnan(timings[0].relative):  # without a reference
        rows = _by_content(timings, lambda one: fixed(1000 * one.seconds))
        return markdown_table([stage, *(f'{name} ms' for name in (first, *others))], rows)
    rows = _by_content(
        timings,
        lambda one: fixed(1000 * one.seconds) if one.name == first else fixed(one.relative, 2),
    )
    means = []
    for name in others:
        real = [one.relative for one in timings if one.name == name and one.real]
        means.append(fixed(sum(real) / len(real), 2) if real else '-')
    if any(one.real for one in timings):
        rows.append(['mean of real content', '', *means])
    return markdown_table([stage, f'{first} ms', *others], rows)


def _names(timings: Sequence[Timing]) -> list[str]:
    return list(dict.fromkeys(timing.name for timing in timings))


def _by_content(timings: Sequence[Timing], text: Callable[[Timing], str]) -> list[list[str]]:
    contents = dict.fromkeys(timing.content for timing in timings)
    return [[name, *(text(one) for one in timings if one.content == name)] for name in contents]


def _other_tables(
    results: Results, contents: Sequence[Content], sizes: Sequence[Size]
) -> list[str]:
    grown = growth(results.timings, contents)
    by_content = zip(*grown.values(), strict=True)
    return [
        markdown_table(
            ['match, ns per pixel and disparity', *grown],
            [
                [str(content), *(fixed(value, 3) for value in values)]
                for content, values in zip(contents, by_content, strict=True)
            ],
        ),
        _direct_table(results),
        markdown_table(
            [f'peak memory of a match at {sizes[-1]}', 'MB', 'bytes per pixel and disparity'],
            [
                [one['preset'], fixed(one['peak_mb'], 0), fixed(one['bytes_per_score'], 2)]
                for one in results.memory
            ],
        ),
        _first_call_table(results, sizes[0]),
    ]


def _direct_table(results: Results) -> str:
    header = [
        f'exact WLS at {results.direct[0]["size"]}',
        'direct solver ms',
        'ours ms',
        'iterations',
    ]
    header += ['largest error px', 'its estimate px']
    rows = [
        [
            one['preset'],
            *(fixed(1000 * one[key]) for key in ('direct_s', 'filter_s')),
            str(one['iterations']),
            *(fixed(one[key], 4) for key in ('largest_error_px', 'error_estimate_px')),
        ]
        for one in results.direct
    ]
    return markdown_table(header, rows)


def _first_call_table(results: Results, size: Size) -> str:
    header = [f'first call of the chain at {size}', 'import s', 'first pair s', 'second s']
    rows = [
        [
            f'{one["preset"]}, {state} cache',
            *(fixed(one[state][key], 2) for key in ('import_s', 'first_s', 'second_s')),
        ]
        for one in results.first_call
        for state in ('cold', 'warm')
    ]
    return markdown_table(header, rows)


def _size(text: str) -> Size:
    try:
        width, height, disparity_range = map(int, text.split('x'))
    except ValueError:
        raise argparse.ArgumentTypeError(f'{text!r} is not WIDTHxHEIGHTxDISPARITIES') from None
    if min(width, height) < _MIN_SIDE_PX or disparity_range < 16 or disparity_range % 16:
        raise argparse.ArgumentTypeError(
            f'{text}: sides must be at least {_MIN_SIDE_PX} px, disparities a multiple of 16'
        )
    if disparity_range >= width:
        raise argparse.ArgumentTypeError(
            f'{text}: there must be fewer disparities than columns ({width})'
        )
    return Size(width, height, disparity_range)
